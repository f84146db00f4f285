#include "rt_tests_support/measure/topology.h"

#include <dirent.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <set>

#include "rt_tests_support/files.h"
#include "rt_tests_support/json.h"

namespace topology {
namespace {

constexpr char ready[] = "ready.";
volatile sig_atomic_t status_at_limit = 0;
constexpr int64_t start_limit_ns = 60 * rt_tests::ns_per_s;
// From when the last process is ready until all begin: the others have to see that.
constexpr int64_t start_after_ns = 500 * 1000000;
constexpr int64_t poll_ns = 20 * 1000000;

// When each process was ready, as far as they are. The files are written whole.
std::vector<int64_t> read_ready(const std::string& folder) {
  std::vector<int64_t> times;
  DIR* const entries = opendir(folder.c_str());
  if (!entries) return times;
  while (const dirent* entry = readdir(entries)) {
    const std::string name = entry->d_name;
    int64_t ns = 0;
    if (name.compare(0, sizeof ready - 1, ready) == 0 && std::ifstream(folder + "/" + name) >> ns) times.push_back(ns);
  }
  closedir(entries);
  return times;
}

std::string file_name(std::string name) {
  std::replace(name.begin(), name.end(), '/', '.');
  return name;
}

// Of all of its executors: the highest priority, and every CPU of theirs.
void assign_scheduling(const Process& process, rt_tests::Options& options) {
  std::string cpus;
  bool all_cpus = false;
  int64_t highest = 0;
  for (const Executor& executor : process.executors) {
    if (executor.policy != "0" && executor.priority > highest) {
      highest = executor.priority;
      options.assign("-s", executor.policy);
      options.assign("--priority", std::to_string(executor.priority));
    }
    all_cpus = all_cpus || executor.cpus.empty();
    cpus += (cpus.empty() ? "" : ",") + executor.cpus;
  }
  if (!all_cpus) options.assign("--cpu", cpus);
  options.assign("--clock", "monotonic");
}



rt_tests::Program describe(const char* middleware) {
  return {"topology",
          "topology_node",
          "FILE comes first, the text of a process of a graph of nodes: hosts these nodes.",
          {"prefix", "out_dir", "cpu_dma_latency_us", "policy", "priority", "cpu", "clock", "rt_scope"},
          {},
          middleware};
}

std::string reason_of(const Run& run, const std::vector<Hosted>& threads) {
  for (const Hosted& thread : threads) {
    if (!thread.problem.empty()) return thread.problem;
  }
  const std::string stopped = rt_tests::stop_reason();
  if (!stopped.empty()) return stopped;
  return run.start_ns > 0 ? "" : "it was not started";
}

}  // namespace

CommandLine::CommandLine(const char* middleware, int argc, char* argv[])
    : program(describe(middleware)), options(program) {
  rt_tests::Program asked = program;
  asked.keys = {"out_dir", "cpu_dma_latency_us"};  // the rest is in the file
  const bool has_file = argc > 1 && argv[1][0] != '-';
  const rt_tests::Options given = rt_tests::parse(asked, has_file ? argc - 1 : argc, has_file ? argv + 1 : argv);
  if (!has_file) throw rt_tests::UsageError("the first word is the file of a process: see --help");
  process = read_process(argv[1]);
  program.node = process.name.c_str();
  for (const auto& value : given.values()) {
    if (value.given) options.assign(value.option.flag, value.text);
  }
  assign_scheduling(process, options);
}

Run::Run(const Process& of_process, const rt_tests::Program& of_program, const rt_tests::Options& with_options,
         const rt_tests::Destination& to_destination)
    : process(of_process),
      program(of_program),
      options(with_options),
      destination(to_destination),
      surroundings(CLOCK_MONOTONIC) {
  int64_t bytes = 0;
  for (const Node& node : process.nodes) {
    bytes += node.touched_bytes + node.activations_max * static_cast<int64_t>(8 * (5 + node.inputs.size()));
    for (const Input& input : node.inputs) bytes += input.messages_max * 8 * 4;
  }
  rt_tests::require_memory(bytes);
  for (const Node& node : process.nodes) nodes.push_back(std::make_unique<HostedNode>(node));
}

int64_t wait_for_start(const Run& run, const std::function<std::string()>& missing) {
  const std::string folder = rt_tests::folder_of(run.destination.path(""));
  const std::string own = folder + "/" + ready + file_name(run.process.name);
  if (std::ifstream(own)) throw rt_tests::Failure(own + " is of another run: give each a folder of its own");
  const int64_t limit_ns = rt_tests::now_ns(CLOCK_MONOTONIC) + start_limit_ns;
  bool is_ready = false;
  std::string waits_for;
  while (!rt_tests::stop_requested()) {
    const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
    if (!is_ready) {
      waits_for = missing();
      is_ready = waits_for.empty();
      const std::string text = std::to_string(now_ns) + "\n";
      if (is_ready) rt_tests::write_file(own, {{text.data(), text.size()}});
    }
    if (is_ready) {
      const std::vector<int64_t> times = read_ready(folder);
      if (static_cast<int64_t>(times.size()) == run.process.processes) {
        return *std::max_element(times.begin(), times.end()) + start_after_ns;
      }
      waits_for = std::to_string(times.size()) + " of " + std::to_string(run.process.processes) + " processes were ready";
    }
    if (now_ns > limit_ns) {
      throw rt_tests::Failure(waits_for + " after " + std::to_string(start_limit_ns / rt_tests::ns_per_s) + " s");
    }
    sleep_until(now_ns + poll_ns, poll_ns);
  }
  throw rt_tests::Failure(rt_tests::stop_reason() + " before it began" + (waits_for.empty() ? "" : ": " + waits_for));
}

void sleep_until(int64_t due_ns, int64_t limit_ns) noexcept {
  due_ns = std::min(due_ns, rt_tests::now_ns(CLOCK_MONOTONIC) + limit_ns);
  timespec due;
  due.tv_sec = static_cast<time_t>(due_ns / rt_tests::ns_per_s);
  due.tv_nsec = static_cast<long>(due_ns % rt_tests::ns_per_s);
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr);
}

void end_within_limit(int status) {
  status_at_limit = status;
  std::signal(SIGALRM, [](int) {
    constexpr char text[] = "\tWARNING: the middleware did not end in time, and was left as it was\n";
    [[maybe_unused]] const auto written = write(STDERR_FILENO, text, sizeof text - 1);
    _exit(status_at_limit);
  });
  alarm(20);
}

void report(Run& run, const std::vector<Hosted>& threads) {
  const std::string folder = rt_tests::folder_of(run.destination.path("")) + "/";
  const auto write = [&](const std::string& name, const Table& table) {
    rt_tests::write_npy(folder + name + ".npy", table.data(), table.rows(), table.columns());
  };
  for (const auto& node : run.nodes) {
    const std::string name = file_name(node->description->name);
    write(name, node->activations);
    for (std::size_t input = 0; input < node->receptions.size(); ++input) {
      write(name + "-" + std::to_string(input), node->receptions[input]);
    }
  }
  const std::string reason = reason_of(run, threads);
  rt_tests::Json json;
  json.open('{');
  rt_tests::write_head(json, run.program, run.options, reason, run.surroundings);
  json.field("start_ns", run.start_ns).field("measured_ns", run.process.measure_ns);
  json.key("executors").open('[');
  for (std::size_t number = 0; number < threads.size(); ++number) {
    const Executor& executor = run.process.executors[number];
    json.open('{').field("name", executor.name).field("policy", executor.policy).field("priority", executor.priority);
    json.field("cpus", executor.cpus).field("left_ns", threads[number].left_ns).field("foreign", threads[number].foreign);
    json.close();
  }
  json.close().key("nodes").open('[');
  for (const auto& node : run.nodes) {
    json.open('{').field("name", node->description->name);
    json.field("activations", static_cast<int64_t>(node->activations.rows())).field("skipped", node->skipped);
    json.close();
  }
  const std::string text = json.close().close().text();
  rt_tests::write_file(run.destination.path(".json"), {{text.data(), text.size()}});
  if (!reason.empty()) throw rt_tests::Failure(reason);
}

}  // namespace topology
