// Through what a suite measures. The measurements of measure/ are templates over a type like this one; what it does in the
// loops neither allocates, locks, prints nor throws by itself.
//
//   struct M {
//     static constexpr char name[] = "m";            // in the json; its programs are called <program>_m
//     static constexpr int64_t payload_bytes_max;    // where there are messages: what one can carry
//
//     // The process is set up by then: threads that start from here on inherit policy, priority and CPUs.
//     struct Context {
//       Context(int argc, char* argv[], const Program& program, const Options& options);  // throws Failure
//       bool ok();        // false: the middleware asks the program to end
//       void shutdown();  // once, after the last measurement
//       Facts facts();    // what is in effect of it, for the json; only where there is something to say
//     };
//
//     // Calls call_back(expected_ns, real_ns) on the thread that calls spin(): when the call was due, and when it was made, as
//     // M says on its own clock. It lives as long as the timer.
//     template <class CallBack>
//     struct Timer {
//       static constexpr char never_fired[];  // ends the sentence that says so: what may be the reason, or empty
//       Timer(Context& context, Repeats repeats, int64_t period_ns, CallBack& call_back);
//       void start(int64_t first_ns);  // due after so long, the first time: M may start threads
//       void arm();                    // due after period_ns, once it has fired or was cancelled
//       void cancel();                 // afterwards the callback neither runs nor will run
//       void spin(int64_t limit_ns);   // calls back for what is due, or waits for that, at most so long
//     };
//
//     // How the measuring thread learns what became of a one-shot: SpinningWaiter of measure/oneshot.h, or its own.
//     template <class Timer>
//     using Waiter = oneshot::SpinningWaiter<Context, Timer>;
//
//     struct Publisher {
//       Publisher(Context& context, const Options& options);  // throws Failure
//       bool publish(const Stamp& stamp) noexcept;            // false: no further message can be sent
//       std::string problem();                                // why, after that
//       int64_t subscribers();                                // how many are connected; not called between messages
//       Facts facts();                                        // as that of the context
//     };
//
//     // Calls call_back(stamp) for each message, on the thread that calls receive().
//     template <class CallBack>
//     struct Subscriber {
//       Subscriber(Context& context, const Options& options, CallBack& call_back);  // throws Failure
//       void receive(int64_t limit_ns);  // takes what has come, or waits for that, at most so long
//       int64_t publishers();            // how many are connected
//       Facts facts();                   // as that of the context
//     };
//   };
#pragma once

#include <cstdint>
#include <exception>
#include <string>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/options.h"
#include "rt_tests_support/report.h"

namespace rt_tests {

enum class Repeats { no, yes };

// How long a program waits for a middleware before it looks whether it is to end.
constexpr int64_t spin_limit_ns = 100000000;

// What every message carries beside its payload.
struct Stamp {
  int64_t publication_ns;
  uint32_t seq;
  bool last;
};

// Keeps what a send threw. A loop that measures must neither unwind nor terminate the program by it: it ends, and says why.
class Sending {
 public:
  // False, here and in no other case, where `send` throws.
  template <class Send>
  bool succeeds(Send send) noexcept {
    try {
      send();
      return true;
    } catch (...) {
      thrown_ = std::current_exception();
      return false;
    }
  }
  // Empty, if nothing was thrown.
  std::string problem(const std::string& middleware) const {
    return thrown_ ? middleware + ": cannot publish: " + text_of(thrown_) : "";
  }

 private:
  std::exception_ptr thrown_;
};

// Adds what a context, a publisher or a subscriber says is in effect of it.
template <class Part>
auto add_facts(Facts& facts, Part& part, int) -> decltype(part.facts(), void()) {
  for (const auto& fact : part.facts()) facts.push_back(fact);
}
template <class Part>
void add_facts(Facts&, Part&, long) {}  // of one that says nothing
template <class Part>
void add_facts(Facts& facts, Part& part) {
  add_facts(facts, part, 0);
}

// Of a middleware that has none.
struct NoContext {
  NoContext(int, char*[], const Program&, const Options&) {}
  bool ok() const noexcept { return true; }
  void shutdown() {}
};

}  // namespace rt_tests
