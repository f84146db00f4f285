// rcl for nodes of a graph.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "rt_tests_support/measure/topology.h"
#include "rt_tests_support/rcl_messages.h"

struct Rcl : rt_tests::Rcl {
  static constexpr bool counts_processes = false;

  class Sender : public rt_tests::RclPublisher {
   public:
    Sender(Context& context, const topology::Topic& topic)
        : RclPublisher(context, topic.name, rt_tests::quality_of(topic.reliable, topic.depth), topic.message_bytes()) {}

    std::string problem() const {
      return std::string("rcl: cannot publish: ") + (rcl_error_is_set() ? rcl_get_error_string().str : "no reason given");
    }
  };

  template <class CallBack>
  class Receiver {
   public:
    Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back)
        : call_back_(call_back), wait_set_(context.rcl(), inputs.size(), 0) {
      for (const topology::Topic& topic : inputs) {
        subscriptions_.push_back(std::make_unique<rt_tests::RclSubscription>(
            context, topic.name, rt_tests::quality_of(topic.reliable, topic.depth), topic.message_bytes()));
        waited_for_.push_back(subscriptions_.back()->rcl());
      }
    }

    void receive(int64_t limit_ns) {
      if (!wait_set_.wait_for(waited_for_, limit_ns)) return;
      for (std::size_t input = 0; input < subscriptions_.size(); ++input) {
        const auto* message = wait_set_.has_message(input) ? subscriptions_[input]->take() : nullptr;
        if (message) call_back_(input, message->data.data(), message->data.size());
      }
    }
    int64_t publishers(std::size_t input) const { return subscriptions_[input]->publishers(); }

   private:
    CallBack& call_back_;
    std::vector<std::unique_ptr<rt_tests::RclSubscription>> subscriptions_;
    std::vector<const rcl_subscription_t*> waited_for_;
    rt_tests::RclWaitSet wait_set_;
  };
};
