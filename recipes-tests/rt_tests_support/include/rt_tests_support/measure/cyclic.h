// The program that measures a cyclic timer, through any middleware.
#pragma once

#include "rt_tests_support/errors.h"
#include "rt_tests_support/measure/jitter.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"

namespace cyclic {

using Session = rt_tests::MeasurementSession<columns>;

std::string output(const rt_tests::Options& options);  // without prefix and ending
void report(Session& session, const rt_tests::Options& options);

template <class Middleware>
void measure(const rt_tests::Options& options, Session& session, typename Middleware::Context& context) {
  const clockid_t clock = session.clock();
  Samples& samples = session.samples;
  const int64_t period_ns = grid_ns(1, options.number("frequency_hz"));
  const bool by_jitter = options.text("trace_of") == "jitter";
  bool broke = false;  // by --break-trace
  int64_t previous_ns = 0, previous_expected_ns = 0;

  const auto call_back = [&](int64_t expected_ns, int64_t real_ns) {
    const int64_t now_ns = rt_tests::now_ns(clock);
    if (broke || !samples.append({now_ns, expected_ns, real_ns})) return;
    const auto rows = static_cast<int64_t>(samples.size());
    const int64_t value_ns = by_jitter ? now_ns - previous_ns - period_ns
                                       : lateness_ns(previous_expected_ns, expected_ns, real_ns, period_ns);
    broke = rows > 1 && session.outliers.exceeded(value_ns, rows - 2, now_ns);
    previous_ns = now_ns;
    previous_expected_ns = expected_ns;
  };
  typename Middleware::template Timer<decltype(call_back)> timer(context, rt_tests::Repeats::yes, period_ns, call_back);
  session.begin();
  timer.start(period_ns);
  session.surroundings.begin();  // threads that start with the timer are not what measuring costs
  while (!samples.full() && !broke && !rt_tests::stop_requested()) {
    if (!context.ok()) rt_tests::request_stop();
    timer.spin(rt_tests::spin_limit_ns);
  }
  session.end();
  timer.cancel();
}

template <class Middleware>
int run(int argc, char* argv[]) {
  const rt_tests::Program program =
      rt_tests::described("cyclic_timer_tests", Middleware::name, "Measures the jitter of the ROS cyclic timer.");
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  Session session(program, options, output(options), options.number("repetitions") + 1,
                  grid_ns(1, options.number("frequency_hz")),
                  [frequency_hz = options.number("frequency_hz")](const Samples& samples, std::size_t row) {
                    return lateness_of(samples, row, frequency_hz);
                  });
  session.set_policy();
  typename Middleware::Context context(argc, argv, program, options);
  rt_tests::add_facts(session.surroundings.facts, context);
  rt_tests::info("Performing latency measurements...");
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

}  // namespace cyclic
