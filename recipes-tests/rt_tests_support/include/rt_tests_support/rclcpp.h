// rclcpp, ROS 2's client library for C++, as a middleware (middleware.h): its single-threaded executor. Only packages that have
// rclcpp include this; the library is without it.
#pragma once

#include <rclcpp/rclcpp.hpp>

#include <chrono>
#include <cstdint>
#include <limits>
#include <memory>

#include "rt_tests_support/middleware.h"
#include "rt_tests_support/ros2.h"

namespace rt_tests {

struct Rclcpp {
  static constexpr char name[] = "rclcpp";
  static constexpr int64_t payload_bytes_max = std::numeric_limits<int64_t>::max();

  class Context {
   public:
    Context(int, char*[], const Program& program, const Options&) {
      rclcpp::init(0, nullptr, rclcpp::InitOptions(), rclcpp::SignalHandlerOptions::None);
      node_ = std::make_shared<rclcpp::Node>(program.executable());
      executor_ = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
      executor_->add_node(node_);
    }
    rclcpp::Node& node() { return *node_; }
    void spin(int64_t limit_ns) { executor_->spin_once(std::chrono::nanoseconds(limit_ns)); }
    bool ok() const { return rclcpp::ok(); }
    void shutdown() { rclcpp::shutdown(); }
    Facts facts() {
      Facts facts = ros2_facts(*rclcpp::contexts::get_global_default_context()->get_rcl_context());
      facts.push_back({"rclcpp_version", loaded_version("rclcpp")});
      return facts;
    }

   private:
    rclcpp::Node::SharedPtr node_;
    std::unique_ptr<rclcpp::executors::SingleThreadedExecutor> executor_;
  };

  // rclcpp has repeating timers alone: as its users do, a one-shot cancels itself when it is called.
  template <class CallBack>
  class Timer {
   public:
    static constexpr char never_fired[] = "";

    Timer(Context& context, Repeats repeats, int64_t period_ns, CallBack& call_back)
        : context_(context), repeats_(repeats == Repeats::yes), period_ns_(period_ns), call_back_(call_back) {
#ifdef RT_TESTS_RCL_TIMER_CALL_WITH_INFO
      const auto called = [this](const rclcpp::TimerInfo& call) {
        call_back_(call.expected_call_time.nanoseconds(), call.actual_call_time.nanoseconds());
        if (!repeats_) cancel();
      };
#else  // until Iron rclcpp does not say when a call was due, but how long it takes until the next one
      const auto called = [this] {
        call_back_(due_ns_, now_ns(CLOCK_MONOTONIC));
        if (!repeats_) return cancel();
        due_ns_ = next_call_ns();
      };
#endif
      timer_ = context.node().create_wall_timer(std::chrono::nanoseconds(period_ns), called);
      cancel();
    }
    ~Timer() {
      try {
        cancel();
      } catch (...) {  // the program ends
      }
    }
    Timer(const Timer&) = delete;
    Timer& operator=(const Timer&) = delete;

    void start(int64_t first_ns) { reset(first_ns); }
    void arm() { reset(period_ns_); }
    void cancel() { timer_->cancel(); }
    void spin(int64_t limit_ns) { context_.spin(limit_ns); }

   private:
    void reset(int64_t period_ns) {
      int64_t before_ns = 0;
      if (rcl_timer_exchange_period(timer_->get_timer_handle().get(), period_ns, &before_ns) != RCL_RET_OK) {
        throw Failure("rclcpp: cannot set a timer");
      }
      timer_->reset();
#ifndef RT_TESTS_RCL_TIMER_CALL_WITH_INFO
      due_ns_ = next_call_ns();
#endif
    }
    int64_t next_call_ns() const { return now_ns(CLOCK_MONOTONIC) + timer_->time_until_trigger().count(); }

    Context& context_;
    const bool repeats_;
    const int64_t period_ns_;
    CallBack& call_back_;
    rclcpp::TimerBase::SharedPtr timer_;
    int64_t due_ns_ = 0;  // until Iron
  };
};

}  // namespace rt_tests
