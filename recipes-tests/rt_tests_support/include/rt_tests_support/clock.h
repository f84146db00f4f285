// The clock of the timestamps, in integer nanoseconds.
#pragma once

#include <time.h>

#include <cstdint>
#include <string>

namespace rt_tests {

constexpr int64_t ns_per_us = 1000;
constexpr int64_t ns_per_s = 1000000000;

inline int64_t now_ns(clockid_t clock) noexcept {
  timespec now;
  clock_gettime(clock, &now);
  return int64_t{now.tv_sec} * ns_per_s + now.tv_nsec;
}

clockid_t clock_of(const std::string& option);  // "raw" or "monotonic"
const char* clock_name(clockid_t clock);
int64_t clock_resolution_ns(clockid_t clock);

// The smallest difference between two successive readings that differ. clock_getres often claims a finer resolution.
int64_t clock_step_ns(clockid_t clock);

std::string utc_now();  // 2026-11-21T10:00:00Z

}  // namespace rt_tests
