// Cyclone DDS for nodes of a graph, on loopback as the transport beside it.
#pragma once

#include "transport.h"

#include "rt_tests_support/measure/topology.h"

struct GraphTransport : Transport {
  static constexpr bool counts_processes = false;

  class Sender {
   public:
    Sender(Context& context, const topology::Topic& topic)
        : bytes_(topic.message_bytes(), 0xff), topic_(make_topic(context, topic)) {
      const Qos qos(topic);
      writer_ = checked(dds_create_writer(context.participant(), topic_, qos.get(), nullptr), "make a writer");
      message_.content._length = message_.content._maximum = static_cast<uint32_t>(bytes_.size());
      message_.content._buffer = bytes_.data();
    }
    Sender(const Sender&) = delete;
    Sender& operator=(const Sender&) = delete;

    unsigned char* bytes() noexcept { return bytes_.data(); }
    // What subscribers have no room for within the second of the reliability is lost.
    bool send() noexcept {
      returned_ = dds_write(writer_, &message_);
      return returned_ >= 0 || returned_ == DDS_RETCODE_TIMEOUT;
    }
    std::string problem() const {
      return returned_ < 0 ? std::string("Cyclone DDS cannot write: ") + dds_strretcode(-returned_) : "";
    }
    int64_t subscribers() const {
      dds_publication_matched_status_t status{};
      checked(dds_get_publication_matched_status(writer_, &status), "count subscribers");
      return status.current_count;
    }

   private:
    std::vector<unsigned char> bytes_;
    rt_tests_Bytes message_{};
    const dds_entity_t topic_;
    dds_entity_t writer_ = 0;
    dds_return_t returned_ = 0;
  };

  template <class CallBack>
  class Receiver {
   public:
    Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back)
        : call_back_(call_back),
          arrivals_(checked(dds_create_waitset(context.participant()), "make a wait set")),
          came_(inputs.size()) {
      for (const topology::Topic& input : inputs) {
        const Qos qos(input);
        const dds_entity_t reader = checked(
            dds_create_reader(context.participant(), make_topic(context, input), qos.get(), nullptr), "make a reader");
        const dds_entity_t any = checked(dds_create_readcondition(reader, DDS_ANY_STATE), "make a condition");
        checked(dds_waitset_attach(arrivals_, any, static_cast<dds_attach_t>(readers_.size())), "attach a condition");
        readers_.push_back(reader);
      }
    }
    Receiver(const Receiver&) = delete;
    Receiver& operator=(const Receiver&) = delete;

    void receive(int64_t limit_ns) {
      const dds_return_t count = dds_waitset_wait(arrivals_, came_.data(), came_.size(), limit_ns);
      for (dds_return_t i = 0; i < count; ++i) take(static_cast<std::size_t>(came_[static_cast<std::size_t>(i)]));
    }
    int64_t publishers(std::size_t input) const {
      dds_subscription_matched_status_t status{};
      checked(dds_get_subscription_matched_status(readers_[input], &status), "count publishers");
      return status.current_count;
    }

   private:
    void take(std::size_t input) {
      void* sample = nullptr;
      dds_sample_info_t about;
      if (dds_take(readers_[input], &sample, &about, 1, 1) <= 0) return;
      const auto& message = *static_cast<const rt_tests_Bytes*>(sample);
      if (about.valid_data) call_back_(input, message.content._buffer, message.content._length);
      dds_return_loan(readers_[input], &sample, 1);
    }

    CallBack& call_back_;
    const dds_entity_t arrivals_;
    std::vector<dds_attach_t> came_;
    std::vector<dds_entity_t> readers_;
  };

  class Qos {
   public:
    explicit Qos(const topology::Topic& topic) {
      dds_qset_reliability(qos_, topic.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, DDS_SECS(1));
      dds_qset_history(qos_, DDS_HISTORY_KEEP_LAST, topic.depth);
    }
    ~Qos() { dds_delete_qos(qos_); }
    Qos(const Qos&) = delete;
    Qos& operator=(const Qos&) = delete;
    const dds_qos_t* get() const noexcept { return qos_; }

   private:
    dds_qos_t* const qos_ = dds_create_qos();
  };

  // As ROS 2 names topics of DDS.
  static dds_entity_t make_topic(Context& context, const topology::Topic& topic) {
    const std::string name = "rt" + topic.name;
    return checked(dds_create_topic(context.participant(), &rt_tests_Bytes_desc, name.c_str(), nullptr, nullptr),
                   "make a topic");
  }
};
