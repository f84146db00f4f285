// roscpp as a middleware (middleware.h). Only packages that have roscpp include this; the library is without it.
#pragma once

#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <cstdint>
#include <limits>
#include <optional>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/middleware.h"

namespace rt_tests {

struct Roscpp {
  static constexpr char name[] = "roscpp";
  static constexpr int64_t payload_bytes_max = std::numeric_limits<int64_t>::max();

  class Context {
   public:
    Context(int argc, char* argv[], const Program& program, const Options&) {
      ros::init(argc, argv, program.node_name(), ros::init_options::NoSigintHandler);
    }
    ros::NodeHandle& node() {  // the first call starts roscpp's threads
      if (!node_) node_.emplace();
      return *node_;
    }
    bool ok() const { return ros::ok(); }
    void shutdown() { ros::shutdown(); }

   private:
    std::optional<ros::NodeHandle> node_;
  };

  static void spin(int64_t limit_ns) {
    ros::getGlobalCallbackQueue()->callAvailable(
        ros::WallDuration(static_cast<int32_t>(limit_ns / ns_per_s), static_cast<int32_t>(limit_ns % ns_per_s)));
  }

  template <class CallBack>
  class Timer {
   public:
    static constexpr char never_fired[] = ": is /use_sim_time set while no clock is published?";

    Timer(Context& context, Repeats repeats, int64_t period_ns, CallBack& call_back)
        : node_(context.node()),
          once_(repeats == Repeats::no),
          period_(duration(period_ns)),
          call_back_([&call_back](const ros::TimerEvent& event) {
            call_back(static_cast<int64_t>(event.current_expected.toNSec()),
                      static_cast<int64_t>(event.current_real.toNSec()));
          }) {}

    // roscpp starts its thread that waits for timers with the first one.
    void start(int64_t first_ns) { timer_ = node_.createTimer(duration(first_ns), call_back_, once_); }
    // setPeriod arms a timer that was started before. After cancel(), start arms it.
    void arm() {
      timer_.setPeriod(period_);
      timer_.start();
    }
    void cancel() { timer_.stop(); }
    void spin(int64_t limit_ns) { Roscpp::spin(limit_ns); }

   private:
    static ros::Duration duration(int64_t ns) {
      return {static_cast<int32_t>(ns / ns_per_s), static_cast<int32_t>(ns % ns_per_s)};
    }

    ros::NodeHandle& node_;
    const bool once_;
    const ros::Duration period_;
    const boost::function<void(const ros::TimerEvent&)> call_back_;
    ros::Timer timer_;
  };
};

}  // namespace rt_tests
