// The measuring loop of the one-shot timer and how its threads exchange results.
#pragma once

#include <semaphore.h>

#include <atomic>
#include <cstdint>
#include <limits>
#include <optional>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/samples.h"
#include "rt_tests_support/stop.h"
#include "rt_tests_support/summary.h"
#include "rt_tests_support/trace.h"

namespace oneshot {

constexpr int64_t did_not_fire = std::numeric_limits<int64_t>::min();

// Passes the outcome of one shot at a time from the thread that runs the callbacks to the measuring thread. Shots are
// numbered, so that a late outcome of one shot is never taken for that of the next.
class ShotBox {
 public:
  ShotBox(clockid_t clock, int64_t limit_ns) : clock_(clock), limit_ns_(limit_ns) { sem_init(&settled_once_, 0, 0); }
  ~ShotBox() { sem_destroy(&settled_once_); }
  ShotBox(const ShotBox&) = delete;
  ShotBox& operator=(const ShotBox&) = delete;

  // On the measuring thread, before the timer is armed: the next shot, which has no outcome yet.
  void arm(int64_t start_ns) noexcept {
    start_ns_.store(start_ns, std::memory_order_relaxed);
    armed_.fetch_add(1, std::memory_order_release);
  }

  // In the timer's callback. Changes nothing for a shot that is settled.
  void fire(int64_t end_ns, int64_t reported_ns) noexcept {
    fired_ = armed_.load(std::memory_order_acquire);
    fired_end_ns_ = end_ns;
    fired_reported_ns_ = reported_ns;
  }

  // On the thread that runs the callbacks, after they returned: true once for each shot, when it fired or its time
  // limit passed. Not in the callback itself: when the callback returns, roscpp disarms the timer, also if it was armed
  // again in the meantime (the "randomly ignored timers" of the thesis).
  bool settle() noexcept {
    const uint32_t shot = armed_.load(std::memory_order_acquire);
    if (shot == settled_.load(std::memory_order_relaxed)) return false;
    if (fired_ == shot) {
      end_ns_ = fired_end_ns_;
      reported_ns_ = fired_reported_ns_;
    } else {
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

  // On the measuring thread: waits until the shot is settled. False if a stop is requested first.
  bool wait() noexcept {
    while (!is_settled()) {
      if (rt_tests::stop_requested()) return false;
      sem_wait(&settled_once_);
    }
    return true;
  }

  // The outcome of the settled shot.
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
  static_assert(std::atomic<int64_t>::is_always_lock_free, "a lock could be held by a thread of lower priority");
  // Of the thread that runs the callbacks alone: a callback may come when its shot is settled already.
  uint32_t fired_ = 0;
  int64_t fired_end_ns_ = 0;
  int64_t fired_reported_ns_ = 0;
  // Written by settle() until the shot is settled, read by the measuring thread from then until it arms the next one.
  int64_t end_ns_ = 0;
  int64_t reported_ns_ = 0;
};

// start, end, measured, reported, armed. `start` is taken before the timer is armed, `armed` after it, as the start of
// the 2014 programs was: roscpp computes the expiry in between. `measured` is end - timeout - start.
constexpr std::size_t columns = 5;
using Samples = rt_tests::Samples<columns>;

// The latency of the shot of a row; none of one that did not fire.
inline std::optional<int64_t> latency_of(const Samples& samples, std::size_t row) {
  const auto& [start_ns, end_ns, measured_ns, reported_ns, armed_ns] = samples[row];
  return end_ns == did_not_fire ? std::nullopt : std::optional<int64_t>(measured_ns);
}

// Fills the samples, for each shot one row. Allocates nothing.
//   trigger()  arms the timer
//   cancel()   stops the timer: afterwards the callback of this shot neither runs nor will run
//   wait()     returns true when the box is settled, false if a stop is requested first
template <class Trigger, class Cancel, class Wait>
void measure(clockid_t clock, int64_t timeout_ns, ShotBox& box, Samples& samples, rt_tests::Events& not_fired,
             rt_tests::OutlierTrace& outliers, Trigger trigger, Cancel cancel, Wait wait) {
  while (!samples.full()) {
    const auto index = static_cast<int64_t>(samples.size());
    const int64_t start_ns = rt_tests::now_ns(clock);
    box.arm(start_ns);
    trigger();
    const int64_t armed_ns = rt_tests::now_ns(clock);
    if (!wait()) return;
    if (!box.has_fired()) {
      cancel();
      not_fired.note(index);
      samples.append({start_ns, did_not_fire, did_not_fire, did_not_fire, armed_ns});
      continue;
    }
    const int64_t measured_ns = box.end_ns() - timeout_ns - start_ns;
    samples.append({start_ns, box.end_ns(), measured_ns, box.reported_ns(), armed_ns});
    if (outliers.exceeded(measured_ns, index, box.end_ns())) return;
  }
}

// The series of the shots that fired. Those named 2014 count from `armed`, as the 2014 programs did; since roscpp has
// computed the expiry by then, they can be negative.
struct Results {
  rt_tests::Series measured{"measured"}, reported{"reported"}, difference{"difference"};
  rt_tests::Series measured_2014{"measured_2014"}, difference_2014{"difference_2014"};

  explicit Results(const Samples& samples) {
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const auto& [start_ns, end_ns, measured_ns, reported_ns, armed_ns] = samples[i];
      if (end_ns == did_not_fire) continue;
      const auto index = static_cast<int64_t>(i);
      const int64_t measured_2014_ns = measured_ns - (armed_ns - start_ns);
      measured.add(measured_ns, index);
      reported.add(reported_ns, index);
      difference.add(reported_ns - measured_ns, index);
      measured_2014.add(measured_2014_ns, index);
      difference_2014.add(reported_ns - measured_2014_ns, index);
    }
  }
};

}  // namespace oneshot
