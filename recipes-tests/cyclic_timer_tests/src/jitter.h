// The jitter of a cyclic timer, computed from its timestamps. Without ROS.
#pragma once

#include <cstdint>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/summary.h"

namespace cyclic {

constexpr std::size_t columns = 1;  // timestamp
using Samples = rt_tests::Samples<columns>;

// i / f, rounded to the nearest nanosecond. The error does not grow with i, so a grid of these times does not drift.
constexpr int64_t grid_ns(int64_t i, int64_t frequency_hz) {
  return (2 * i * rt_tests::ns_per_s + frequency_hz) / (2 * frequency_hz);
}

// jitter[i] = t[i+1] - t[i] - 1/f and grid[i] = t[i+1] - (t[0] + (i+1)/f), for i from 0: N + 1 timestamps give N values.
inline void analyse(const Samples& samples, int64_t frequency_hz, rt_tests::Series& jitter, rt_tests::Series& grid) {
  for (std::size_t i = 0; i + 1 < samples.size(); ++i) {
    const auto index = static_cast<int64_t>(i);
    jitter.add(samples[i + 1][0] - samples[i][0] - grid_ns(1, frequency_hz), index);
    grid.add(samples[i + 1][0] - samples[0][0] - grid_ns(index + 1, frequency_hz), index);
  }
}

}  // namespace cyclic
