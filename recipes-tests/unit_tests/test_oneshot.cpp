#include <gtest/gtest.h>

#include <csignal>
#include <thread>

#include "rt_tests_support/errors.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/measure/shots.h"

using oneshot::did_not_fire;
using oneshot::ShotBox;

namespace {

constexpr clockid_t clock_used = CLOCK_MONOTONIC_RAW;

// roscpp's side, with faults: shots fire from another thread, each after what `plan` says.
enum class Fate { fires, fires_at_once, never, late };

struct FakeTimer {
  ShotBox& box;
  std::vector<Fate> plan;
  std::size_t shot = 0;
  std::atomic<int> pending{0};     // shots that are to fire
  std::atomic<bool> ended{false};
  bool owed = false;               // a callback that comes only when the shot is cancelled
  int cancelled = 0;
  std::thread spinner{[this] {
    while (!ended) {
      if (pending > 0) {
        box.fire(rt_tests::now_ns(clock_used), 7);
        pending = 0;
      }
      if (box.settle()) box.wake();
      std::this_thread::yield();
    }
  }};

  FakeTimer(ShotBox& with, std::vector<Fate> fates) : box(with), plan(std::move(fates)) {}
  ~FakeTimer() {
    ended = true;
    spinner.join();
  }

  void trigger() {
    const Fate fate = plan[shot++];
    if (fate == Fate::fires) pending = 1;
    if (fate == Fate::fires_at_once) {
      pending = 1;
      while (pending > 0 || !box.is_settled()) std::this_thread::yield();
    }
    owed = fate == Fate::late;
  }

  // Like ros::Timer::stop(): a callback that runs is waited for, none comes later.
  void cancel() {
    ++cancelled;
    if (owed) {
      pending = 1;
      while (pending > 0) std::this_thread::yield();
    }
  }
};

void measure(const std::vector<Fate>& plan, oneshot::Samples& samples, rt_tests::Events& not_fired, int& cancelled) {
  const rt_tests::Program program = {"", "", "", {"clock", "break_trace_us"}};
  const rt_tests::Options options(program);
  rt_tests::OutlierTrace trace(options, "", "", rt_tests::current_cpus(), {});
  ShotBox box(clock_used, 20 * 1000000);
  FakeTimer timer(box, plan);
  oneshot::measure(
      clock_used, 1000, box, samples, not_fired, trace, [&] { timer.trigger(); }, [&] { timer.cancel(); },
      [&] { return box.wait(); });
  cancelled = timer.cancelled;
}

}  // namespace

TEST(Oneshot, EveryShotHasOneRow) {
  oneshot::Samples samples(500);
  rt_tests::Events not_fired;
  int cancelled = 0;
  measure(std::vector<Fate>(500, Fate::fires), samples, not_fired, cancelled);
  ASSERT_EQ(samples.size(), 500u);
  EXPECT_EQ(not_fired.count(), 0);
  EXPECT_EQ(cancelled, 0);
  int64_t previous_end = 0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const auto& [start, end, measured, reported, armed] = samples[i];
    EXPECT_GE(start, previous_end);  // no outcome of an earlier shot
    EXPECT_GE(end, start);
    EXPECT_GE(armed, start);
    EXPECT_EQ(measured, end - 1000 - start);
    EXPECT_EQ(reported, 7);
    previous_end = end;
  }
}

// The 2014 programs cleared the flag after they had started the timer, and waited for ever for a quick one.
TEST(Oneshot, CallbackBeforeTriggerReturnsIsNotLost) {
  oneshot::Samples samples(50);
  rt_tests::Events not_fired;
  int cancelled = 0;
  measure(std::vector<Fate>(50, Fate::fires_at_once), samples, not_fired, cancelled);
  EXPECT_EQ(not_fired.count(), 0);
  ASSERT_EQ(samples.size(), 50u);
  for (std::size_t i = 0; i < samples.size(); ++i) EXPECT_GE(samples[i][4], samples[i][1]);  // armed after the callback
}

// They threw a late callback away and repeated the shot, or took it for the next one.
TEST(Oneshot, ShotsThatDoNotFireAreCountedAndLateCallbacksAreNobodyElses) {
  oneshot::Samples samples(6);
  rt_tests::Events not_fired;
  int cancelled = 0;
  measure({Fate::fires, Fate::never, Fate::late, Fate::fires, Fate::late, Fate::fires}, samples, not_fired, cancelled);
  ASSERT_EQ(samples.size(), 6u);
  EXPECT_EQ(not_fired.indices(), std::vector<int64_t>({1, 2, 4}));
  EXPECT_EQ(cancelled, 3);
  for (std::size_t i : {1u, 2u, 4u}) {
    EXPECT_EQ(samples[i][1], did_not_fire);
    EXPECT_EQ(samples[i][2], did_not_fire);
    EXPECT_EQ(samples[i][3], did_not_fire);
  }
  for (std::size_t i : {0u, 3u, 5u}) EXPECT_GE(samples[i][1], samples[i][0]);
}

// Between the time limit and the measuring thread's look at the outcome.
TEST(Oneshot, ACallbackAfterTheTimeLimitChangesNoOutcome) {
  ShotBox box(clock_used, 0);
  box.arm(rt_tests::now_ns(clock_used) - 1);
  ASSERT_TRUE(box.settle());
  box.fire(rt_tests::now_ns(clock_used), 7);
  EXPECT_FALSE(box.has_fired());
  EXPECT_EQ(box.end_ns(), did_not_fire);
  EXPECT_FALSE(box.settle());
}

TEST(Oneshot, StopLeavesOnlyWholeRows) {
  oneshot::Samples samples(3);
  rt_tests::Events not_fired;
  const rt_tests::Program program = {"", "", "", {"clock", "break_trace_us"}};
  const rt_tests::Options options(program);
  rt_tests::OutlierTrace trace(options, "", "", rt_tests::current_cpus(), {});
  ShotBox box(clock_used, INT64_C(1000000000000));
  rt_tests::catch_stop_signals(box.semaphore());
  int shots = 0;
  oneshot::measure(
      clock_used, 1000, box, samples, not_fired, trace,
      [&] {
        if (++shots == 2) {
          raise(SIGTERM);
        } else {
          box.fire(rt_tests::now_ns(clock_used), 0);
          box.settle();
        }
      },
      [] {}, [&] { return box.wait(); });
  EXPECT_EQ(samples.size(), 1u);
  EXPECT_EQ(rt_tests::stop_reason(), "ended by SIGTERM");
}

// start, end, measured, reported, armed: the 2014 programs counted from `armed`, and got less by armed - start.
TEST(Oneshot, SeriesFromBeforeAndAfterArming) {
  oneshot::Samples samples(3);
  samples.append({1000, 9000, 5000, 4800, 1300});
  samples.append({20000, did_not_fire, did_not_fire, did_not_fire, 20300});
  samples.append({40000, 43100, 100, 90, 40200});
  const oneshot::Results results(samples);
  const auto values = [](const rt_tests::Series& series) {
    std::vector<std::pair<int64_t, int64_t>> pairs;
    for (const auto& item : series.top()) pairs.emplace_back(item.index, item.value_ns);
    return pairs;
  };
  using Pairs = std::vector<std::pair<int64_t, int64_t>>;
  EXPECT_EQ(values(results.measured), (Pairs{{0, 5000}, {2, 100}}));
  EXPECT_EQ(values(results.reported), (Pairs{{0, 4800}, {2, 90}}));
  EXPECT_EQ(values(results.difference), (Pairs{{2, -10}, {0, -200}}));
  EXPECT_EQ(values(results.measured_2014), (Pairs{{0, 4700}, {2, -100}}));
  EXPECT_EQ(values(results.difference_2014), (Pairs{{2, 190}, {0, 100}}));
}
