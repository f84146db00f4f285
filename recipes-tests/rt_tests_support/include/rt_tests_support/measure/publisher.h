// The program that publishes time-stamped messages, through any middleware.
#pragma once

#include "rt_tests_support/errors.h"
#include "rt_tests_support/measure/messages.h"
#include "rt_tests_support/measure/pace.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/report.h"

namespace communication {

struct Published {
  int64_t messages = 0;
  rt_tests::Rate rate;
};

void pause(int64_t ns);  // returns sooner if a stop is requested

// Writes the json, and throws Failure unless all messages were sent. `problem` is why the middleware could not go on.
void report(const rt_tests::Program& program, const rt_tests::Options& options, const rt_tests::Destination& destination,
            const rt_tests::Surroundings& surroundings, const Published& published, const std::string& problem);

template <class Publisher, class Context>
Published publish(const rt_tests::Options& options, clockid_t clock, Context& context, Publisher& publisher) {
  const int64_t count = options.number("repetitions");
  const int64_t frequency_hz = options.number("frequency_hz");
  static_assert(noexcept(publisher.publish({})), "what a send throws is kept in Sending");
  Pace pace(frequency_hz);
  int64_t sent = 0, first_ns = 0, publication_ns = 0;
  while (true) {
    const int64_t now_ns = rt_tests::now_ns(clock);
    if (!publisher.publish({now_ns, static_cast<uint32_t>(sent), sent == count - 1})) break;
    publication_ns = now_ns;
    if (sent == 0) first_ns = publication_ns;
    ++sent;
    if (!context.ok()) rt_tests::request_stop();
    if (sent == count || !pace.wait()) break;
  }
  return {sent, {frequency_hz, rt_tests::frequency_hz(static_cast<std::size_t>(sent), first_ns, publication_ns),
                 pace.overruns(), pace.skipped()}};
}

// Waits until so many subscribers are connected. Throws Failure when they are not in time.
template <class Publisher, class Context>
void wait_for_subscribers(int64_t awaited, Context& context, Publisher& publisher, int64_t limit_s = 60) {
  const int64_t begin_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
  while (!rt_tests::stop_requested()) {
    const int64_t connected = publisher.subscribers();
    if (connected >= awaited) return;
    if (rt_tests::now_ns(CLOCK_MONOTONIC) - begin_ns > limit_s * rt_tests::ns_per_s) {
      throw rt_tests::Failure(std::to_string(connected) + " of " + std::to_string(awaited) +
                              " subscribers were connected after " + std::to_string(limit_s) + " s");
    }
    if (!context.ok()) rt_tests::request_stop();
    pause(10000000);
  }
}

// Messages may still be queued, and would be lost with the publisher. Our subscribers leave after the last message; other
// subscribers may stay, hence the limit.
template <class Publisher, class Context>
void wait_for_subscribers_to_leave(Context& context, Publisher& publisher) {
  const int64_t limit_ns = rt_tests::now_ns(CLOCK_MONOTONIC) + 5 * rt_tests::ns_per_s;
  // `pause` returns at once when it is to stop.
  while (!rt_tests::stop_requested() && publisher.subscribers() > 0 && context.ok() &&
         rt_tests::now_ns(CLOCK_MONOTONIC) < limit_ns) {
    pause(10000000);
  }
}

template <class Middleware>
int run_publisher(int argc, char* argv[]) {
  const rt_tests::Program program =
      rt_tests::described("communication_tests_publisher", Middleware::name,
                          "Publishes time-stamped messages for communication_tests_subscriber.");
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  require_payload(options, Middleware::name, Middleware::payload_bytes_max);
  const rt_tests::Destination destination = rt_tests::destination(options, output(options));
  const rt_tests::ProcessSetUp set_up(options);
  const rt_tests::CpuDmaLatency cpu_dma_latency(options);
  rt_tests::Surroundings surroundings(rt_tests::clock_of(options.text("clock")));
  set_up.set_policy();
  typename Middleware::Context context(argc, argv, program, options);
  typename Middleware::Publisher publisher(context, options);
  rt_tests::add_facts(surroundings.facts, context);
  rt_tests::add_facts(surroundings.facts, publisher);
  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(nullptr);

  // roscpp's publisher, as that of 2014, waits for nobody and lets subscribers come later, too.
  const bool counts_subscribers = options.has("awaited_subscribers");
  if (counts_subscribers) wait_for_subscribers(options.number("awaited_subscribers"), context, publisher);
  pause(options.number("start_delay_s") * rt_tests::ns_per_s);
  if (counts_subscribers) publisher.subscribers();
  Published published{0, {options.number("frequency_hz"), std::nullopt, 0, 0}};
  surroundings.begin();
  if (!rt_tests::stop_requested()) published = publish(options, surroundings.clock, context, publisher);
  surroundings.end();
  if (published.messages == options.number("repetitions")) wait_for_subscribers_to_leave(context, publisher);
  surroundings.finish();  // not before: reading the threads takes CPU time that the last message may need
  rt_tests::give_up_realtime();
  context.shutdown();
  report(program, options, destination, surroundings, published, publisher.problem());
  rt_tests::info("Done publishing...");
  return 0;
}

template <class Middleware>
int publisher_main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run_publisher<Middleware>(argc, argv); });
}

}  // namespace communication
