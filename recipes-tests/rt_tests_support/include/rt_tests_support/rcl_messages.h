// Messages of bytes over rcl. Only packages that have rcl and std_msgs include this; the library is without it.
#pragma once

#include <rmw/qos_profiles.h>

#include <rosidl_typesupport_cpp/message_type_support.hpp>
#include <std_msgs/msg/u_int8_multi_array.hpp>

#include <cstdint>
#include <string>

#include "rt_tests_support/rcl.h"

namespace rt_tests {

// A type of ROS 2's own, so that the programs need no library of messages beside them.
using BytesMessage = std_msgs::msg::UInt8MultiArray;

inline BytesMessage message_of(std::size_t bytes) {
  BytesMessage message;
  message.data.assign(bytes, 0xff);
  return message;
}

inline const rosidl_message_type_support_t* bytes_type() {
  return rosidl_typesupport_cpp::get_message_type_support_handle<BytesMessage>();
}

inline rmw_qos_profile_t quality_of(bool is_reliable, int64_t depth) {
  rmw_qos_profile_t quality = rmw_qos_profile_default;
  quality.reliability = is_reliable ? RMW_QOS_POLICY_RELIABILITY_RELIABLE : RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
  quality.history = RMW_QOS_POLICY_HISTORY_KEEP_LAST;
  quality.depth = static_cast<std::size_t>(depth);
  return quality;
}

// Publishes one message, whose bytes are filled anew each time.
class RclPublisher {
 public:
  RclPublisher(Rcl::Context& context, const std::string& topic, const rmw_qos_profile_t& quality, std::size_t bytes)
      : context_(context), message_(message_of(bytes)) {
    rcl_publisher_options_t own = rcl_publisher_get_default_options();
    own.qos = quality;
    check(rcl_publisher_init(&publisher_, &context.node(), bytes_type(), topic.c_str(), &own), "publish");
  }
  ~RclPublisher() { ended(rcl_publisher_fini(&publisher_, &context_.node())); }
  RclPublisher(const RclPublisher&) = delete;
  RclPublisher& operator=(const RclPublisher&) = delete;

  unsigned char* bytes() noexcept { return message_.data.data(); }
  bool send() noexcept { return rcl_publish(&publisher_, &message_, nullptr) == RCL_RET_OK; }
  int64_t subscribers() const {
    std::size_t count = 0;
    check(rcl_publisher_get_subscription_count(&publisher_, &count), "count subscribers");
    return static_cast<int64_t>(count);
  }
  // In effect: an RMW may have settings of its own.
  const rmw_qos_profile_t* quality() const { return rcl_publisher_get_actual_qos(&publisher_); }

 private:
  Rcl::Context& context_;
  BytesMessage message_;
  rcl_publisher_t publisher_ = rcl_get_zero_initialized_publisher();
};

// Takes messages into one that has room for `bytes`.
class RclSubscription {
 public:
  RclSubscription(Rcl::Context& context, const std::string& topic, const rmw_qos_profile_t& quality, std::size_t bytes)
      : context_(context), message_(message_of(bytes)) {
    rcl_subscription_options_t own = rcl_subscription_get_default_options();
    own.qos = quality;
    check(rcl_subscription_init(&subscription_, &context.node(), bytes_type(), topic.c_str(), &own), "subscribe");
  }
  ~RclSubscription() { ended(rcl_subscription_fini(&subscription_, &context_.node())); }
  RclSubscription(const RclSubscription&) = delete;
  RclSubscription& operator=(const RclSubscription&) = delete;

  // nullptr: there was none for us.
  const BytesMessage* take() {
    rmw_message_info_t info = rmw_get_zero_initialized_message_info();
    const rcl_ret_t status = rcl_take(&subscription_, &message_, &info, nullptr);
    if (status == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {
      rcl_reset_error();
      return nullptr;
    }
    check(status, "take a message");
    return &message_;
  }
  int64_t publishers() const {
    std::size_t count = 0;
    check(rcl_subscription_get_publisher_count(&subscription_, &count), "count publishers");
    return static_cast<int64_t>(count);
  }
  const rmw_qos_profile_t* quality() const { return rcl_subscription_get_actual_qos(&subscription_); }
  const rcl_subscription_t* rcl() const { return &subscription_; }

 private:
  Rcl::Context& context_;
  BytesMessage message_;
  rcl_subscription_t subscription_ = rcl_get_zero_initialized_subscription();
};

}  // namespace rt_tests
