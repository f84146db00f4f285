// roscpp for nodes of a graph.
#pragma once

#include "rt_tests_support/roscpp.h"

#include <std_msgs/UInt8MultiArray.h>

#include <string>
#include <vector>

#include "rt_tests_support/measure/topology.h"

// Messages go over TCP: best_effort has no counterpart here. Its queues are as deep as the topic says.
struct Roscpp : rt_tests::Roscpp {
  using Message = std_msgs::UInt8MultiArray;  // of ROS itself, so that the program needs no library of messages
  static constexpr bool counts_processes = true;

  class Sender {
   public:
    Sender(Context& context, const topology::Topic& topic)
        : publisher_(context.node().advertise<Message>(topic.name, static_cast<uint32_t>(topic.depth))) {
      message_.data.assign(topic.message_bytes(), 0xff);
    }
    unsigned char* bytes() noexcept { return message_.data.data(); }
    bool send() noexcept {
      return sending_.succeeds([this] { publisher_.publish(message_); });
    }
    std::string problem() const { return sending_.problem(name); }
    int64_t subscribers() const { return publisher_.getNumSubscribers(); }

   private:
    ros::Publisher publisher_;
    Message message_;
    rt_tests::Sending sending_;
  };

  // A queue of its own: its callbacks run on the thread that asks for messages, and on no other.
  template <class CallBack>
  class Receiver {
   public:
    Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back) {
      for (std::size_t input = 0; input < inputs.size(); ++input) {
        const boost::function<void(const Message::ConstPtr&)> received = [&call_back,
                                                                          input](const Message::ConstPtr& message) {
          call_back(input, message->data.data(), message->data.size());
        };
        ros::SubscribeOptions options;
        options.init<Message>(inputs[input].name, static_cast<uint32_t>(inputs[input].depth), received);
        options.callback_queue = &queue_;
        subscribers_.push_back(context.node().subscribe(options));
      }
    }
    ~Receiver() {
      for (auto& subscriber : subscribers_) subscriber.shutdown();
    }
    Receiver(const Receiver&) = delete;
    Receiver& operator=(const Receiver&) = delete;

    // All that has come by the time it looks.
    void receive(int64_t limit_ns) {
      queue_.callAvailable(ros::WallDuration(static_cast<int32_t>(limit_ns / rt_tests::ns_per_s),
                                             static_cast<int32_t>(limit_ns % rt_tests::ns_per_s)));
    }
    int64_t publishers(std::size_t input) const { return subscribers_[input].getNumPublishers(); }

   private:
    ros::CallbackQueue queue_;
    std::vector<ros::Subscriber> subscribers_;
  };
};
