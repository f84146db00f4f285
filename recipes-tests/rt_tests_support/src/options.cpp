#include "rt_tests_support/options.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <stdexcept>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/programs.h"

namespace rt_tests {
namespace {

std::string takes(const Option& option) {
  if (option.kind == Kind::integer) return std::to_string(option.min) + ".." + std::to_string(option.max);
  if (option.kind == Kind::cpus) return "LIST";
  if (option.kind == Kind::text) return "TEXT";
  std::string all;
  for (const auto& choice : option.choices) all += (all.empty() ? "" : "|") + choice;
  return all;
}

int64_t integer(const Option& option, const std::string& text) {
  errno = 0;
  char* end = nullptr;
  const long long number = std::strtoll(text.c_str(), &end, 10);
  const bool plain = !text.empty() && text.find_first_not_of("-0123456789") == std::string::npos && *end == '\0';
  if (!plain || errno == ERANGE || number < option.min || number > option.max) {
    throw UsageError(std::string(option.flag) + " takes an integer from " + std::to_string(option.min) + " to " +
                     std::to_string(option.max) + ", got '" + text + "'");
  }
  return number;
}

void set(Options::Value& value, const std::string& text) {
  const Option& option = value.option;
  if (option.kind == Kind::integer) value.number = integer(option, text);
  if (option.kind == Kind::cpus && !text.empty()) parse_cpus(text, static_cast<int>(sysconf(_SC_NPROCESSORS_CONF)));
  if (option.kind == Kind::choice &&
      std::find(option.choices.begin(), option.choices.end(), text) == option.choices.end()) {
    throw UsageError(std::string(option.flag) + " takes " + takes(option) + ", got '" + text + "'");
  }
  value.text = text;
  value.set = true;
}

}  // namespace

bool Option::is_taken_through(const std::string& middleware) const {
  const auto names = [&](const std::vector<std::string>& list) {
    return std::find(list.begin(), list.end(), middleware) != list.end();
  };
  return (through.empty() || names(through)) && !names(not_through);
}

const char* version() { return RT_TESTS_VERSION; }

Options::Options(const Program& program) {
  for (const auto& key : program.keys) {
    const auto& all = all_options();
    const auto option = std::find_if(all.begin(), all.end(), [&](const Option& known) { return key == known.key; });
    if (option == all.end()) throw std::logic_error("no program takes an option '" + key + "'");
    if (!option->is_taken_through(program.middleware)) continue;
    Value value;
    value.option = *option;
    if (option->fallback) set(value, option->fallback);
    values_.push_back(value);
  }
}

const Options::Value& Options::find(const std::string& key) const {
  const auto value =
      std::find_if(values_.begin(), values_.end(), [&](const Value& known) { return key == known.option.key; });
  if (value == values_.end()) throw std::logic_error("this program takes no option '" + key + "'");
  return *value;
}

bool Options::has(const std::string& key) const {
  return std::any_of(values_.begin(), values_.end(), [&](const Value& value) { return key == value.option.key; });
}

bool Options::knows(const std::string& flag) const {
  return std::any_of(values_.begin(), values_.end(), [&](const Value& value) { return flag == value.option.flag; });
}

void Options::assign(const std::string& flag, const std::string& argument) {
  for (auto& value : values_) {
    if (flag == value.option.flag) {
      set(value, argument);
      value.given = true;
    }
  }
}

Options parse(const Program& program, int argc, char* argv[]) {
  Options options(program);
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--help" || word == "-h") {
      std::cout << help(program) << std::flush;
      std::exit(0);
    }
    if (word == "--version") {
      std::cout << program.executable() << " " << version() << std::endl;
      std::exit(0);
    }
    if (word[0] != '-' && word.find(":=") != std::string::npos) continue;  // a ROS remapping

    const std::size_t equals = word.compare(0, 2, "--") == 0 ? word.find('=') : std::string::npos;
    const std::string flag = word.substr(0, equals);
    if (!options.knows(flag)) {
      throw UsageError("unknown option '" + flag + "'; " + program.executable() + " --help lists what there is");
    }
    if (equals != std::string::npos) {
      options.assign(flag, word.substr(equals + 1));
    } else if (i + 1 < argc) {
      options.assign(flag, argv[++i]);
    } else {
      const auto& all = options.values();
      const auto value = std::find_if(all.begin(), all.end(), [&](const auto& known) { return flag == known.option.flag; });
      throw UsageError(flag + " takes " + takes(value->option) + ", got nothing");
    }
  }
  return options;
}

std::vector<int> parse_cpus(const std::string& list, int cpu_count) {
  const auto wrong = [&] {
    return UsageError("--cpu takes CPUs of this machine, 0 to " + std::to_string(cpu_count - 1) +
                      ", as in 1 or 0-1 or 0,2, got '" + list + "'");
  };
  std::vector<int> cpus;
  std::size_t at = 0;
  const auto number = [&] {
    const std::size_t end = std::min(list.find_first_not_of("0123456789", at), list.size());
    if (end == at || end - at > 4) throw wrong();
    const int value = std::atoi(list.substr(at, end - at).c_str());
    if (value >= cpu_count) throw wrong();
    at = end;
    return value;
  };
  while (true) {
    const int first = number();
    int last = first;
    if (at < list.size() && list[at] == '-') {
      ++at;
      last = number();
    }
    if (last < first) throw wrong();
    for (int cpu = first; cpu <= last; ++cpu) cpus.push_back(cpu);
    if (at == list.size()) return cpus;
    if (list[at++] != ',') throw wrong();
  }
}

std::string help(const Program& program) {
  std::string text = "usage: " + program.executable() + " [options]\n" + program.purpose + "\n\n";
  const auto line = [&](std::string left, const std::string& right) {
    left.resize(std::max<std::size_t>(left.size() + 2, 38), ' ');
    text += "  " + left + right + "\n";
  };
  const Options options(program);
  for (const auto& value : options.values()) {
    const Option& option = value.option;
    line(std::string(option.flag) + " " + takes(option),
         option.help + (option.fallback && *option.fallback ? std::string(" [") + option.fallback + "]" : ""));
  }
  line("--version", "print the version");
  line("--help", "print this");
  return text;
}

}  // namespace rt_tests
