// rcl for publisher and subscriber.
#pragma once

#include "rt_tests_support/rcl.h"

#include <rosidl_typesupport_cpp/message_type_support.hpp>

#include <string>

#include "ros2.h"

struct Rcl : rt_tests::Rcl {
  static const rosidl_message_type_support_t* type() {
    return rosidl_typesupport_cpp::get_message_type_support_handle<ros2::Message>();
  }

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options) : context_(context), message_(ros2::message_of(options)) {
      rcl_publisher_options_t own = rcl_publisher_get_default_options();
      own.qos = ros2::quality_of(options);
      rt_tests::check(rcl_publisher_init(&publisher_, &context.node(), type(), ros2::topic, &own), "publish");
    }
    ~Publisher() { rt_tests::ended(rcl_publisher_fini(&publisher_, &context_.node())); }
    Publisher(const Publisher&) = delete;
    Publisher& operator=(const Publisher&) = delete;

    bool publish(const rt_tests::Stamp& stamp) noexcept {
      communication::write_stamp(stamp, message_.data.data());
      return rcl_publish(&publisher_, &message_, nullptr) == RCL_RET_OK;
    }
    std::string problem() const {
      return rcl_error_is_set() ? std::string("rcl: cannot publish: ") + rcl_get_error_string().str : "";
    }
    int64_t subscribers() const {
      std::size_t count = 0;
      rt_tests::check(rcl_publisher_get_subscription_count(&publisher_, &count), "count subscribers");
      return static_cast<int64_t>(count);
    }

    rt_tests::Facts facts() const { return ros2::facts_of(rcl_publisher_get_actual_qos(&publisher_)); }

   private:
    Context& context_;
    ros2::Message message_;
    rcl_publisher_t publisher_ = rcl_get_zero_initialized_publisher();
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options& options, CallBack& call_back)
        : context_(context), message_(ros2::message_of(options)), call_back_(call_back), wait_set_(context.rcl(), 1, 0) {
      rcl_subscription_options_t own = rcl_subscription_get_default_options();
      own.qos = ros2::quality_of(options);
      rt_tests::check(rcl_subscription_init(&subscription_, &context.node(), type(), ros2::topic, &own), "subscribe");
    }
    ~Subscriber() { rt_tests::ended(rcl_subscription_fini(&subscription_, &context_.node())); }
    Subscriber(const Subscriber&) = delete;
    Subscriber& operator=(const Subscriber&) = delete;

    void receive(int64_t limit_ns) {
      if (!wait_set_.wait_for(subscription_, limit_ns)) return;
      rmw_message_info_t info = rmw_get_zero_initialized_message_info();
      const rcl_ret_t status = rcl_take(&subscription_, &message_, &info, nullptr);
      if (status == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {  // there was none for us
        rcl_reset_error();
        return;
      }
      rt_tests::check(status, "take a message");
      ros2::deliver(message_, call_back_);
    }
    int64_t publishers() const {
      std::size_t count = 0;
      rt_tests::check(rcl_subscription_get_publisher_count(&subscription_, &count), "count publishers");
      return static_cast<int64_t>(count);
    }

    rt_tests::Facts facts() const { return ros2::facts_of(rcl_subscription_get_actual_qos(&subscription_)); }

   private:
    Context& context_;
    ros2::Message message_;
    CallBack& call_back_;
    rt_tests::RclWaitSet wait_set_;
    rcl_subscription_t subscription_ = rcl_get_zero_initialized_subscription();
  };
};
