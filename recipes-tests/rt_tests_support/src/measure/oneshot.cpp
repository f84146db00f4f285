#include "rt_tests_support/measure/oneshot.h"

namespace oneshot {
namespace {

bool is_busy(const rt_tests::Options& options) { return options.number("busy_mode") == 1; }

std::string title(const rt_tests::Options& options) {
  std::string text =
      "timer_tests plot " + rt_tests::machine_title() + " -  " + options.text("repetitions") + " samples  ";
  if (rt_tests::is_realtime(options)) text += "test node RT " + options.text("policy") + (is_busy(options) ? "; " : "");
  return text + (is_busy(options) ? "busy mode" : "");
}

}  // namespace

std::string mode(const rt_tests::Options& options) { return is_busy(options) ? "busy" : "default"; }

std::string output(const rt_tests::Options& options) {
  return "oneshot_timer_tests_l" + std::to_string(options.number("repetitions")) + "_tm" +
         std::to_string(options.number("timeout_us")) + rt_tests::policy_suffix(options) +
         (is_busy(options) ? "-bm" : "");
}

void report(Session& session, const rt_tests::Options& options) {
  const std::string repetitions = std::to_string(options.number("repetitions"));
  const std::string timeout = std::to_string(options.number("timeout_us"));
  const Results results(session.samples);
  rt_tests::Report& report = session.report;
  report.measured = results.measured.n();
  report.rate.achieved_hz = session.frequency_hz(0);
  report.series = {&results.measured, &results.reported, &results.difference, &results.measured_2014,
                   &results.difference_2014};
  report.plot = rt_tests::Plot::oneshot;
  report.logs = {{"-measured.log", &results.measured_2014},
                 {"-reported.log", &results.reported},
                 {"-diff.log", &results.difference_2014}};
  report.title = title(options);
  report.lines = {"Measurement results with a loop length of " + repetitions + " and a timeout of " + timeout + " us:",
                  "Measured:\t" + rt_tests::extremes(results.measured_2014, " ", " \t"),
                  "Reported:\t" + rt_tests::extremes(results.reported, " ", " \t"),
                  "Difference:\t" + rt_tests::extremes(results.difference_2014, "", "\t")};
  if (report.not_fired.count() > 0) {
    report.lines.push_back(std::to_string(report.not_fired.count()) + " timers didn't fire!");
  }
  for (const auto& line : rt_tests::boundary_lines(results.measured_2014)) report.lines.push_back(line);
  session.write(session.samples.full() ? "" : rt_tests::stop_reason());
}

}  // namespace oneshot
