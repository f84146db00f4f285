// Fast DDS over shared memory and UDP, as it does by itself, but on loopback and without multicast; a file of profiles
// that FASTRTPS_DEFAULT_PROFILES_FILE (version 3: FASTDDS_DEFAULT_PROFILES_FILE) of the environment names goes before that.
#pragma once

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include <memory>

#include "domain.h"
#include "frame.h"
#include "versions.h"

struct Transport {
  using Duration = fastdds_versions::Duration;
  using Locator = fastdds_versions::rtps::Locator_t;
  static constexpr char name[] = "fastdds";
  static constexpr int64_t payload_bytes_max = 16 * 1024 * 1024;
  static constexpr int32_t queue = 1000;  // messages, as the programs on roscpp have
  static constexpr std::size_t datagram_bytes_max = 65000;

  template <class Entity>
  static Entity* require(Entity* entity, const char* what) {
    if (!entity) throw rt_tests::Failure(std::string("Fast DDS cannot make ") + what);
    return entity;
  }

  using Type = fastdds_versions::Type;

  // All threads of Fast DDS inherit policy, priority and CPUs: this version has no settings for them.
  class Context {
   public:
    Context(int, char*[], const rt_tests::Program&, const rt_tests::Options& options)
        : participant_(require(factory().create_participant(static_cast<uint32_t>(transport::domain()), qos()),
                               "a participant")),
          type_(new Type(options)) {
      type_.register_type(participant_.get());
      topic_ = require(participant_->create_topic("communication_tests", type_.get_type_name(), fast::TOPIC_QOS_DEFAULT),
                       "a topic");
    }
    bool ok() const noexcept { return true; }
    void shutdown() {}
    rt_tests::Facts facts() const {
      rt_tests::Facts facts = transport::facts();
      facts.emplace_back("fastdds_version", fastdds_versions::version);
      return facts;
    }
    fast::DomainParticipant& participant() const noexcept { return *participant_; }
    fast::Topic* topic() const noexcept { return topic_; }

   private:
    static fast::DomainParticipantFactory& factory() { return *fast::DomainParticipantFactory::get_instance(); }
    static fast::DomainParticipantQos qos() {
      if (std::getenv(fastdds_versions::profiles_variable)) {
        factory().load_profiles();
        return factory().get_default_participant_qos();
      }
      fast::DomainParticipantQos qos;
      const auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
      udp->interfaceWhiteList = {"127.0.0.1"};
      udp->maxInitialPeersRange = transport::participants_max;  // Fast DDS looks for four by itself
      qos.transport().use_builtin_transports = false;
      qos.transport().user_transports = {udp,
                                         std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>()};
      // Where participants listen and are looked for: as it is given, there is no multicast.
      Locator loopback;
      fastdds_versions::rtps::IPLocator::setIPv4(loopback, "127.0.0.1");
      qos.wire_protocol().builtin.metatrafficUnicastLocatorList.push_back(loopback);
      qos.wire_protocol().builtin.initialPeersList.push_back(loopback);
      return qos;
    }
    struct End {
      void operator()(fast::DomainParticipant* participant) const {
        participant->delete_contained_entities();
        factory().delete_participant(participant);
      }
    };
    const std::unique_ptr<fast::DomainParticipant, End> participant_;
    fast::TypeSupport type_;
    fast::Topic* topic_ = nullptr;
  };

  // Of writers and readers alike.
  template <class Qos>
  static Qos reliable() {
    Qos qos;
    qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = queue;
    qos.resource_limits().max_samples_per_instance = queue;
    // Else it takes memory for as many messages as it may keep, each of up to a megabyte.
    qos.endpoint().history_memory_policy = fastdds_versions::rtps::DYNAMIC_REUSABLE_MEMORY_MODE;
    return qos;
  }

  class Publisher {
   public:
    Publisher(Context& context, const rt_tests::Options& options) : frame_(options) {
      auto* const publisher =
          require(context.participant().create_publisher(fast::PUBLISHER_QOS_DEFAULT), "a publisher");
      auto qos = reliable<fast::DataWriterQos>();
      // A message that is larger than a datagram is sent in pieces, which its own thread does.
      if (frame_.size() > datagram_bytes_max) qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
      writer_ = require(publisher->create_datawriter(context.topic(), qos), "a writer");
    }

    // What cannot be written within the 100 ms of the reliability is lost.
    bool publish(const rt_tests::Stamp& stamp) noexcept {
      frame_.set(stamp);
      return sending_.succeeds([this] { writer_->write(&frame_); });
    }
    std::string problem() const { return sending_.problem(name); }

    int64_t subscribers() {
      fast::PublicationMatchedStatus status;
      writer_->get_publication_matched_status(status);
      return status.current_count;
    }

   private:
    transport::Frame frame_;
    fast::DataWriter* writer_ = nullptr;
    rt_tests::Sending sending_;
  };

  template <class CallBack>
  class Subscriber {
   public:
    Subscriber(Context& context, const rt_tests::Options& options, CallBack& call_back)
        : call_back_(call_back), frame_(options) {
      auto* const subscriber =
          require(context.participant().create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT), "a subscriber");
      reader_ = require(subscriber->create_datareader(context.topic(), reliable<fast::DataReaderQos>()), "a reader");
    }

    void receive(int64_t limit_ns) {
      const Duration limit(static_cast<int32_t>(limit_ns / rt_tests::ns_per_s),
                           static_cast<uint32_t>(limit_ns % rt_tests::ns_per_s));
      if (!reader_->wait_for_unread_message(limit)) return;
      fast::SampleInfo about;
      while (reader_->take_next_sample(&frame_, &about) == fastdds_versions::ok) {
        if (about.valid_data) call_back_(frame_.stamp());
      }
    }

    int64_t publishers() {
      fast::SubscriptionMatchedStatus status;
      reader_->get_subscription_matched_status(status);
      return status.current_count;
    }

   private:
    CallBack& call_back_;
    transport::Frame frame_;
    fast::DataReader* reader_ = nullptr;
  };
};
