// Keeps measurements on one machine apart, as ROS masters and the domains of DDS do.
#pragma once

#include <cstdlib>
#include <string>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/middleware.h"

namespace transport {

constexpr int domain_max = 230;        // up to which DDS has ports for so many:
constexpr int participants_max = 80;  // programs of one domain

// ROS_DOMAIN_ID of the environment, 0 if there is none. Throws UsageError.
inline int domain() {
  const char* const text = std::getenv("ROS_DOMAIN_ID");
  if (!text) return 0;
  char* end = nullptr;
  const long number = std::strtol(text, &end, 10);
  if (*text < '0' || *text > '9' || *end != '\0' || number > domain_max) {
    throw rt_tests::UsageError("ROS_DOMAIN_ID takes an integer from 0 to " + std::to_string(domain_max) + ", got '" +
                               text + "'");
  }
  return static_cast<int>(number);
}

inline rt_tests::Facts facts() { return {{"domain_id", std::to_string(domain())}}; }

// Of a transport that has no other.
struct Context : rt_tests::NoContext {
  using NoContext::NoContext;
  rt_tests::Facts facts() const { return transport::facts(); }
};

// On loopback, for TCP and for UDP: one of those that DDS has for a domain, beyond the ones of its first participants.
inline int port() { return 7400 + 250 * domain() + 240; }

}  // namespace transport
