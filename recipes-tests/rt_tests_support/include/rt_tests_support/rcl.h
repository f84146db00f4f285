// rcl, the C library below ROS 2's client libraries, as a middleware (middleware.h): its timers and its wait set. Only packages
// that have rcl include this; the library is without it.
#pragma once

#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <rcl/timer.h>
#include <rcl/wait.h>

#include <cstdint>
#include <limits>
#include <string>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/ros2.h"

namespace rt_tests {

// Throws Failure that says what rcl could not do, and why.
inline void check(rcl_ret_t status, const char* what) {
  if (status == RCL_RET_OK) return;
  const std::string reason = rcl_get_error_string().str;
  rcl_reset_error();
  throw Failure(std::string("rcl: cannot ") + what + ": " + reason);
}

// What rcl says of the end of something changes nothing any more.
inline void ended(rcl_ret_t) noexcept {}

// Waits for one timer, or for subscriptions.
class RclWaitSet {
 public:
  RclWaitSet(rcl_context_t& context, std::size_t subscriptions, std::size_t timers) {
    check(rcl_wait_set_init(&set_, subscriptions, 0, timers, 0, 0, 0, &context, rcl_get_default_allocator()),
          "make a wait set");
  }
  ~RclWaitSet() { ended(rcl_wait_set_fini(&set_)); }
  RclWaitSet(const RclWaitSet&) = delete;
  RclWaitSet& operator=(const RclWaitSet&) = delete;

  bool wait_for(const rcl_timer_t& timer, int64_t limit_ns) {
    check(rcl_wait_set_clear(&set_), "clear a wait set");
    check(rcl_wait_set_add_timer(&set_, &timer, nullptr), "wait for a timer");
    return wait(limit_ns) && set_.timers[0] != nullptr;
  }
  template <class Subscriptions>
  bool wait_for(const Subscriptions& subscriptions, int64_t limit_ns) {
    check(rcl_wait_set_clear(&set_), "clear a wait set");
    for (const rcl_subscription_t* subscription : subscriptions) {
      check(rcl_wait_set_add_subscription(&set_, subscription, nullptr), "wait for messages");
    }
    return wait(limit_ns);
  }
  // Of the subscriptions that were waited for last.
  bool has_message(std::size_t number) const { return set_.subscriptions[number] != nullptr; }

 private:
  bool wait(int64_t limit_ns) {
    const rcl_ret_t status = rcl_wait(&set_, limit_ns);
    if (status == RCL_RET_TIMEOUT) {
      rcl_reset_error();
      return false;
    }
    check(status, "wait");
    return true;
  }

  rcl_wait_set_t set_ = rcl_get_zero_initialized_wait_set();
};

struct Rcl {
  static constexpr char name[] = "rcl";
  static constexpr int64_t payload_bytes_max = std::numeric_limits<int64_t>::max();

  class Context {
   public:
    Context(int, char*[], const Program& program, const Options&) {
      rcl_init_options_t init = rcl_get_zero_initialized_init_options();
      check(rcl_init_options_init(&init, rcl_get_default_allocator()), "begin");
      const rcl_ret_t status = rcl_init(0, nullptr, &init, &context_);
      const rcl_ret_t ended = rcl_init_options_fini(&init);
      check(status, "begin");
      check(ended, "begin");
      const rcl_node_options_t options = rcl_node_get_default_options();
      check(rcl_node_init(&node_, program.node_name().c_str(), "", &context_, &options), "make a node");
    }
    ~Context() {
      ended(rcl_node_fini(&node_));
      shutdown();
      ended(rcl_context_fini(&context_));
    }
    Context(const Context&) = delete;
    Context& operator=(const Context&) = delete;

    rcl_context_t& rcl() { return context_; }
    rcl_node_t& node() { return node_; }
    bool ok() const { return rcl_context_is_valid(&context_); }
    void shutdown() {
      if (ok()) ended(rcl_shutdown(&context_));
    }
    Facts facts() { return ros2_facts(context_); }

   private:
    rcl_context_t context_ = rcl_get_zero_initialized_context();
    rcl_node_t node_ = rcl_get_zero_initialized_node();
  };

  // rcl has repeating timers alone: as its users do, a one-shot is cancelled when it was called.
  template <class CallBack>
  class Timer {
   public:
    static constexpr char never_fired[] = "";

    Timer(Context& context, Repeats repeats, int64_t period_ns, CallBack& call_back)
        : repeats_(repeats == Repeats::yes), period_ns_(period_ns), call_back_(call_back), wait_set_(context.rcl(), 0, 1) {
      rcl_allocator_t allocator = rcl_get_default_allocator();
      check(rcl_clock_init(RCL_STEADY_TIME, &clock_, &allocator), "make a clock");
#ifdef RT_TESTS_RCL_TIMER_INIT2  // since Jazzy; the other one until then
      check(rcl_timer_init2(&timer_, &clock_, &context.rcl(), period_ns, nullptr, allocator, false), "make a timer");
#else
      check(rcl_timer_init(&timer_, &clock_, &context.rcl(), period_ns, nullptr, allocator), "make a timer");
      cancel();
#endif
    }
    ~Timer() {
      ended(rcl_timer_fini(&timer_));
      ended(rcl_clock_fini(&clock_));
    }
    Timer(const Timer&) = delete;
    Timer& operator=(const Timer&) = delete;

    void start(int64_t first_ns) { reset(first_ns); }
    void arm() { reset(period_ns_); }
    void cancel() { check(rcl_timer_cancel(&timer_), "cancel a timer"); }

    void spin(int64_t limit_ns) {
      if (!wait_set_.wait_for(timer_, limit_ns)) return;
#ifdef RT_TESTS_RCL_TIMER_CALL_WITH_INFO
      rcl_timer_call_info_t call = {};
      check(rcl_timer_call_with_info(&timer_, &call), "call a timer");
      call_back_(call.expected_call_time, call.actual_call_time);
#else  // until Iron rcl does not say when a call was due, but how long it takes until then: less than nothing
      rcl_time_point_value_t now_ns = 0;
      int64_t remaining_ns = 0;
      check(rcl_clock_get_now(&clock_, &now_ns), "read a clock");
      check(rcl_timer_get_time_until_next_call(&timer_, &remaining_ns), "ask a timer");
      check(rcl_timer_call(&timer_), "call a timer");
      call_back_(now_ns + remaining_ns, now_ns);
#endif
      if (!repeats_) cancel();
    }

   private:
    void reset(int64_t period_ns) {
      int64_t before_ns = 0;
      check(rcl_timer_exchange_period(&timer_, period_ns, &before_ns), "set a timer");
      check(rcl_timer_reset(&timer_), "start a timer");
    }

    const bool repeats_;
    const int64_t period_ns_;
    CallBack& call_back_;
    RclWaitSet wait_set_;
    rcl_clock_t clock_{};
    rcl_timer_t timer_ = rcl_get_zero_initialized_timer();
  };
};

}  // namespace rt_tests
