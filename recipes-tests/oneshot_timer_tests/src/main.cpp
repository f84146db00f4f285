// Measures the latency of the ROS one-shot timer.
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <atomic>
#include <thread>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"
#include "shots.h"

namespace {

const rt_tests::Program program =
    rt_tests::described("oneshot_timer_tests", "Measures the latency of the ROS one-shot timer.");

using Session = rt_tests::MeasurementSession<oneshot::columns>;

constexpr int64_t wait_limit_ns = 5 * rt_tests::ns_per_s;  // a timer that is later than this did not fire

void spin_once(ros::WallDuration timeout) { ros::getGlobalCallbackQueue()->callAvailable(timeout); }

// roscpp starts its timer thread with the first timer. That shot is not measured.
void fire_once(const bool& fired) {
  const ros::WallTime limit = ros::WallTime::now() + ros::WallDuration(5.0);
  while (!fired && !rt_tests::stop_requested()) {
    if (!ros::ok()) rt_tests::request_stop();
    if (ros::WallTime::now() > limit) {
      rt_tests::catch_stop_signals(nullptr);  // the semaphore ends with the caller
      throw rt_tests::Failure(
          "the first ROS timer did not fire within 5 s: is /use_sim_time set while no clock is published?");
    }
    spin_once(ros::WallDuration(0.1));
  }
}

void measure(const rt_tests::Options& options, Session& session) {
  const clockid_t clock = session.clock();
  const int64_t timeout_ns = options.number("timeout_us") * rt_tests::ns_per_us;
  const ros::Duration timeout(static_cast<int32_t>(timeout_ns / rt_tests::ns_per_s),
                              static_cast<int32_t>(timeout_ns % rt_tests::ns_per_s));
  oneshot::ShotBox box(clock, timeout_ns + wait_limit_ns);
  bool fired_first = false;

  ros::NodeHandle node;
  const boost::function<void(const ros::TimerEvent&)> callback = [&](const ros::TimerEvent& event) {
    const int64_t end_ns = rt_tests::now_ns(clock);
    box.fire(end_ns, static_cast<int64_t>(event.current_real.toNSec()) -
                         static_cast<int64_t>(event.current_expected.toNSec()));
    fired_first = true;
  };
  session.begin(box.semaphore());
  ros::Timer timer = node.createTimer(ros::Duration(0.01), callback, true);
  fire_once(fired_first);

  // setPeriod arms a timer that was started before. After cancel(), start arms it.
  const auto trigger = [&] {
    timer.setPeriod(timeout);
    timer.start();
  };
  const auto cancel = [&] { timer.stop(); };
  const auto measure_shots = [&](auto wait) {
    oneshot::measure(clock, timeout_ns, box, session.samples, session.report.not_fired, session.outliers, trigger,
                     cancel, wait);
    session.end();
  };

  if (options.number("busy_mode") == 1) {
    measure_shots([&] {
      while (!box.settle()) {
        if (!ros::ok()) rt_tests::request_stop();
        if (rt_tests::stop_requested()) return false;
        ros::spinOnce();
      }
      return true;
    });
  } else {
    std::atomic<bool> ended{false};
    std::thread spinner([&] {
      while (!ended && ros::ok()) {
        spin_once(ros::WallDuration(0.1));
        if (box.settle()) box.wake();
      }
      if (!ros::ok()) rt_tests::request_stop();
    });
    measure_shots([&] { return box.wait(); });
    ended = true;
    spinner.join();
  }
  rt_tests::catch_stop_signals(nullptr);  // the semaphore ends with this function
}

std::string title(const rt_tests::Options& options) {
  const bool busy = options.number("busy_mode") == 1;
  std::string text =
      "timer_tests plot " + rt_tests::machine_title() + " -  " + options.text("repetitions") + " samples  ";
  if (rt_tests::is_realtime(options)) text += "test node RT " + options.text("policy") + (busy ? "; " : "");
  return text + (busy ? "busy mode" : "");
}

int run(int argc, char* argv[]) {
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  const bool busy = options.number("busy_mode") == 1;
  const std::string repetitions = std::to_string(options.number("repetitions"));
  const std::string timeout = std::to_string(options.number("timeout_us"));
  Session session(program, options,
                  "oneshot_timer_tests_l" + repetitions + "_tm" + timeout + rt_tests::policy_suffix(options) +
                      (busy ? "-bm" : ""),
                  options.number("repetitions"), options.number("timeout_us") * rt_tests::ns_per_us);

  ros::init(argc, argv, program.name, ros::init_options::NoSigintHandler);
  rt_tests::info("Performing ROS Timer latency measurements...");
  rt_tests::info(busy ? "Running in busy mode" : "Running in default mode");
  measure(options, session);
  session.tear_down();
  ros::shutdown();

  const oneshot::Results results(session.samples);
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
  return 0;
}

}  // namespace

int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run(argc, argv); });
}
