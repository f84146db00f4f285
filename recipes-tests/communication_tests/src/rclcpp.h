// rclcpp for publisher and subscriber.
#pragma once

#include "rt_tests_support/rclcpp.h"

#include <string>

#include "ros2.h"

struct Rclcpp : rt_tests::Rclcpp {
  static rclcpp::QoS quality_of(const rt_tests::Options& options) {
    const rmw_qos_profile_t quality = ros2::quality_of(options);
    return rclcpp::QoS(rclcpp::QoSInitialization::from_rmw(quality), quality);
  }

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options)
        : message_(rt_tests::message_of(ros2::bytes_of(options))),
          publisher_(context.node().create_publisher<ros2::Message>(ros2::topic, quality_of(options))) {}

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      communication::write_stamp(stamp, message_.data.data());
      return sending_.succeeds([this] { publisher_->publish(message_); });
    }
    std::string problem() const { return sending_.problem(name); }
    int64_t subscribers() const { return static_cast<int64_t>(publisher_->get_subscription_count()); }
    rt_tests::Facts facts() const { return ros2::facts_of(&publisher_->get_actual_qos().get_rmw_qos_profile()); }

   private:
    ros2::Message message_;
    rclcpp::Publisher<ros2::Message>::SharedPtr publisher_;
    rt_tests::Sending sending_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options& options, CallBack& call_back) : context_(context) {
      subscription_ = context.node().create_subscription<ros2::Message>(
          ros2::topic, quality_of(options), [&call_back](const ros2::Message& message) { ros2::deliver(message, call_back); });
    }
    void receive(int64_t limit_ns) { context_.spin(limit_ns); }
    int64_t publishers() const { return static_cast<int64_t>(subscription_->get_publisher_count()); }
    rt_tests::Facts facts() const { return ros2::facts_of(&subscription_->get_actual_qos().get_rmw_qos_profile()); }

   private:
    Context& context_;
    rclcpp::Subscription<ros2::Message>::SharedPtr subscription_;
  };
};
