// The beat of the publisher. No ROS in here.
#pragma once

#include <time.h>

#include <cstdint>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/stop.h"

namespace communication {

// Sleeps until a grid of exactly i/f. One that is late by more than a period goes on from there, as ros::Rate does,
// instead of catching up in a burst.
class Pace {
 public:
  explicit Pace(int64_t frequency_hz)
      : frequency_hz_(frequency_hz), origin_ns_(rt_tests::now_ns(CLOCK_MONOTONIC)) {}

  // False on a stop.
  bool wait() noexcept {
    const int64_t due_ns = origin_ns_ + ++beat_ * rt_tests::ns_per_s / frequency_hz_;
    timespec due;
    due.tv_sec = static_cast<time_t>(due_ns / rt_tests::ns_per_s);
    due.tv_nsec = static_cast<long>(due_ns % rt_tests::ns_per_s);
    while (!rt_tests::stop_requested() && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr) != 0) {
    }
    const int64_t late_ns = rt_tests::now_ns(CLOCK_MONOTONIC) - due_ns;
    if (late_ns > rt_tests::ns_per_s / frequency_hz_) origin_ns_ += late_ns;
    return !rt_tests::stop_requested();
  }

 private:
  const int64_t frequency_hz_;
  int64_t origin_ns_;
  int64_t beat_ = 0;
};

}  // namespace communication
