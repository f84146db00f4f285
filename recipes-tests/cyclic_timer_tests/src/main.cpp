// Measures the jitter of the ROS cyclic timer.
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include "jitter.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"

namespace {

const rt_tests::Program program =
    rt_tests::described("cyclic_timer_tests", "Measures the jitter of the ROS cyclic timer.");

using Session = rt_tests::MeasurementSession<cyclic::columns>;

void measure(const rt_tests::Options& options, Session& session) {
  const clockid_t clock = session.clock();
  cyclic::Samples& samples = session.samples;
  const int64_t period_ns = cyclic::grid_ns(1, options.number("frequency_hz"));
  const ros::Duration period(static_cast<int32_t>(period_ns / rt_tests::ns_per_s),
                             static_cast<int32_t>(period_ns % rt_tests::ns_per_s));
  const bool by_jitter = options.text("trace_of") == "jitter";
  bool broke = false;  // by --break-trace
  int64_t previous_ns = 0, previous_expected_ns = 0;

  ros::NodeHandle node;
  const boost::function<void(const ros::TimerEvent&)> callback = [&](const ros::TimerEvent& event) {
    const int64_t now_ns = rt_tests::now_ns(clock);
    const auto expected_ns = static_cast<int64_t>(event.current_expected.toNSec());
    const auto real_ns = static_cast<int64_t>(event.current_real.toNSec());
    if (broke || !samples.append({now_ns, expected_ns, real_ns})) return;
    const auto rows = static_cast<int64_t>(samples.size());
    const int64_t value_ns = by_jitter
                                 ? now_ns - previous_ns - period_ns
                                 : cyclic::lateness_ns(previous_expected_ns, expected_ns, real_ns, period_ns);
    broke = rows > 1 && session.outliers.exceeded(value_ns, rows - 2, now_ns);
    previous_ns = now_ns;
    previous_expected_ns = expected_ns;
  };
  session.begin();
  ros::Timer timer = node.createTimer(period, callback);
  while (!samples.full() && !broke && !rt_tests::stop_requested()) {
    if (!ros::ok()) rt_tests::request_stop();
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
  }
  session.end();
  timer.stop();
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  const std::string repetitions = std::to_string(options.number("repetitions"));
  const std::string frequency = std::to_string(options.number("frequency_hz"));
  Session session(program, options,
                  "cyclic_timer_tests_l" + repetitions + "_fq" + frequency + rt_tests::policy_suffix(options),
                  options.number("repetitions") + 1, cyclic::grid_ns(1, options.number("frequency_hz")));

  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  rt_tests::info("Performing latency measurements...");
  measure(options, session);
  session.tear_down();
  ros::shutdown();

  rt_tests::Series jitter("jitter", rt_tests::Rounding::down), grid("grid", rt_tests::Rounding::down);
  rt_tests::Series lateness("lateness", rt_tests::Rounding::down);
  const int64_t frequency_hz = options.number("frequency_hz");
  const cyclic::Samples& samples = session.samples;
  cyclic::analyse(samples, frequency_hz, jitter, grid);
  cyclic::analyse_lateness(samples, frequency_hz, lateness);
  const cyclic::Overruns overruns = cyclic::count_overruns(samples, frequency_hz);
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
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
