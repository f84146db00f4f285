#include "rt_tests_support/clock.h"

#include <limits>

namespace rt_tests {

clockid_t clock_of(const std::string& option) {
  return option == "monotonic" ? CLOCK_MONOTONIC : CLOCK_MONOTONIC_RAW;
}

const char* clock_name(clockid_t clock) {
  return clock == CLOCK_MONOTONIC ? "CLOCK_MONOTONIC" : "CLOCK_MONOTONIC_RAW";
}

int64_t clock_resolution_ns(clockid_t clock) {
  timespec resolution{};
  clock_getres(clock, &resolution);
  return int64_t{resolution.tv_sec} * ns_per_s + resolution.tv_nsec;
}

int64_t clock_step_ns(clockid_t clock) {
  int64_t smallest = std::numeric_limits<int64_t>::max();
  for (int i = 0; i < 1000; ++i) {
    const int64_t before = now_ns(clock);
    int64_t after = before;
    while (after == before) after = now_ns(clock);
    if (after - before < smallest) smallest = after - before;
  }
  return smallest;
}

std::string utc_now() {
  const time_t now = time(nullptr);
  tm parts;
  gmtime_r(&now, &parts);
  char text[sizeof "2026-11-21T10:00:00Z"];
  strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text;
}

}  // namespace rt_tests
