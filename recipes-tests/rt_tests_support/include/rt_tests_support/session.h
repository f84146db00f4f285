// A measurement from its set-up to its results: the steps that every measuring program takes, in their order.
#pragma once

#include <semaphore.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "rt_tests_support/blocks.h"
#include "rt_tests_support/clock.h"
#include "rt_tests_support/options.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/report.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/stop.h"
#include "rt_tests_support/trace.h"

namespace rt_tests {

// Columns is the number of columns of the samples. The members are made in the order in which they are declared: the
// process is set up before any memory of the measurement is allocated, and all of it before the process gets its policy.
template <std::size_t Columns>
class MeasurementSession {
  const Options& options_;
  const Destination destination_;
  const ProcessSetUp process_;
  const CpuDmaLatency cpu_dma_latency_;

 public:
  OutlierTrace outliers;
  Samples<Columns> samples;

 private:
  Blocks blocks_;

 public:
  Report report;
  Surroundings surroundings;

  // `output` is the name of the output without prefix and ending, `rows` the number of samples, and `period_ns` the
  // time from one to the next. `value_of(samples, row)` is the value of a row, for the figures so far. Throws UsageError
  // or Failure if the measurement cannot be made.
  template <class ValueOf>
  MeasurementSession(const Program& program, const Options& options, const std::string& output, int64_t rows,
                     int64_t period_ns, ValueOf value_of)
      : options_(options),
        destination_(destination(options, output)),
        process_(options),
        cpu_dma_latency_(options),
        outliers(options, program.name, destination_.path(""), process_.spare_cpus()),
        samples(available_rows(rows)),
        blocks_(destination_.path(""), samples, rows * std::max(period_ns, shortest_period_ns),
                process_.spare_cpus(), value_of),
        report(program, options),
        surroundings(clock_of(options.text("clock"))) {
    report.asked = options.number("repetitions");
    report.traces = &outliers;
  }

  clockid_t clock() const noexcept { return surroundings.clock; }

  // When all that is measured has its memory, and before the middleware is initialised, whose threads inherit it.
  void set_policy() { process_.set_policy(); }

  // On the measuring thread, once the middleware is initialised, before the first timer: threads that start with it, as
  // roscpp's that waits for the timers, inherit the policy. From here on a signal ends the measurement, and posts `wake`.
  void begin(sem_t* wake = nullptr) {
    set_up_measuring_thread(options_);
    catch_stop_signals(wake);
  }

  // Right after the last measurement, while every thread is as it was.
  void end() {
    surroundings.end();
    surroundings.finish();
  }

  // How often rows came, by the times in a column; none of less than two rows.
  std::optional<double> frequency_hz(std::size_t column) const {
    const std::size_t rows = samples.size();
    return rows == 0 ? std::nullopt : rt_tests::frequency_hz(rows, samples[0][column], samples[rows - 1][column]);
  }

  // Before the middleware is shut down.
  void tear_down() {
    give_up_realtime();
    outliers.finish();
  }

  // Prints the summary and writes the results. `incomplete_reason` is empty if all that was asked for was measured.
  void write(const std::string& incomplete_reason) {
    report.incomplete_reason = outliers.reason().empty() ? incomplete_reason : outliers.reason();
    write_report(report, surroundings, destination_, samples.data(), samples.size(), Columns);
    blocks_.discard();
  }

 private:
  // No measurement takes less, however short its period or timeout is.
  static constexpr int64_t shortest_period_ns = 10 * ns_per_us;

  static std::size_t available_rows(int64_t rows) {
    require_memory(rows * int64_t{sizeof(typename Samples<Columns>::Row)});
    return static_cast<std::size_t>(rows);
  }
};

}  // namespace rt_tests
