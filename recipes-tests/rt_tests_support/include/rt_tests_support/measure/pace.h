// When the publisher sends its messages.
#pragma once

#include <time.h>

#include <cstdint>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/stop.h"

namespace communication {

// Sleeps until the next multiple of 1/f. A caller that is late by more than a period continues from there, as with
// ros::Rate, instead of sending the missed messages in a burst: that is an overrun, and the whole periods by which it is
// late are skipped.
class Pace {
 public:
  explicit Pace(int64_t frequency_hz)
      : frequency_hz_(frequency_hz), origin_ns_(rt_tests::now_ns(CLOCK_MONOTONIC)) {}

  // False if a stop is requested.
  bool wait() noexcept {
    const int64_t due_ns = origin_ns_ + ++periods_ * rt_tests::ns_per_s / frequency_hz_;
    timespec due;
    due.tv_sec = static_cast<time_t>(due_ns / rt_tests::ns_per_s);
    due.tv_nsec = static_cast<long>(due_ns % rt_tests::ns_per_s);
    while (!rt_tests::stop_requested() && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr) != 0) {
    }
    const int64_t late_ns = rt_tests::now_ns(CLOCK_MONOTONIC) - due_ns;
    if (late_ns > rt_tests::ns_per_s / frequency_hz_) {
      origin_ns_ += late_ns;
      ++overruns_;
      skipped_ += late_ns / rt_tests::ns_per_s * frequency_hz_ +
                  late_ns % rt_tests::ns_per_s * frequency_hz_ / rt_tests::ns_per_s;
    }
    return !rt_tests::stop_requested();
  }

  int64_t overruns() const noexcept { return overruns_; }
  int64_t skipped() const noexcept { return skipped_; }

 private:
  const int64_t frequency_hz_;
  int64_t origin_ns_;
  int64_t periods_ = 0;
  int64_t overruns_ = 0;
  int64_t skipped_ = 0;
};

}  // namespace communication
