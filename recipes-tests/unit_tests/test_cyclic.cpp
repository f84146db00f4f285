#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "rt_tests_support/measure/jitter.h"

using rt_tests::Series;

TEST(Cyclic, SevenKilohertzDoesNotDrift) {
  // The 2014 programs took 142 us for 1/7000 s: 0.857 us wrong each time, 1.7 s after two million.
  EXPECT_EQ(cyclic::grid_ns(1, 7000), 142857);
  EXPECT_EQ(cyclic::grid_ns(7000, 7000), 1000000000);
  EXPECT_EQ(cyclic::grid_ns(100000000, 7000), 14285714285714);
  EXPECT_EQ(cyclic::grid_ns(3, 7000), 428571);  // not 3 * 142857 = 428571.0; exact 428571.43
  EXPECT_EQ(cyclic::grid_ns(6, 7000), 857143);  // 6 * 142857 would be 857142
}

TEST(Cyclic, JitterAndGridFromTheSameTimestamps) {
  cyclic::Samples samples(5);
  for (int64_t t : {1000, 1001000, 2501000, 3001000, 4001000}) samples.append({t, 0, 0});
  Series jitter("jitter"), grid("grid");
  cyclic::analyse(samples, 1000, jitter, grid);
  EXPECT_EQ(jitter.n(), 4);
  EXPECT_EQ(jitter.max_ns(), 500000);
  EXPECT_EQ(jitter.top()[0].index, 1);
  EXPECT_EQ(jitter.min_ns(), -500000);
  EXPECT_EQ(jitter.lowest()[0].index, 2);
  EXPECT_EQ(jitter.mean_ns(), 0);
  EXPECT_EQ(grid.max_ns(), 500000);  // a late wake-up counts once
  EXPECT_EQ(grid.min_ns(), 0);
}

TEST(Cyclic, IdealTimestampsHaveNoLateness) {
  cyclic::Samples samples(70001);
  for (int64_t i = 0; i <= 70000; ++i) samples.append({500 + cyclic::grid_ns(i, 7000), 0, 0});
  Series jitter("jitter"), grid("grid");
  cyclic::analyse(samples, 7000, jitter, grid);
  EXPECT_EQ(grid.min_ns(), 0);
  EXPECT_EQ(grid.max_ns(), 0);
  EXPECT_GE(jitter.min_ns(), -1);
  EXPECT_LE(jitter.max_ns(), 1);
}

TEST(Cyclic, StoppedEarlyOnlyWhatIsThere) {
  cyclic::Samples samples(1000);
  Series none("jitter"), none_grid("grid");
  cyclic::analyse(samples, 1000, none, none_grid);
  EXPECT_EQ(none.n(), 0);
  samples.append({5, 0, 0});
  cyclic::analyse(samples, 1000, none, none_grid);
  EXPECT_EQ(none.n(), 0);
  samples.append({1000005, 0, 0});
  Series single("jitter"), single_grid("grid");
  cyclic::analyse(samples, 1000, single, single_grid);
  EXPECT_EQ(single.n(), 1);
  EXPECT_EQ(single.max_ns(), 0);
}

// Calls as roscpp makes them, in periods: it goes on from the current time once it is two periods behind.
TEST(Cyclic, AGridThatRoscppMovesHasSkippedPeriods) {
  constexpr int64_t period = 1000000;
  const auto counted = [](const std::vector<std::pair<double, double>>& calls, Series& lateness) {
    cyclic::Samples samples(calls.size());
    for (const auto& [expected, real] : calls) {
      samples.append({0, static_cast<int64_t>(expected * period), static_cast<int64_t>(real * period)});
    }
    cyclic::analyse_lateness(samples, 1000, lateness);
    return cyclic::count_overruns(samples, 1000);
  };
  Series kept("lateness"), burst("lateness"), moved("lateness"), long_call("lateness"), back("lateness");
  auto result = counted({{1, 1.25}, {2, 2.5}, {3, 3}}, kept);
  EXPECT_EQ(std::pair(result.overruns, result.skipped), std::pair(INT64_C(0), INT64_C(0)));
  EXPECT_EQ(kept.n(), 2);  // the first call is the origin
  EXPECT_EQ(kept.top()[0].value_ns, 500000);
  EXPECT_EQ(kept.top()[0].index, 0);
  result = counted({{1, 1}, {2, 3.75}, {3, 3.75}, {4, 4}}, burst);  // made up for: late, but none is skipped
  EXPECT_EQ(std::pair(result.overruns, result.skipped), std::pair(INT64_C(1), INT64_C(0)));
  result = counted({{1, 1}, {2, 7.25}, {7.25, 7.25}, {8.25, 8.25}}, moved);  // those due at 3, 4, 5 and 6
  EXPECT_EQ(std::pair(result.overruns, result.skipped), std::pair(INT64_C(1), INT64_C(4)));
  EXPECT_EQ(moved.max_ns(), 5250000);
  EXPECT_EQ(moved.top()[1].value_ns, 250000);  // that due at 7: to move the grid is no pardon
  EXPECT_EQ(moved.min_ns(), 0);
  result = counted({{1, 1}, {2, 2}, {4.5, 4.5}, {5.5, 5.5}}, long_call);  // called in time, ended too late
  EXPECT_EQ(std::pair(result.overruns, result.skipped), std::pair(INT64_C(1), INT64_C(1)));
  result = counted({{1000, 1000}, {3, 2}, {4, 4}}, back);  // the wall clock was put back
  EXPECT_EQ(std::pair(result.overruns, result.skipped), std::pair(INT64_C(0), INT64_C(0)));
}
