// The measuring loop of the one-shot timer and the hand-over between its threads. No ROS in here.
#pragma once

#include <semaphore.h>

#include <atomic>
#include <cstdint>
#include <limits>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/stop.h"
#include "rt_tests_support/trace.h"

namespace oneshot {

constexpr int64_t did_not_fire = std::numeric_limits<int64_t>::min();

// Hands the outcome of one shot at a time from the thread that runs the callbacks to the thread that measures. Shots
// are numbered, so that the outcome of one is never taken for that of another.
class ShotBox {
 public:
  ShotBox(clockid_t clock, int64_t limit_ns) : clock_(clock), limit_ns_(limit_ns) { sem_init(&settled_once_, 0, 0); }
  ~ShotBox() { sem_destroy(&settled_once_); }
  ShotBox(const ShotBox&) = delete;
  ShotBox& operator=(const ShotBox&) = delete;

  // Measuring thread, before the timer is started: from here on there is no outcome.
  void arm(int64_t start_ns) noexcept {
    start_ns_.store(start_ns, std::memory_order_relaxed);
    armed_.fetch_add(1, std::memory_order_release);
  }

  // In the timer's callback.
  void fire(int64_t end_ns, int64_t reported_ns) noexcept {
    fired_ = armed_.load(std::memory_order_acquire);
    end_ns_ = end_ns;
    reported_ns_ = reported_ns;
  }

  // On the thread of the callbacks, after they returned: true once for each shot, when it fired or its time is over.
  // Not in the callback itself: until that returned, roscpp forgets a timer that is started again (the "randomly
  // ignored timers" of the thesis).
  bool settle() noexcept {
    const uint32_t shot = armed_.load(std::memory_order_acquire);
    if (shot == settled_.load(std::memory_order_relaxed)) return false;
    if (fired_ != shot) {
      if (rt_tests::now_ns(clock_) - start_ns_.load(std::memory_order_relaxed) < limit_ns_) return false;
      end_ns_ = did_not_fire;
    }
    settled_.store(shot, std::memory_order_release);
    return true;
  }

  void wake() noexcept { sem_post(&settled_once_); }
  sem_t* semaphore() noexcept { return &settled_once_; }
  bool is_settled() const noexcept {
    return settled_.load(std::memory_order_acquire) == armed_.load(std::memory_order_relaxed);
  }

  // Measuring thread: one wait. False if a stop was requested first.
  bool wait() noexcept {
    while (!is_settled()) {
      if (rt_tests::stop_requested()) return false;
      sem_wait(&settled_once_);
    }
    return true;
  }

  // Of the settled shot.
  bool has_fired() const noexcept { return end_ns_ != did_not_fire; }
  int64_t end_ns() const noexcept { return end_ns_; }
  int64_t reported_ns() const noexcept { return reported_ns_; }

 private:
  const clockid_t clock_;
  const int64_t limit_ns_;
  sem_t settled_once_;
  std::atomic<uint32_t> armed_{0};
  std::atomic<uint32_t> settled_{0};
  std::atomic<int64_t> start_ns_{0};
  uint32_t fired_ = 0;  // this and what follows: written by the callbacks' thread, read when settled
  int64_t end_ns_ = 0;
  int64_t reported_ns_ = 0;
};

using Samples = rt_tests::Samples<4>;  // start, end, measured, reported

// Fills the samples: for each shot one start timestamp, one wait, one callback timestamp, nothing allocated.
//   trigger()  starts the timer
//   cancel()   ends it for good: afterwards the callback of this shot neither runs nor will run
//   wait()     returns when the box is settled; false on a stop
template <class Trigger, class Cancel, class Wait>
void measure(clockid_t clock, int64_t timeout_ns, ShotBox& box, Samples& samples, rt_tests::Noted& not_fired,
             rt_tests::OutlierTrace& outliers, Trigger trigger, Cancel cancel, Wait wait) {
  while (!samples.full()) {
    const auto index = static_cast<int64_t>(samples.size());
    const int64_t start_ns = rt_tests::now_ns(clock);
    box.arm(start_ns);
    trigger();
    if (!wait()) return;
    if (!box.has_fired()) {
      cancel();
      not_fired.note(index);
      samples.append({start_ns, did_not_fire, did_not_fire, did_not_fire});
      continue;
    }
    const int64_t measured_ns = box.end_ns() - timeout_ns - start_ns;
    samples.append({start_ns, box.end_ns(), measured_ns, box.reported_ns()});
    if (outliers.exceeded(measured_ns, index, box.end_ns())) return;
  }
}

}  // namespace oneshot
