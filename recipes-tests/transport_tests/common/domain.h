// Keeps measurements on one machine apart, as ROS masters and the domains of DDS do.
#pragma once

#include <cstdlib>
#include <string>

#include "rt_tests_support/errors.h"

namespace transport {

constexpr int domain_max = 230;        // up to which DDS has ports for so many:
constexpr int participants_max = 80;  // programs of one domain

// RT_TESTS_DOMAIN of the environment, 0 if there is none. Throws UsageError.
inline int domain() {
  const char* const text = std::getenv("RT_TESTS_DOMAIN");
  if (!text) return 0;
  char* end = nullptr;
  const long number = std::strtol(text, &end, 10);
  if (*text < '0' || *text > '9' || *end != '\0' || number > domain_max) {
    throw rt_tests::UsageError("RT_TESTS_DOMAIN takes an integer from 0 to " + std::to_string(domain_max) + ", got '" +
                               text + "'");
  }
  return static_cast<int>(number);
}

// On loopback, for TCP and for UDP: one of those that DDS has for a domain, beyond the ones of its first participants.
inline int port() { return 7400 + 250 * domain() + 240; }

}  // namespace transport
