// Measures the jitter of the ROS cyclic timer.
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include "jitter.h"
#include "rt_tests_support/blocks.h"
#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/report.h"
#include "rt_tests_support/stop.h"
#include "rt_tests_support/trace.h"

namespace {

const rt_tests::Program program = {"cyclic_timer_tests",
                                   "cyclic_timer_tests",
                                   "Measures the jitter of the ROS cyclic timer.",
                                   {"policy", "repetitions", "prefix", "frequency_hz", "priority", "cpu", "clock",
                                    "out_dir", "rt_scope", "break_trace_us", "trace_threshold_us"}};

void measure(const rt_tests::Options& options, cyclic::Samples& samples, rt_tests::OutlierTrace& outliers,
             rt_tests::Surroundings& surroundings) {
  const clockid_t clock = surroundings.clock;
  const int64_t period_ns = cyclic::grid_ns(1, options.number("frequency_hz"));
  const ros::Duration period(static_cast<int32_t>(period_ns / rt_tests::ns_per_s),
                             static_cast<int32_t>(period_ns % rt_tests::ns_per_s));
  bool broke = false;
  int64_t last_ns = 0;

  ros::NodeHandle node;
  const boost::function<void(const ros::TimerEvent&)> callback = [&](const ros::TimerEvent&) {
    const int64_t now_ns = rt_tests::now_ns(clock);
    if (broke || !samples.append({now_ns})) return;
    const auto rows = static_cast<int64_t>(samples.size());
    broke = rows > 1 && outliers.exceeded(now_ns - last_ns - period_ns, rows - 2, now_ns);
    last_ns = now_ns;
  };
  ros::Timer timer = node.createTimer(period, callback);

  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(nullptr);
  while (!samples.full() && !broke && !rt_tests::stop_requested()) {
    if (!ros::ok()) rt_tests::request_stop();
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
  }
  surroundings.finish();
  timer.stop();
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  const std::string repetitions = std::to_string(options.number("repetitions"));
  const std::string frequency = std::to_string(options.number("frequency_hz"));
  const auto destination = rt_tests::destination(
      options, "cyclic_timer_tests_l" + repetitions + "_fq" + frequency + rt_tests::policy_suffix(options));
  rt_tests::set_up_process(options);
  rt_tests::OutlierTrace outliers(options, program.name, destination.path(""));
  rt_tests::require_memory(options.number("repetitions") * int64_t{sizeof(cyclic::Samples::Row)});
  cyclic::Samples samples(static_cast<std::size_t>(options.number("repetitions")) + 1);
  rt_tests::Blocks blocks(destination.path(".npy"), samples,
                          cyclic::grid_ns(options.number("repetitions"), options.number("frequency_hz")));
  rt_tests::Report report(program, options);
  rt_tests::Surroundings surroundings(rt_tests::clock_of(options.text("clock")));

  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  rt_tests::info("Performing latency measurements...");
  measure(options, samples, outliers, surroundings);
  rt_tests::give_up_realtime();
  outliers.finish();
  ros::shutdown();

  rt_tests::Series jitter("jitter"), grid("grid");
  cyclic::analyse(samples, options.number("frequency_hz"), jitter, grid);
  report.asked = options.number("repetitions");
  report.measured = jitter.n();
  report.incomplete_reason = outliers.reason();
  report.traces = &outliers;
  if (report.incomplete_reason.empty() && !samples.full()) report.incomplete_reason = rt_tests::stop_reason();
  report.series = {&jitter, &grid};
  report.plot = rt_tests::Plot::cyclic;
  report.logs = {{".log", &jitter}};
  report.title = "cyclic_timer_tests plot " + rt_tests::machine_title() + " -  " + repetitions +
                 " samples;  Frequency: " + frequency + "Hz";
  if (rt_tests::is_realtime(options)) report.title += ";  test node RT " + options.text("policy");
  report.lines = {"Measurement results with a total of " + repetitions + " measurements and a frequency of " +
                      frequency + "Hz:",
                  "Jitter:\t" + rt_tests::extremes(jitter, "", "\t")};
  for (const auto& line : rt_tests::boundary_lines(jitter)) report.lines.push_back(line);
  rt_tests::write_report(report, surroundings, destination, samples.data(), samples.size(), 1);
  blocks.discard();
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
