// The program that measures the latency of messages, through any middleware.
#pragma once

#include <string>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/measure/messages.h"
#include "rt_tests_support/measure/receptions.h"
#include "rt_tests_support/measure/silence.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/programs.h"
#include "rt_tests_support/session.h"

namespace communication {

using Session = rt_tests::MeasurementSession<columns>;

// `ended_by` is what ended the measurement before the last message, empty if nothing did.
void report(Session& session, const rt_tests::Options& options, const Receptions& receptions,
            const std::string& ended_by);

// Receives until the last message. Returns what ended the measurement before that, empty if nothing did.
template <class Middleware>
std::string receive(const rt_tests::Options& options, Session& session, Receptions& receptions,
                    typename Middleware::Context& context) {
  const clockid_t clock = session.clock();
  bool broke = false;  // by --break-trace
  std::size_t received = 0;

  const auto call_back = [&](const rt_tests::Stamp& stamp) {
    const int64_t reception_ns = rt_tests::now_ns(clock);
    if (broke || receptions.last_came()) return;
    ++received;
    receptions.receive(stamp.publication_ns, reception_ns, stamp.seq, stamp.last);
    broke = session.outliers.exceeded(reception_ns - stamp.publication_ns, stamp.seq, reception_ns);
  };
  typename Middleware::template Subscriber<decltype(call_back)> subscriber(context, options, call_back);
  rt_tests::add_facts(session.surroundings.facts, context);
  rt_tests::add_facts(session.surroundings.facts, subscriber);

  session.begin();
  Silence silence(options);
  std::string ended_by;
  std::size_t before = 0;
  while (!receptions.last_came() && !broke && !rt_tests::stop_requested() && ended_by.empty()) {
    if (!context.ok()) rt_tests::request_stop();
    subscriber.receive(rt_tests::spin_limit_ns);
    if (received == before) ended_by = silence.reason_to_end(received, subscriber.publishers());
    // The first message is start-up: what comes after it is what measuring costs.
    if (before == 0 && received > 0) session.surroundings.begin();
    before = received;
  }
  session.end();
  if (ended_by.empty()) ended_by = rt_tests::stop_reason();
  // Where nothing came, the publisher may have seen no subscriber: each side tells whom it saw.
  if (received == 0 && !ended_by.empty()) {
    ended_by += " (" + std::to_string(subscriber.publishers()) + " publishers seen)";
  }
  return ended_by;
}

template <class Middleware>
int run_subscriber(int argc, char* argv[]) {
  const rt_tests::Program program =
      rt_tests::described("communication_tests_subscriber", Middleware::name,
                          "Measures the latency of the messages of communication_tests_publisher.");
  const rt_tests::Options options = rt_tests::parse(program, argc, argv);
  require_payload(options, Middleware::name, Middleware::payload_bytes_max);
  Session session(program, options, output(options), options.number("repetitions"),
                  rt_tests::ns_per_s / options.number("frequency_hz"), latency_of);
  Receptions receptions(session.samples);
  session.set_policy();
  typename Middleware::Context context(argc, argv, program, options);
  const std::string ended_by = receive<Middleware>(options, session, receptions, context);
  session.tear_down();
  context.shutdown();
  report(session, options, receptions, ended_by);
  return 0;
}

template <class Middleware>
int subscriber_main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run_subscriber<Middleware>(argc, argv); });
}

}  // namespace communication
