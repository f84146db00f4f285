// The jitter and the lateness of a cyclic timer, computed from its samples.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/summary.h"

namespace cyclic {

// timestamp, and what roscpp told the callback on its own clock: when it was due, and when it was called.
constexpr std::size_t columns = 3;
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

// How late a call is, after one that was due at `previous_expected_ns`. Where roscpp has moved its grid by more than whole
// periods, the call is late by that, too: it was due on the grid as it was before.
constexpr int64_t lateness_ns(int64_t previous_expected_ns, int64_t expected_ns, int64_t real_ns, int64_t period_ns) {
  const int64_t passed_ns = expected_ns - previous_expected_ns;
  return real_ns - expected_ns + (passed_ns > period_ns ? passed_ns % period_ns : 0);
}

// How late the call of a row is. The first call has no lateness.
inline std::optional<int64_t> lateness_of(const Samples& samples, std::size_t row, int64_t frequency_hz) {
  if (row == 0) return std::nullopt;
  const auto& [timestamp_ns, expected_ns, real_ns] = samples[row];
  return lateness_ns(samples[row - 1][1], expected_ns, real_ns, grid_ns(1, frequency_hz));
}

// How late the calls are, for the same i as above. Skipped periods are counted beside it.
inline void analyse_lateness(const Samples& samples, int64_t frequency_hz, rt_tests::Series& lateness) {
  for (std::size_t i = 1; i < samples.size(); ++i) {
    lateness.add(*lateness_of(samples, i, frequency_hz), static_cast<int64_t>(i) - 1);
  }
}

// `overruns` are calls that began more than a period after they were due, or ended so late that roscpp moved its grid:
// a timer that is two periods behind goes on from the current time. `skipped` are the periods without a call.
struct Overruns {
  int64_t overruns = 0, skipped = 0;
};

inline Overruns count_overruns(const Samples& samples, int64_t frequency_hz) {
  const int64_t period_ns = grid_ns(1, frequency_hz);
  Overruns result;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const auto& [timestamp_ns, expected_ns, real_ns] = samples[i];
    const int64_t to_next_ns = i + 1 < samples.size() ? samples[i + 1][1] - expected_ns : period_ns;
    const int64_t skipped = std::max<int64_t>(to_next_ns / period_ns - 1, 0);
    if (skipped > 0 || real_ns - expected_ns > period_ns) ++result.overruns;
    result.skipped += skipped;
  }
  return result;
}

}  // namespace cyclic
