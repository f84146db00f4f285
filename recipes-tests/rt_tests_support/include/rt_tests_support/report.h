// The outputs of a run: summary on standard output, logs, npy, json.
#pragma once

#include <time.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rt_tests_support/json.h"
#include "rt_tests_support/log.h"
#include "rt_tests_support/options.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/summary.h"
#include "rt_tests_support/trace.h"

namespace rt_tests {

// Where the outputs go: <out_dir>/<prefix><base>...
struct Destination {
  std::string folder;  // --out-dir, empty or with a slash at the end
  std::string name;    // prefix and base; gnuplot names the picture of a log after it
  std::string path(const std::string& ending) const { return folder + name + ending; }
};

std::string policy_suffix(const Options& options);  // "", "-tnRTRR", "-tnRTFIFO"

// Throws UsageError if the folder cannot be written to.
Destination destination(const Options& options, const std::string& base);

// What is known of something, by name.
using Facts = std::vector<std::pair<std::string, std::string>>;

// What was in effect during the measurement, and what it cost.
struct Surroundings {
  clockid_t clock;
  int64_t clock_step_ns;
  std::string start_time;
  std::string end_time;
  std::vector<ThreadState> threads;
  Facts facts;  // of the middleware
  bool memory_locked = false;
  std::optional<int32_t> cpu_dma_latency_us;
  std::optional<Costs> costs;  // none of a measurement that did not begin

  explicit Surroundings(clockid_t clock);  // before the measurement
  void begin() { begin_ = costs_so_far(); }
  void end();
  void finish();  // after end(), while every thread still runs as it did

 private:
  std::optional<Costs> begin_;
};

// What a program did, and how often it should have: measurements, messages, calls of a timer.
struct Rate {
  std::optional<int64_t> asked_hz;
  std::optional<double> achieved_hz;  // none of less than two
  std::optional<int64_t> overruns;    // none where nothing is done periodically
  std::optional<int64_t> skipped;
};

// Of `count` events, of which the first and the last came at these times.
std::optional<double> frequency_hz(std::size_t count, int64_t first_ns, int64_t last_ns);

struct LogFile {
  std::string ending;  // "-measured.log"
  const Series* series;
};

struct Report {
  Report(const Program& of_program, const Options& with_options) : program(&of_program), options(&with_options) {}

  const Program* program;
  const Options* options;
  std::string incomplete_reason;  // empty: complete
  int64_t asked = 0;
  int64_t measured = 0;
  Events not_fired, missing, duplicate, out_of_order;
  Rate rate;
  const OutlierTrace* traces = nullptr;
  std::vector<const Series*> series;
  std::string title;
  std::vector<std::string> heading;  // lines for standard output only
  std::vector<std::string> lines;    // the summary
  Plot plot = Plot::oneshot;
  std::vector<LogFile> logs;
};

// What the json of every program begins with, and its `rate`.
void write_head(Json& json, const Program& program, const Options& options, const std::string& incomplete_reason,
                const Surroundings& surroundings);
void write_rate(Json& json, const Rate& rate);

std::string json_of(const Report& report, const Surroundings& surroundings, const Destination& destination);

// Prints the summary, then writes npy, logs and, last, the json that names them. Throws Failure.
void write_report(Report& report, const Surroundings& surroundings, const Destination& destination,
                  const int64_t* rows, std::size_t row_count, std::size_t columns);

}  // namespace rt_tests
