// The program that measures a one-shot timer, through any middleware.
#pragma once

#include "rt_tests_support/errors.h"
#include "rt_tests_support/measure/shots.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"

namespace oneshot {

using Session = rt_tests::MeasurementSession<columns>;

constexpr int64_t wait_limit_ns = 5 * rt_tests::ns_per_s;  // a timer that is later than this did not fire
constexpr int64_t first_timeout_ns = 10000000;             // of the shot that is not measured

std::string output(const rt_tests::Options& options);  // without prefix and ending
std::string mode(const rt_tests::Options& options);
void report(Session& session, const rt_tests::Options& options);

// The measuring thread runs the callbacks itself; in busy mode it never sleeps meanwhile.
template <class Context, class Timer>
class SpinningWaiter {
 public:
  SpinningWaiter(const rt_tests::Options& options, Context& context, Timer& timer, ShotBox& box)
      : context_(context),
        timer_(timer),
        box_(box),
        limit_ns_(options.number("busy_mode") == 1 ? 0 : rt_tests::spin_limit_ns) {}

  // Waits until the shot is settled. False if a stop is requested first.
  bool wait() {
    while (!box_.settle()) {
      if (!context_.ok()) rt_tests::request_stop();
      if (rt_tests::stop_requested()) return false;
      timer_.spin(limit_ns_);
    }
    return true;
  }

 private:
  Context& context_;
  Timer& timer_;
  ShotBox& box_;
  const int64_t limit_ns_;
};

// A middleware whose callbacks the measuring thread runs.
template <class Middleware>
struct Spinning : Middleware {
  template <class Timer>
  using Waiter = SpinningWaiter<typename Middleware::Context, Timer>;
};

// What a middleware makes with the first shot, above all threads, is not measured.
template <class Context, class Timer>
void fire_first(Context& context, Timer& timer, const bool& fired) {
  const int64_t begin_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
  timer.start(first_timeout_ns);
  while (!fired && !rt_tests::stop_requested()) {
    if (!context.ok()) rt_tests::request_stop();
    if (rt_tests::now_ns(CLOCK_MONOTONIC) - begin_ns > wait_limit_ns) {
      throw rt_tests::Failure(std::string("the first ROS timer did not fire within 5 s") + Timer::never_fired);
    }
    timer.spin(rt_tests::spin_limit_ns);
  }
}

// However the measurement ends, its semaphore ends with it, and signals may come later.
struct WakesNobody {
  ~WakesNobody() { rt_tests::catch_stop_signals(nullptr); }
};

template <class Middleware>
void measure(const rt_tests::Options& options, Session& session, typename Middleware::Context& context) {
  const clockid_t clock = session.clock();
  const int64_t timeout_ns = options.number("timeout_us") * rt_tests::ns_per_us;
  ShotBox box(clock, timeout_ns + wait_limit_ns);
  const WakesNobody afterwards;
  bool fired = false;
  const auto call_back = [&](int64_t expected_ns, int64_t real_ns) {
    const int64_t end_ns = rt_tests::now_ns(clock);
    box.fire(end_ns, real_ns - expected_ns);
    fired = true;
  };
  using Timer = typename Middleware::template Timer<decltype(call_back)>;
  Timer timer(context, rt_tests::Repeats::no, timeout_ns, call_back);
  session.begin(box.semaphore());
  fire_first(context, timer, fired);
  {
    typename Middleware::template Waiter<Timer> waiter(options, context, timer, box);
    session.surroundings.begin();
    measure(
        clock, timeout_ns, box, session.samples, session.report.not_fired, session.outliers, [&] { timer.arm(); },
        [&] { timer.cancel(); }, [&] { return waiter.wait(); });
    session.end();
  }
}

template <class Middleware>
int run(int argc, char* argv[]) {
  const rt_tests::Program program = rt_tests::described(
      "oneshot_timer_tests", Middleware::name, "Measures the latency of the ROS one-shot timer.");
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  Session session(program, options, output(options), options.number("repetitions"),
                  options.number("timeout_us") * rt_tests::ns_per_us, latency_of);
  session.set_policy();
  typename Middleware::Context context(argc, argv, program, options);
  rt_tests::add_facts(session.surroundings.facts, context);
  rt_tests::info("Performing ROS Timer latency measurements...");
  rt_tests::info("Running in " + mode(options) + " mode");
  measure<Middleware>(options, session, context);
  session.tear_down();
  context.shutdown();
  report(session, options);
  return 0;
}

template <class Middleware>
int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run<Middleware>(argc, argv); });
}

}  // namespace oneshot
