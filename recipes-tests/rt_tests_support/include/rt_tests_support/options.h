// The options of all programs: one table, from which parsing, --help and the JSON are driven.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace rt_tests {

enum class Kind { integer, choice, text, cpus };

struct Option {
  const char* key;       // as in suites.yml and in the JSON
  const char* flag;      // as on the command line
  Kind kind;
  int64_t min, max;      // integer only
  std::vector<std::string> choices;
  const char* fallback;  // nullptr: none
  const char* help;
  std::vector<std::string> through = {};      // the middlewares whose programs alone take it; none: of all
  std::vector<std::string> not_through = {};  // but for those of these

  bool is_taken_through(const std::string& middleware) const;
};

struct Program {
  const char* suite;
  const char* name;  // as in suites.yml
  const char* purpose;
  std::vector<std::string> keys;          // the options it takes, those of other middlewares included
  std::vector<std::string> columns = {};  // of its samples, as in suites.yml
  const char* middleware = "roscpp";      // through which it measures
  const char* node = nullptr;             // its name as a node of ROS; none: that of the executable

  bool is_of_roscpp() const { return std::string(middleware) == "roscpp"; }
  // roscpp's, which is that of 2014, has the plain name; any other is <name>_<middleware>.
  std::string executable() const { return is_of_roscpp() ? name : std::string(name) + "_" + middleware; }
  std::string node_name() const { return node ? node : executable(); }
};

class Options {
 public:
  struct Value {
    Option option;
    std::string text;
    int64_t number = 0;
    bool given = false;  // on the command line
    bool set = false;    // given, or has a default
  };

  explicit Options(const Program& program);

  int64_t number(const std::string& key) const { return find(key).number; }
  const std::string& text(const std::string& key) const { return find(key).text; }
  bool given(const std::string& key) const { return find(key).given; }
  bool has(const std::string& key) const;
  const std::vector<Value>& values() const { return values_; }

  // Throws UsageError with one line that names the option and the values it takes.
  void assign(const std::string& flag, const std::string& argument);
  bool knows(const std::string& flag) const;

 private:
  const Value& find(const std::string& key) const;
  std::vector<Value> values_;
};

// Reads a command line; ROS remappings (name:=value) are left to ROS. Prints and ends the program with status 0 on
// --help and --version. Throws UsageError.
Options parse(const Program& program, int argc, char* argv[]);

// Turns "0-1,3" into {0, 1, 3}. Throws UsageError for any other text and for a CPU that this machine does not have.
std::vector<int> parse_cpus(const std::string& list, int cpu_count);

std::string help(const Program& program);
const char* version();

}  // namespace rt_tests
