#include "rt_tests_support/measure/cyclic.h"

namespace cyclic {

std::string output(const rt_tests::Options& options) {
  return "cyclic_timer_tests_l" + std::to_string(options.number("repetitions")) + "_fq" +
         std::to_string(options.number("frequency_hz")) + rt_tests::policy_suffix(options);
}

void report(Session& session, const rt_tests::Options& options) {
  const std::string repetitions = std::to_string(options.number("repetitions"));
  const int64_t frequency_hz = options.number("frequency_hz");
  const std::string frequency = std::to_string(frequency_hz);
  rt_tests::Series jitter("jitter", rt_tests::Rounding::down), grid("grid", rt_tests::Rounding::down);
  rt_tests::Series lateness("lateness", rt_tests::Rounding::down);
  analyse(session.samples, frequency_hz, jitter, grid);
  analyse_lateness(session.samples, frequency_hz, lateness);
  const Overruns overruns = count_overruns(session.samples, frequency_hz);
  rt_tests::Report& report = session.report;
  report.measured = jitter.n();
  report.rate = {frequency_hz, session.frequency_hz(0), overruns.overruns, overruns.skipped};
  report.series = {&jitter, &grid, &lateness};
  report.plot = rt_tests::Plot::cyclic;
  report.logs = {{".log", &jitter}};
  report.title = "cyclic_timer_tests plot " + rt_tests::machine_title() + " -  " + repetitions +
                 " samples;  Frequency: " + frequency + "Hz";
  if (rt_tests::is_realtime(options)) report.title += ";  test node RT " + options.text("policy");
  report.lines = {"Measurement results with a total of " + repetitions + " measurements and a frequency of " +
                      frequency + "Hz:",
                  "Jitter:\t" + rt_tests::extremes(jitter, "", "\t")};
  for (const auto& line : rt_tests::boundary_lines(jitter)) report.lines.push_back(line);
  session.write(session.samples.full() ? "" : rt_tests::stop_reason());
}

}  // namespace cyclic
