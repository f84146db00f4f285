#include <gtest/gtest.h>

#include "rt_tests_support/samples.h"
#include "rt_tests_support/summary.h"

using namespace rt_tests;

namespace {

Series series_of(const std::vector<int64_t>& values_ns) {
  Series series("measured");
  for (std::size_t i = 0; i < values_ns.size(); ++i) series.add(values_ns[i], static_cast<int64_t>(i));
  return series;
}

}  // namespace

TEST(Summary, FewValuesGiveShortLists) {
  const Series series = series_of({3000, 9000, 5000});
  const auto lines = boundary_lines(series);
  EXPECT_EQ(lines[0], "Indices of top values(|latency:index|): |9:1|5:2|3:0|");
  EXPECT_EQ(lines[1], "Indices of lowest values(|latency:index|): |3:0|5:2|9:1|");
}

TEST(Summary, TenOfManyAndEqualValuesInOrderOfIndex) {
  std::vector<int64_t> values;
  for (int64_t i = 0; i < 1000; ++i) values.push_back(i % 3 * 1000);
  const Series series = series_of(values);
  ASSERT_EQ(series.top().size(), 10u);
  ASSERT_EQ(series.lowest().size(), 10u);
  for (int64_t i = 0; i < 10; ++i) {
    EXPECT_EQ(series.top()[i].value_ns, 2000);
    EXPECT_EQ(series.top()[i].index, 3 * i + 2);
    EXPECT_EQ(series.lowest()[i].value_ns, 0);
    EXPECT_EQ(series.lowest()[i].index, 3 * i);
  }
}

TEST(Summary, SecondsDoNotOverflow) {
  const Series series = series_of({2200000000, 3000000000, 60000000000});
  EXPECT_EQ(series.min_ns(), 2200000000);
  EXPECT_EQ(series.mean_ns(), 21733333333);
  EXPECT_EQ(series.max_ns(), 60000000000);
  EXPECT_EQ(extremes(series, "", "\t"), "MIN: 2200000us\tAVG: 21733333us\tMAX: 60000000us");
}

TEST(Summary, TextIsThatOf2014) {
  const Series series = series_of({60000, 138999, 104000});
  EXPECT_EQ("Measured:\t" + extremes(series, " ", " \t"), "Measured:\tMIN:  60us \tAVG:  100us \tMAX:  138us");
}

// In 2014 latencies were divided by 1000 (towards zero), jitter was a difference of whole microseconds (down).
TEST(Summary, BinsAreRoundedAsIn2014) {
  Series latency("measured"), jitter("jitter", Rounding::down);
  for (const int64_t value_ns : {-2000, -1999, -1000, -999, -1, 0, 1, 999, 1000}) {
    latency.add(value_ns, 0);
    jitter.add(value_ns, 0);
  }
  EXPECT_EQ(latency.bins(), (std::map<int64_t, int64_t>{{-2, 1}, {-1, 2}, {0, 5}, {1, 1}}));
  EXPECT_EQ(jitter.bins(), (std::map<int64_t, int64_t>{{-2, 2}, {-1, 3}, {0, 3}, {1, 1}}));
  EXPECT_EQ(extremes(jitter, "", "\t"), "MIN: -2us\tAVG: 0us\tMAX: 1us");
}

TEST(Summary, JitterIsRoundedDownInEveryLine) {
  Series jitter("jitter", Rounding::down);
  for (const int64_t value_ns : {-1500, -500, 500}) jitter.add(value_ns, jitter.n());
  EXPECT_EQ(extremes(jitter, "", "\t"), "MIN: -2us\tAVG: -1us\tMAX: 0us");
  EXPECT_EQ(boundary_lines(jitter)[1], "Indices of lowest values(|latency:index|): |-2:0|-1:1|0:2|");
}

TEST(Summary, NegativeMeanIsRoundedToTheNearest) {
  EXPECT_EQ(series_of({-1, -2}).mean_ns(), -2);
  EXPECT_EQ(series_of({-1, -1, -2}).mean_ns(), -1);
  EXPECT_EQ(series_of({1, 2, 2}).mean_ns(), 2);
}

TEST(Summary, NothingIsSaidOfNothing) {
  const Series none = series_of({});
  EXPECT_EQ(none.n(), 0);
  EXPECT_EQ(extremes(none, "", "\t"), "no samples");
  EXPECT_EQ(boundary_lines(none)[0], "Indices of top values(|latency:index|): |");
}

TEST(Samples, OnlyRowsWrittenCount) {
  Samples<2> samples(3);
  EXPECT_EQ(samples.size(), 0u);
  EXPECT_TRUE(samples.append({1, 2}));
  EXPECT_TRUE(samples.append({3, 4}));
  EXPECT_EQ(samples.size(), 2u);
  EXPECT_TRUE(samples.append({5, 6}));
  EXPECT_TRUE(samples.full());
  EXPECT_FALSE(samples.append({7, 8}));
  EXPECT_EQ(std::vector<int64_t>(samples.data(), samples.data() + 6), std::vector<int64_t>({1, 2, 3, 4, 5, 6}));
}

TEST(Events, CountsAllListsAThousand) {
  Events noted;
  for (int64_t i = 0; i < 1500; ++i) noted.note(i);
  EXPECT_EQ(noted.count(), 1500);
  EXPECT_EQ(noted.indices().size(), 1000u);
  EXPECT_EQ(noted.indices().back(), 999);
}
