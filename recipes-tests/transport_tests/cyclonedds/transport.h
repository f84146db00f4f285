// Cyclone DDS over UDP on loopback, without multicast, unless CYCLONEDDS_URI of the environment says otherwise.
#pragma once

#include <dds/dds.h>

#include <cstdint>
#include <string>
#include <vector>

#include "domain.h"
#include "message.h"
#include "rt_tests_support/middleware.h"

struct Transport {
  static constexpr char name[] = "cyclonedds";
  static constexpr int64_t payload_bytes_max = 16 * 1024 * 1024;
  static constexpr int32_t queue = 1000;  // messages, as the programs on roscpp have
  static constexpr char topic[] = "communication_tests";

  // Without multicast a participant looks for the others by their ports: for ten of them unless it is told.
  static std::string configuration() {
    return R"(<Domain Id="any">
                <General>
                  <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
                  <AllowMulticast>false</AllowMulticast>
                </General>
                <Discovery>
                  <ParticipantIndex>auto</ParticipantIndex>
                  <MaxAutoParticipantIndex>)" +
           std::to_string(transport::participants_max) + R"(</MaxAutoParticipantIndex>
                  <Peers><Peer address="127.0.0.1"/></Peers>
                </Discovery>
              </Domain>)";
  }

  // What a call returned, unless it is an error: throws Failure.
  static dds_entity_t checked(dds_return_t returned, const char* what) {
    if (returned >= 0) return returned;
    throw rt_tests::Failure(std::string("Cyclone DDS cannot ") + what + ": " + dds_strretcode(-returned));
  }

  // All threads of Cyclone inherit policy, priority and CPUs: its configuration has no word about them.
  class Context {
   public:
    Context(int, char*[], const rt_tests::Program&, const rt_tests::Options&) {
      const auto id = static_cast<dds_domainid_t>(transport::domain());
      if (!std::getenv("CYCLONEDDS_URI")) checked(dds_create_domain(id, configuration().c_str()), "make a domain");
      participant_ = checked(dds_create_participant(id, nullptr, nullptr), "make a participant");
      topic_ = checked(dds_create_topic(participant_, &rt_tests_Message_desc, topic, nullptr, nullptr), "make a topic");
      dds_qset_reliability(qos_, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
      dds_qset_history(qos_, DDS_HISTORY_KEEP_LAST, queue);
    }
    ~Context() {
      dds_delete_qos(qos_);
      dds_delete(DDS_CYCLONEDDS_HANDLE);  // with all that there is
    }
    Context(const Context&) = delete;
    Context& operator=(const Context&) = delete;

    rt_tests::Facts facts() const { return transport::facts(); }
    bool ok() const noexcept { return true; }
    void shutdown() {}
    dds_entity_t participant() const noexcept { return participant_; }
    dds_entity_t topic_entity() const noexcept { return topic_; }
    const dds_qos_t* qos() const noexcept { return qos_; }

   private:
    dds_qos_t* const qos_ = dds_create_qos();
    dds_entity_t participant_ = 0;
    dds_entity_t topic_ = 0;
  };

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options)
        : payload_(static_cast<std::size_t>(options.number("payload_bytes")), 0xff),
          writer_(checked(dds_create_writer(context.participant(), context.topic_entity(), context.qos(), nullptr),
                          "make a writer")) {
      message_.payload._length = message_.payload._maximum = static_cast<uint32_t>(payload_.size());
      message_.payload._buffer = payload_.data();
    }

    // What subscribers have no room for within the second of the reliability is lost.
    bool publish(const rt_tests::Stamp& stamp) noexcept {
      message_.publication_ns = stamp.publication_ns;
      message_.seq = stamp.seq;
      message_.last = stamp.last;
      returned_ = dds_write(writer_, &message_);
      return returned_ >= 0 || returned_ == DDS_RETCODE_TIMEOUT;
    }
    std::string problem() const {
      return returned_ < 0 ? std::string("Cyclone DDS cannot write: ") + dds_strretcode(-returned_) : "";
    }

    int64_t subscribers() {
      dds_publication_matched_status_t status{};
      checked(dds_get_publication_matched_status(writer_, &status), "count subscribers");
      return status.current_count;
    }

   private:
    std::vector<uint8_t> payload_;
    rt_tests_Message message_{};
    const dds_entity_t writer_;
    dds_return_t returned_ = 0;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options&, CallBack& call_back)
        : call_back_(call_back),
          reader_(checked(dds_create_reader(context.participant(), context.topic_entity(), context.qos(), nullptr),
                          "make a reader")),
          arrivals_(checked(dds_create_waitset(context.participant()), "make a wait set")) {
      const dds_entity_t any = checked(dds_create_readcondition(reader_, DDS_ANY_STATE), "make a condition");
      checked(dds_waitset_attach(arrivals_, any, 0), "attach a condition");
    }

    void receive(int64_t limit_ns) {
      dds_attach_t came;
      if (dds_waitset_wait(arrivals_, &came, 1, limit_ns) <= 0) return;
      void* sample = nullptr;
      dds_sample_info_t about;
      while (dds_take(reader_, &sample, &about, 1, 1) > 0) {
        const auto& message = *static_cast<const rt_tests_Message*>(sample);
        if (about.valid_data) call_back_({message.publication_ns, message.seq, message.last});
        dds_return_loan(reader_, &sample, 1);
      }
    }

    int64_t publishers() const {
      dds_subscription_matched_status_t status{};
      checked(dds_get_subscription_matched_status(reader_, &status), "count publishers");
      return status.current_count;
    }

   private:
    CallBack& call_back_;
    const dds_entity_t reader_;
    const dds_entity_t arrivals_;
  };
};
