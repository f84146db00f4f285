// Measures the latency of the ROS one-shot timer.
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <thread>

#include "rt_tests_support/blocks.h"
#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/report.h"
#include "shots.h"

namespace {

const rt_tests::Program program = {
    "oneshot_timer_tests",
    "oneshot_timer_tests",
    "Measures the latency of the ROS one-shot timer.",
    {"policy", "repetitions", "prefix", "timeout_us", "busy_mode", "priority", "cpu", "clock", "out_dir", "rt_scope",
     "break_trace_us", "trace_threshold_us"}};

constexpr int64_t patience_ns = 5 * rt_tests::ns_per_s;  // a timer later than this did not fire

void spin_once(ros::WallDuration timeout) { ros::getGlobalCallbackQueue()->callAvailable(timeout); }

// The first shot starts roscpp's timer thread; what comes after it is alike.
void fire_once(const bool& fired) {
  const ros::WallTime limit = ros::WallTime::now() + ros::WallDuration(5.0);
  while (!fired) {
    if (!ros::ok() || ros::WallTime::now() > limit) {
      throw rt_tests::Failure("the first ROS timer did not fire within 5 s: is /use_sim_time set, and no clock running?");
    }
    spin_once(ros::WallDuration(0.1));
  }
}

void measure(const rt_tests::Options& options, oneshot::Samples& samples, rt_tests::Noted& not_fired,
             rt_tests::OutlierTrace& outliers, rt_tests::Surroundings& surroundings) {
  const clockid_t clock = surroundings.clock;
  const int64_t timeout_ns = options.number("timeout_us") * rt_tests::ns_per_us;
  const ros::Duration timeout(static_cast<int32_t>(timeout_ns / rt_tests::ns_per_s),
                              static_cast<int32_t>(timeout_ns % rt_tests::ns_per_s));
  oneshot::ShotBox box(clock, timeout_ns + patience_ns);
  bool fired_first = false;

  ros::NodeHandle node;
  const boost::function<void(const ros::TimerEvent&)> callback = [&](const ros::TimerEvent& event) {
    const int64_t end_ns = rt_tests::now_ns(clock);
    box.fire(end_ns, static_cast<int64_t>(event.current_real.toNSec()) -
                         static_cast<int64_t>(event.current_expected.toNSec()));
    fired_first = true;
  };
  ros::Timer timer = node.createTimer(ros::Duration(0.01), callback, true);
  fire_once(fired_first);

  // A timer that is started is started again by setPeriod, a stopped one by start.
  const auto trigger = [&] {
    timer.setPeriod(timeout);
    timer.start();
  };
  const auto cancel = [&] { timer.stop(); };

  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(box.semaphore());
  if (options.number("busy_mode") == 1) {
    const auto wait = [&] {
      while (!box.settle()) {
        if (!ros::ok()) rt_tests::request_stop();
        if (rt_tests::stop_requested()) return false;
        ros::spinOnce();
      }
      return true;
    };
    oneshot::measure(clock, timeout_ns, box, samples, not_fired, outliers, trigger, cancel, wait);
    surroundings.finish();
    return;
  }

  std::atomic<bool> ended{false};
  std::thread spinner([&] {
    while (!ended && ros::ok()) {
      spin_once(ros::WallDuration(0.1));
      if (box.settle()) box.wake();
    }
    if (!ros::ok()) rt_tests::request_stop();
  });
  oneshot::measure(clock, timeout_ns, box, samples, not_fired, outliers, trigger, cancel, [&] { return box.wait(); });
  surroundings.finish();
  ended = true;
  spinner.join();
  rt_tests::catch_stop_signals(nullptr);
}

std::string title(const rt_tests::Options& options) {
  const bool busy = options.number("busy_mode") == 1;
  std::string text = "timer_tests plot " + rt_tests::machine_title() + " -  " + options.text("repetitions") + " samples  ";
  if (rt_tests::is_realtime(options)) text += "test node RT " + options.text("policy") + (busy ? "; " : "");
  return text + (busy ? "busy mode" : "");
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  const bool busy = options.number("busy_mode") == 1;
  const auto destination = rt_tests::destination(
      options, "oneshot_timer_tests_l" + std::to_string(options.number("repetitions")) + "_tm" +
                   std::to_string(options.number("timeout_us")) + rt_tests::policy_suffix(options) + (busy ? "-bm" : ""));
  rt_tests::set_up_process(options);
  rt_tests::OutlierTrace outliers(options, program.name, destination.path(""));
  rt_tests::require_memory(options.number("repetitions") * int64_t{sizeof(oneshot::Samples::Row)});
  oneshot::Samples samples(static_cast<std::size_t>(options.number("repetitions")));
  rt_tests::Blocks blocks(destination.path(".npy"), samples,
                          options.number("repetitions") * options.number("timeout_us") * rt_tests::ns_per_us);
  rt_tests::Report report(program, options);
  rt_tests::Surroundings surroundings(rt_tests::clock_of(options.text("clock")));

  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  rt_tests::info("Performing ROS Timer latency measurements...");
  rt_tests::info(busy ? "Running in busy mode" : "Running in default mode");
  measure(options, samples, report.not_fired, outliers, surroundings);
  rt_tests::give_up_realtime();
  outliers.finish();
  ros::shutdown();

  rt_tests::Series measured("measured"), reported("reported"), difference("difference");
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const auto& [start_ns, end_ns, measured_ns, reported_ns] = samples[i];
    if (end_ns == oneshot::did_not_fire) continue;
    const auto index = static_cast<int64_t>(i);
    measured.add(measured_ns, index);
    reported.add(reported_ns, index);
    difference.add(reported_ns - measured_ns, index);
  }
  report.asked = options.number("repetitions");
  report.measured = measured.n();
  report.incomplete_reason = outliers.reason();
  report.traces = &outliers;
  if (report.incomplete_reason.empty() && !samples.full()) report.incomplete_reason = rt_tests::stop_reason();
  report.series = {&measured, &reported, &difference};
  report.plot = rt_tests::Plot::oneshot;
  report.logs = {{"-measured.log", &measured}, {"-reported.log", &reported}, {"-diff.log", &difference}};
  report.title = title(options);
  report.lines = {"Measurement results with a loop length of " + std::to_string(options.number("repetitions")) +
                      " and a timeout of " + std::to_string(options.number("timeout_us")) + " us:",
                  "Measured:\t" + rt_tests::extremes(measured, " ", " \t"),
                  "Reported:\t" + rt_tests::extremes(reported, " ", " \t"),
                  "Difference:\t" + rt_tests::extremes(difference, "", "\t")};
  if (report.not_fired.count() > 0) {
    report.lines.push_back(std::to_string(report.not_fired.count()) + " timers didn't fire!");
  }
  for (const auto& line : rt_tests::boundary_lines(measured)) report.lines.push_back(line);
  rt_tests::write_report(report, surroundings, destination, samples.data(), samples.size(), 4);
  blocks.discard();
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
