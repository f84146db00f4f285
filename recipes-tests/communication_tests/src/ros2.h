// What rcl and rclcpp have in common for publisher and subscriber: the message, its topic and its quality of service.
#pragma once

#include <rmw/qos_string_conversions.h>

#include <string>

#include "rt_tests_support/measure/wire.h"
#include "rt_tests_support/options.h"
#include "rt_tests_support/rcl_messages.h"
#include "rt_tests_support/report.h"

namespace ros2 {

// Its `data` has the fields of 2014's.
using Message = rt_tests::BytesMessage;
constexpr char topic[] = "communication_tests";

inline std::size_t bytes_of(const rt_tests::Options& options) {
  return communication::stamp_bytes + static_cast<std::size_t>(options.number("payload_bytes"));
}

inline rmw_qos_profile_t quality_of(const rt_tests::Options& options) {
  return rt_tests::quality_of(options.text("reliability") == "reliable", options.number("depth"));
}

// The quality of service in effect: an RMW may have settings of its own. What it does not know is not told.
inline rt_tests::Facts facts_of(const rmw_qos_profile_t* quality) {
  rt_tests::Facts facts;
  if (!quality) return facts;
  if (const char* reliability = rmw_qos_reliability_policy_to_str(quality->reliability)) {
    facts.push_back({"reliability", reliability});
  }
  if (quality->depth != RMW_QOS_POLICY_DEPTH_SYSTEM_DEFAULT) facts.push_back({"depth", std::to_string(quality->depth)});
  return facts;
}

// Others may publish on the topic, too: messages too short to hold our stamp are not ours.
template <class CallBack>
void deliver(const Message& message, CallBack& call_back) {
  if (message.data.size() >= communication::stamp_bytes) call_back(communication::read_stamp(message.data.data()));
}

}  // namespace ros2
