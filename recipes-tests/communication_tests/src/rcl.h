// rcl for publisher and subscriber.
#pragma once

#include <array>
#include <string>

#include "ros2.h"

struct Rcl : rt_tests::Rcl {
  class Publisher : public rt_tests::RclPublisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options)
        : RclPublisher(context, ros2::topic, ros2::quality_of(options), ros2::bytes_of(options)) {}

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      communication::write_stamp(stamp, bytes());
      return send();
    }
    std::string problem() const {
      return rcl_error_is_set() ? std::string("rcl: cannot publish: ") + rcl_get_error_string().str : "";
    }
    rt_tests::Facts facts() const { return ros2::facts_of(quality()); }
  };

  template <class CallBack>
  class Subscriber : public rt_tests::RclSubscription {
   public:
    Subscriber(Context& context, const rt_tests::Options& options, CallBack& call_back)
        : RclSubscription(context, ros2::topic, ros2::quality_of(options), ros2::bytes_of(options)),
          call_back_(call_back),
          wait_set_(context.rcl(), 1, 0) {}

    void receive(int64_t limit_ns) {
      if (!wait_set_.wait_for(std::array{rcl()}, limit_ns) || !wait_set_.has_message(0)) return;
      if (const auto* message = take()) ros2::deliver(*message, call_back_);
    }
    rt_tests::Facts facts() const { return ros2::facts_of(quality()); }

   private:
    CallBack& call_back_;
    rt_tests::RclWaitSet wait_set_;
  };
};
