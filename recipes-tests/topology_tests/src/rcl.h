// rcl for nodes of a graph.
#pragma once

#include "rt_tests_support/rcl.h"

#include <rmw/qos_profiles.h>

#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <std_msgs/msg/u_int8_multi_array.hpp>

#include <string>
#include <vector>

#include "rt_tests_support/measure/topology.h"

struct Rcl : rt_tests::Rcl {
  using Message = std_msgs::msg::UInt8MultiArray;  // of ROS itself, so that the program needs no library of messages
  static constexpr bool counts_processes = false;

  static const rosidl_message_type_support_t* type() {
    return rosidl_typesupport_cpp::get_message_type_support_handle<Message>();
  }

  static rmw_qos_profile_t quality_of(const topology::Topic& topic) {
    rmw_qos_profile_t quality = rmw_qos_profile_default;
    quality.reliability = topic.reliable ? RMW_QOS_POLICY_RELIABILITY_RELIABLE : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    quality.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
    quality.depth = static_cast<std::size_t>(topic.depth);
    return quality;
  }

  static Message message_of(const topology::Topic& topic) {
    Message message;
    message.data.assign(topic.message_bytes(), 0xff);
    return message;
  }

  class Sender {
   public:
    Sender(Context& context, const topology::Topic& topic) : context_(context), message_(message_of(topic)) {
      rcl_publisher_options_t own = rcl_publisher_get_default_options();
      own.qos = quality_of(topic);
      rt_tests::check(rcl_publisher_init(&publisher_, &context.node(), type(), topic.name.c_str(), &own), "publish");
    }
    ~Sender() { rt_tests::ended(rcl_publisher_fini(&publisher_, &context_.node())); }
    Sender(const Sender&) = delete;
    Sender& operator=(const Sender&) = delete;

    unsigned char* bytes() noexcept { return message_.data.data(); }
    bool send() noexcept { return rcl_publish(&publisher_, &message_, nullptr) == RCL_RET_OK; }
    std::string problem() const {
      return std::string("rcl: cannot publish: ") + (rcl_error_is_set() ? rcl_get_error_string().str : "no reason given");
    }
    int64_t subscribers() const {
      std::size_t count = 0;
      rt_tests::check(rcl_publisher_get_subscription_count(&publisher_, &count), "count subscribers");
      return static_cast<int64_t>(count);
    }

   private:
    Context& context_;
    Message message_;
    rcl_publisher_t publisher_ = rcl_get_zero_initialized_publisher();
  };

  template <class CallBack>
  class Receiver {
   public:
    Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back)
        : context_(context),
          call_back_(call_back),
          subscriptions_(inputs.size(), rcl_get_zero_initialized_subscription()),
          wait_set_(context.rcl(), inputs.size(), 0) {
      for (std::size_t input = 0; input < inputs.size(); ++input) {
        messages_.push_back(message_of(inputs[input]));
        rcl_subscription_options_t own = rcl_subscription_get_default_options();
        own.qos = quality_of(inputs[input]);
        rt_tests::check(
            rcl_subscription_init(&subscriptions_[input], &context.node(), type(), inputs[input].name.c_str(), &own),
            "subscribe");
      }
    }
    ~Receiver() {
      for (auto& subscription : subscriptions_) rt_tests::ended(rcl_subscription_fini(&subscription, &context_.node()));
    }
    Receiver(const Receiver&) = delete;
    Receiver& operator=(const Receiver&) = delete;

    void receive(int64_t limit_ns) {
      if (!wait_set_.wait_for(subscriptions_.data(), subscriptions_.size(), limit_ns)) return;
      for (std::size_t input = 0; input < subscriptions_.size(); ++input) {
        if (!wait_set_.has_message(input)) continue;
        rmw_message_info_t info = rmw_get_zero_initialized_message_info();
        const rcl_ret_t status = rcl_take(&subscriptions_[input], &messages_[input], &info, nullptr);
        if (status == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {  // there was none for us
          rcl_reset_error();
          continue;
        }
        rt_tests::check(status, "take a message");
        call_back_(input, messages_[input].data.data(), messages_[input].data.size());
      }
    }
    int64_t publishers(std::size_t input) const {
      std::size_t count = 0;
      rt_tests::check(rcl_subscription_get_publisher_count(&subscriptions_[input], &count), "count publishers");
      return static_cast<int64_t>(count);
    }

   private:
    Context& context_;
    CallBack& call_back_;
    std::vector<Message> messages_;
    std::vector<rcl_subscription_t> subscriptions_;
    rt_tests::RclWaitSet wait_set_;
  };
};
