#include <gtest/gtest.h>

#include "jitter.h"

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
  for (int64_t t : {1000, 1001000, 2501000, 3001000, 4001000}) samples.append({t});
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
  for (int64_t i = 0; i <= 70000; ++i) samples.append({500 + cyclic::grid_ns(i, 7000)});
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
  samples.append({5});
  cyclic::analyse(samples, 1000, none, none_grid);
  EXPECT_EQ(none.n(), 0);
  samples.append({1000005});
  Series one("jitter"), one_grid("grid");
  cyclic::analyse(samples, 1000, one, one_grid);
  EXPECT_EQ(one.n(), 1);
  EXPECT_EQ(one.max_ns(), 0);
}
