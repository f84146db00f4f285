// What the timestamps of a cyclic timer say. No ROS in here.
#pragma once

#include <cstdint>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/summary.h"

namespace cyclic {

using Samples = rt_tests::Samples<1>;  // timestamp

// i / f, rounded to the nearest nanosecond: exact for any i, so a grid made of it does not drift at 7 kHz.
constexpr int64_t grid_ns(int64_t i, int64_t frequency_hz) {
  return (2 * i * rt_tests::ns_per_s + frequency_hz) / (2 * frequency_hz);
}

// jitter[i] = t[i+1] - t[i] - 1/f and grid[i] = t[i+1] - (t[0] + (i+1)/f), i from 0: N from N + 1 timestamps.
inline void analyse(const Samples& samples, int64_t frequency_hz, rt_tests::Series& jitter, rt_tests::Series& grid) {
  for (std::size_t i = 0; i + 1 < samples.size(); ++i) {
    const auto index = static_cast<int64_t>(i);
    jitter.add(samples[i + 1][0] - samples[i][0] - grid_ns(1, frequency_hz), index);
    grid.add(samples[i + 1][0] - samples[0][0] - grid_ns(index + 1, frequency_hz), index);
  }
}

}  // namespace cyclic
