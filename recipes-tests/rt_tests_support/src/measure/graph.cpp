#include "rt_tests_support/measure/graph.h"

#include <fstream>
#include <limits>
#include <sstream>

#include "rt_tests_support/errors.h"

namespace topology {
namespace {

constexpr int64_t ns_max = int64_t{1} << 60;
constexpr int64_t bytes_max = int64_t{1} << 32;
constexpr int64_t rows_max = 1000000000;
constexpr int64_t count_max = 10000;

// The words of a line, each of which is asked for once.
class Line {
 public:
  Line(std::string where, const std::string& text) : where_(std::move(where)), words_(text) {}

  std::string word() {
    std::string word;
    if (!(words_ >> word)) throw wrong("ends too early");
    return word;
  }
  std::string name() {
    const std::string name = word();
    const bool good = name.size() <= 255 && name.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                                                     "0123456789_/") == std::string::npos;
    if (!good) throw wrong("takes a name of letters, digits, _ and /, got '" + name + "'");
    return name;
  }
  int64_t number(int64_t min, int64_t max) {
    const std::string text = word();
    const bool plain = text.size() <= 18 && text.find_first_not_of("0123456789") == std::string::npos;
    const int64_t number = plain ? std::stoll(text) : -1;
    if (number < min || number > max) {
      throw wrong("takes an integer from " + std::to_string(min) + " to " + std::to_string(max) + ", got '" + text + "'");
    }
    return number;
  }
  // The place of something in a list, of which there are `size` so far.
  std::size_t place(std::size_t size) { return static_cast<std::size_t>(number(0, static_cast<int64_t>(size) - 1)); }
  void next(std::size_t size) {
    if (place(size + 1) != size) throw wrong("is not numbered from 0 on");
  }
  template <class Value>
  Value one_of(const std::vector<std::pair<std::string, Value>>& choices) {
    const std::string word = this->word();
    std::string known;
    for (const auto& [name, value] : choices) {
      if (word == name) return value;
      known += (known.empty() ? "" : "|") + name;
    }
    throw wrong("takes " + known + ", got '" + word + "'");
  }
  void end() {
    std::string word;
    if (words_ >> word) throw wrong("has a word too many: '" + word + "'");
  }
  rt_tests::UsageError wrong(const std::string& what) const { return rt_tests::UsageError(where_ + ": " + what); }

 private:
  const std::string where_;
  std::istringstream words_;
};

void read(const std::string& kind, Line& line, Process& process) {
  if (kind == "topology") {
    line.number(1, 1);
  } else if (kind == "process") {
    process.name = line.name();
    process.processes = line.number(1, count_max);
  } else if (kind == "measure") {
    process.measure_ns = line.number(1, ns_max);
  } else if (kind == "topic") {
    line.next(process.topics.size());
    Topic topic{line.name(), line.number(0, bytes_max), false, 0};
    topic.reliable = line.one_of<bool>({{"reliable", true}, {"best_effort", false}});
    topic.depth = static_cast<int32_t>(line.number(1, 1000000));
    process.topics.push_back(topic);
  } else if (kind == "executor") {
    line.next(process.executors.size());
    Executor executor{line.name(), line.one_of<std::string>({{"0", "0"}, {"FIFO", "FIFO"}, {"RR", "RR"}}), 0, ""};
    executor.priority = line.number(0, 98);
    const std::string cpus = line.word();
    if (cpus != "-") executor.cpus = cpus;
    process.executors.push_back(executor);
  } else if (kind == "node") {
    line.next(process.nodes.size());
    Node node{};
    node.name = line.name();
    node.executor = line.place(process.executors.size());
    node.waits = line.one_of<Waits>({{"period", Waits::period}, {"any", Waits::any}, {"all", Waits::all}});
    node.period_ns = line.number(node.waits == Waits::period ? 1 : 0, ns_max);
    node.offset_ns = line.number(0, ns_max);
    node.busy_ns = line.number(0, ns_max);
    node.touched_bytes = line.number(0, bytes_max);
    node.activations_max = line.number(0, rows_max);
    process.nodes.push_back(node);
  } else if (kind == "in") {
    Node& node = process.nodes[line.place(process.nodes.size())];
    const std::size_t topic = line.place(process.topics.size());
    node.inputs.push_back({topic, line.number(0, rows_max)});
  } else if (kind == "out") {
    Node& node = process.nodes[line.place(process.nodes.size())];
    const std::size_t topic = line.place(process.topics.size());
    const int64_t subscriptions = line.number(0, count_max);
    node.outputs.push_back({topic, subscriptions, line.number(0, count_max)});
  } else {
    throw line.wrong("begins with '" + kind + "', which no line does");
  }
}

}  // namespace

std::size_t Topic::message_bytes() const { return sizeof(Head) + static_cast<std::size_t>(payload_bytes); }

Process read_process(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw rt_tests::UsageError(path + ": cannot be read");
  Process process;
  int number = 0;
  for (std::string text; std::getline(file, text);) {
    Line line(path + ":" + std::to_string(++number), text);
    const std::string kind = line.word();
    if ((number == 1) != (kind == "topology")) throw line.wrong("the first line, and no other, is 'topology 1'");
    if (kind == "end") {
      line.end();
      if (process.name.empty() || process.measure_ns == 0 || process.nodes.empty()) {
        throw line.wrong("a process, how long to measure, and a node at least have to stand before");
      }
      for (const Node& node : process.nodes) {
        if (node.waits != Waits::period && node.inputs.empty()) {
          throw line.wrong("node " + node.name + " waits for inputs, and has none");
        }
      }
      return process;
    }
    read(kind, line, process);
    line.end();
  }
  throw rt_tests::UsageError(path + ": its last line is not 'end': it is not whole");
}

}  // namespace topology
