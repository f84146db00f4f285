// roscpp for publisher and subscriber.
#pragma once

#include <communication_tests/timestamp_msg.h>

#include <string>

#include "rt_tests_support/roscpp.h"

struct Roscpp : rt_tests::Roscpp {
  using Message = communication_tests::timestamp_msg;
  static constexpr char topic[] = "communication_tests";
  static constexpr uint32_t queue = 1000;  // messages

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options)
        : publisher_(context.node().advertise<Message>(topic, queue)) {
      message_.payload.assign(static_cast<std::size_t>(options.number("payload_bytes")), 0xff);
    }
    bool publish(const rt_tests::Stamp& stamp) noexcept {
      message_.seq = stamp.seq;
      message_.last_msg = stamp.last;
      message_.sec = static_cast<uint32_t>(stamp.publication_ns / rt_tests::ns_per_s);
      message_.nsec = static_cast<uint32_t>(stamp.publication_ns % rt_tests::ns_per_s);
      return sending_.succeeds([this] { publisher_.publish(message_); });
    }
    std::string problem() const { return sending_.problem(name); }
    int64_t subscribers() const { return publisher_.getNumSubscribers(); }

   private:
    ros::Publisher publisher_;
    Message message_;
    rt_tests::Sending sending_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options&, CallBack& call_back) {
      const boost::function<void(const Message::ConstPtr&)> received = [&call_back](const Message::ConstPtr& message) {
        call_back({int64_t{message->sec} * rt_tests::ns_per_s + message->nsec, message->seq, message->last_msg != 0});
      };
      subscriber_ = context.node().subscribe<Message>(topic, queue, received);
    }
    void receive(int64_t limit_ns) { spin(limit_ns); }
    int64_t publishers() const { return subscriber_.getNumPublishers(); }

   private:
    ros::Subscriber subscriber_;
  };
};
