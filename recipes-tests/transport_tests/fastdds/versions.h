// What Fast DDS 2 and 3 call differently: `rtps`, `Duration`, `ok`, and `Type`, of a frame that is sent as it is.
#pragma once

#include <fastdds/dds/core/policy/QosPolicies.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#if __has_include(<fastdds/utils/IPLocator.hpp>)
#include <fastdds/config.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.hpp>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.hpp>
#include <fastdds/utils/IPLocator.hpp>
#define RT_TESTS_FASTDDS_3
#else
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/config.h>
#include <fastrtps/utils/IPLocator.h>
#endif

#include <cstring>
#include <functional>

#include "frame.h"

namespace fast = eprosima::fastdds::dds;

namespace fastdds_versions {

#ifdef RT_TESTS_FASTDDS_3
namespace rtps = eprosima::fastdds::rtps;
using Duration = fast::Duration_t;
constexpr auto ok = fast::RETCODE_OK;
constexpr char version[] = FASTDDS_VERSION_STR;
constexpr char profiles_variable[] = "FASTDDS_DEFAULT_PROFILES_FILE";
#else
namespace rtps = eprosima::fastrtps::rtps;
using Duration = eprosima::fastrtps::Duration_t;
inline const auto ok = eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK;
constexpr char version[] = FASTRTPS_VERSION_STR;
constexpr char profiles_variable[] = "FASTRTPS_DEFAULT_PROFILES_FILE";
#endif

class Type : public fast::TopicDataType {
 public:
  explicit Type(const rt_tests::Options& options)
      : options_(options), size_(static_cast<uint32_t>(transport::Frame(options).size())) {
#ifdef RT_TESTS_FASTDDS_3
    set_name("rt_tests::Frame");
    max_serialized_type_size = size_;
#else
    setName("rt_tests::Frame");
    m_typeSize = size_;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
#endif
  }

#ifdef RT_TESTS_FASTDDS_3
  bool serialize(const void* data, rtps::SerializedPayload_t& payload, fast::DataRepresentationId_t) override {
    return write(data, payload);
  }
  bool deserialize(rtps::SerializedPayload_t& payload, void* data) override { return read(payload, data); }
  uint32_t calculate_serialized_size(const void*, fast::DataRepresentationId_t) override { return size_; }
  void* create_data() override { return new transport::Frame(options_); }
  void delete_data(void* data) override { delete static_cast<transport::Frame*>(data); }
  bool compute_key(rtps::SerializedPayload_t&, rtps::InstanceHandle_t&, bool) override { return false; }
  bool compute_key(const void*, rtps::InstanceHandle_t&, bool) override { return false; }
#else
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override { return write(data, *payload); }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override { return read(*payload, data); }
  std::function<uint32_t()> getSerializedSizeProvider(void*) override {
    return [this] { return size_; };
  }
  void* createData() override { return new transport::Frame(options_); }
  void deleteData(void* data) override { delete static_cast<transport::Frame*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
  // Fast DDS 2.11 and later ask for these, which call those before.
  using fast::TopicDataType::getSerializedSizeProvider;
  using fast::TopicDataType::serialize;
#endif

 private:
  static bool write(const void* data, rtps::SerializedPayload_t& payload) {
    const auto& frame = *static_cast<const transport::Frame*>(data);
    payload.length = static_cast<uint32_t>(frame.size());
    std::memcpy(payload.data, frame.data(), frame.size());
    return true;
  }
  static bool read(const rtps::SerializedPayload_t& payload, void* data) {
    auto& frame = *static_cast<transport::Frame*>(data);
    frame.require_size(payload.length);
    std::memcpy(frame.data(), payload.data, frame.size());
    return true;
  }

  const rt_tests::Options options_;
  const uint32_t size_;
};

}  // namespace fastdds_versions
