#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "rt_tests_support/measure/pace.h"
#include "rt_tests_support/measure/receptions.h"

using communication::Receptions;

TEST(Receptions, AllInOrder) {
  communication::Samples samples(3);
  Receptions receptions(samples);
  for (uint32_t seq = 0; seq < 3; ++seq) receptions.receive(10 + seq, 20 + seq, seq, seq == 2);
  EXPECT_TRUE(receptions.last_came());
  EXPECT_EQ(samples.size(), 3u);
  EXPECT_EQ(receptions.missing().count(), 0);
  EXPECT_EQ(receptions.incomplete_reason(""), "");
}

TEST(Receptions, MissingDuplicateAndOutOfOrderAreCountedAndListed) {
  communication::Samples samples(8);
  Receptions receptions(samples);
  for (uint32_t seq : {0u, 2u, 1u, 1u, 0u, 5u, 4u, 7u}) receptions.receive(0, 1, seq, seq == 7);
  EXPECT_EQ(samples.size(), 6u);
  EXPECT_EQ(receptions.missing().indices(), std::vector<int64_t>({3, 6}));
  EXPECT_EQ(receptions.duplicate.indices(), std::vector<int64_t>({1, 0}));
  EXPECT_EQ(receptions.out_of_order.indices(), std::vector<int64_t>({1, 4}));
  EXPECT_EQ(receptions.incomplete_reason(""), "");
  EXPECT_EQ(static_cast<int64_t>(samples.size()) + receptions.missing().count(), 8);
}

// seq comes from the network; the 2014 subscriber wrote wherever it pointed.
TEST(Receptions, NumbersOutOfRangeAreNotBelieved) {
  communication::Samples samples(4);
  Receptions receptions(samples);
  receptions.receive(0, 1, 0, false);
  receptions.receive(0, 1, 4, false);
  receptions.receive(0, 1, 4294967295u, true);
  EXPECT_TRUE(receptions.last_came());
  EXPECT_EQ(samples.size(), 1u);
  EXPECT_EQ(receptions.incomplete_reason(""),
            "2 messages numbered 4 or more came: publisher and subscriber need the same -r");
  // The number of the last message says that those before it were sent.
  EXPECT_EQ(receptions.missing().indices(), std::vector<int64_t>({1, 2, 3}));
}

TEST(Receptions, LastMessageLost) {
  communication::Samples samples(4);
  Receptions receptions(samples);
  for (uint32_t seq : {0u, 2u}) receptions.receive(0, 1, seq, false);
  EXPECT_FALSE(receptions.last_came());
  EXPECT_EQ(receptions.missing().indices(), std::vector<int64_t>({1}));  // 3: nobody knows whether it was sent
  EXPECT_EQ(receptions.incomplete_reason("the publisher left"), "the publisher left, last message seen: 2");
}

TEST(Receptions, NothingCame) {
  communication::Samples samples(4);
  const Receptions receptions(samples);
  EXPECT_EQ(receptions.missing().count(), 0);
  EXPECT_EQ(receptions.incomplete_reason("ended by SIGINT"), "ended by SIGINT, no message came");
}

TEST(Receptions, PublisherWithFewerRepetitions) {
  communication::Samples samples(10);
  Receptions receptions(samples);
  for (uint32_t seq : {0u, 1u, 2u}) receptions.receive(0, 1, seq, seq == 2);
  EXPECT_EQ(receptions.missing().count(), 0);
  EXPECT_EQ(receptions.incomplete_reason(""), "the publisher sent 3 messages: it needs the same -r");
}

TEST(Pace, NeverAheadOfTheGrid) {
  const int64_t before = rt_tests::now_ns(CLOCK_MONOTONIC);
  communication::Pace pace(7000);
  for (int i = 0; i < 70; ++i) EXPECT_TRUE(pace.wait());
  EXPECT_GE(rt_tests::now_ns(CLOCK_MONOTONIC) - before, 10000000);
}

// The second message is due a period after the first one, which was late.
TEST(Pace, ALateMessageIsNotFollowedByABurst) {
  communication::Pace pace(100);
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const int64_t before = rt_tests::now_ns(CLOCK_MONOTONIC);
  EXPECT_TRUE(pace.wait());
  EXPECT_GE(pace.overruns(), 1);
  EXPECT_GE(pace.skipped(), 4);  // due after 10 ms, sent after 50 ms or more: those due at 20, 30, 40 and 50 ms
  EXPECT_TRUE(pace.wait());
  EXPECT_GE(rt_tests::now_ns(CLOCK_MONOTONIC) - before, 10000000);
}
