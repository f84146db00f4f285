// Traces of values above a limit, from files that stand for the kernel's: what the kernel does with them is tested end
// to end, with tracefs.
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <thread>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/trace.h"

using namespace rt_tests;

namespace {

const Program program = {"s", "program", "", {"clock", "break_trace_us", "trace_threshold_us"}};

struct TraceTest : testing::Test {
  std::string folder;
  Options options{program};
  TraceTest() {
    char name[] = "/tmp/rt_tests_XXXXXX";
    folder = mkdtemp(name);
    for (const char* file : {"trace_marker", "trace", "snapshot", "tracing_on"}) put(file, file);
    put("tracing_on", "1\n");
  }
  ~TraceTest() override { [[maybe_unused]] const int done = std::system(("rm -r " + folder).c_str()); }
  void put(const std::string& name, const std::string& text) const { std::ofstream(folder + "/" + name) << text; }
  std::string content(const std::string& name) const {
    std::ifstream stream(folder + "/" + name, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  bool is_there(const std::string& name) const { return access((folder + "/" + name).c_str(), F_OK) == 0; }
  bool comes(const std::string& name) const {
    for (int i = 0; i < 3000 && !is_there(name); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return is_there(name);
  }
  std::string output() const { return folder + "/out"; }
};

std::string head(int value_ns, int index, int above_ns, const std::string& at) {
  return "# program: " + std::to_string(value_ns) + " ns at index " + std::to_string(index) + " above " +
         std::to_string(above_ns) + " ns, at " + at + " s of CLOCK_MONOTONIC_RAW\n";
}

}  // namespace

TEST_F(TraceTest, BreakMarksTheFirstValueAboveTheLimitAndKeepsTheTrace) {
  options.assign("--break-trace", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder + "/no", folder});
  EXPECT_FALSE(trace.exceeded(5000, 1, 0));
  EXPECT_EQ(trace.reason(), "");
  EXPECT_TRUE(trace.exceeded(5001, 2, 12000345678));
  EXPECT_TRUE(trace.exceeded(9000, 3, 0));
  EXPECT_TRUE(trace.exceeded(9000, 4, 0));
  EXPECT_EQ(content("tracing_on")[0], '0');  // no later event overwrites the marker before it is copied
  EXPECT_EQ(content("trace_marker").substr(0, 42), "program: 5001 ns at index 2 above 5000 ns\n");
  EXPECT_EQ(trace.reason(), "ended by --break-trace: 5001 ns at index 2");
  trace.finish();
  EXPECT_EQ(trace.above(), 1);
  EXPECT_EQ(trace.files(), std::vector<std::string>{"out-trace-2.txt"});
  // The trace itself, as whoever set it up finds it afterwards.
  EXPECT_EQ(content("out-trace-2.txt"), head(5001, 2, 5000, "12.000345") + "trace");
  EXPECT_EQ(content("snapshot"), "snapshot");
  EXPECT_EQ(content("tracing_on")[0], '1');
}

TEST_F(TraceTest, ThresholdTakesASnapshotAndGoesOn) {
  options.assign("--trace-threshold", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  EXPECT_FALSE(trace.exceeded(5000, 1, 0));
  EXPECT_FALSE(trace.exceeded(7000, 2, 1000000));
  ASSERT_TRUE(comes("out-trace-2.txt"));
  EXPECT_FALSE(trace.exceeded(8000, 3, now_ns(CLOCK_MONOTONIC_RAW)));
  ASSERT_TRUE(comes("out-trace-3.txt"));
  trace.finish();
  EXPECT_EQ(trace.reason(), "");
  EXPECT_EQ(trace.above(), 2);
  EXPECT_EQ(trace.files(), (std::vector<std::string>{"out-trace-2.txt", "out-trace-3.txt"}));
  EXPECT_EQ(content("out-trace-2.txt"), head(7000, 2, 5000, "0.001000") + "1napshot");  // asked for: a snapshot
  EXPECT_EQ(content("snapshot"), "2napshot");  // cleared, after it was copied
  EXPECT_EQ(content("out-trace-3.txt").substr(0, 45), "# program: 8000 ns at index 3 above 5000 ns, ");
  EXPECT_EQ(content("trace_marker"), "trace_marker");
}

TEST_F(TraceTest, ValuesOfBeforeACopyShareIt) {
  options.assign("--trace-threshold", "5");
  OutlierTrace first(options, "program", output(), current_cpus(), {folder});
  OutlierTrace second(options, "program", folder + "/other", current_cpus(), {folder});
  first.exceeded(7000, 2, 5000000);
  first.exceeded(7000, 3, 6000000);
  ASSERT_TRUE(comes("out-trace-2.txt"));
  second.exceeded(6000, 2, 7000000);
  first.finish();
  second.finish();
  EXPECT_EQ(content("out-trace-2.txt"), head(7000, 2, 5000, "0.005000") + "1napshot");
  EXPECT_EQ(content("out-trace-3.txt"), head(7000, 3, 5000, "0.006000") + "# in out-trace-2.txt\n");
  EXPECT_EQ(content("other-trace-2.txt"), head(6000, 2, 5000, "0.007000") + "# in out-trace-2.txt\n");
}

// What one program leaves stays for those that still run: whoever comes later shares their copies.
TEST_F(TraceTest, TheLastProgramRemovesWhatTheyShare) {
  options.assign("--trace-threshold", "5");
  std::optional<OutlierTrace> first, second, third;
  first.emplace(options, "program", folder + "/first", current_cpus(), std::vector{folder});
  second.emplace(options, "program", output(), current_cpus(), std::vector{folder});
  first.reset();
  third.emplace(options, "program", folder + "/third", current_cpus(), std::vector{folder});
  second->exceeded(7000, 2, 5000000);
  ASSERT_TRUE(comes("out-trace-2.txt"));
  second->finish();
  third->exceeded(6000, 2, 7000000);
  third->finish();
  EXPECT_EQ(content("third-trace-2.txt"), head(6000, 2, 5000, "0.007000") + "# in out-trace-2.txt\n");
  second.reset();
  EXPECT_TRUE(is_there(".rt_tests-trace"));
  third.reset();
  EXPECT_FALSE(is_there(".rt_tests-trace"));
}

TEST_F(TraceTest, ACopyOfAnotherBootIsNotShared) {
  options.assign("--break-trace", "5");
  struct {
    int64_t at_ns;
    char file[256];
  } copy{now_ns(CLOCK_MONOTONIC_RAW) * 2, "old.txt"};
  put(".rt_tests-trace", std::string(reinterpret_cast<const char*>(&copy), sizeof copy));
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  trace.exceeded(7000, 2, 5000000);
  trace.finish();
  EXPECT_EQ(content("out-trace-2.txt"), head(7000, 2, 5000, "0.005000") + "trace");
}

TEST_F(TraceTest, WithoutSnapshotsTheTraceIsHeldAndCopied) {
  unlink((folder + "/snapshot").c_str());
  options.assign("--trace-threshold", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  trace.exceeded(7000, 2, 1000000);
  ASSERT_TRUE(comes("out-trace-2.txt"));
  trace.finish();
  EXPECT_EQ(content("out-trace-2.txt"), head(7000, 2, 5000, "0.001000") + "trace");
  EXPECT_EQ(content("tracing_on"), "1\n");
}

TEST_F(TraceTest, ATraceThatWasOffStaysOff) {
  put("tracing_on", "0\n");
  options.assign("--break-trace", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  trace.exceeded(7000, 2, 1000000);
  trace.finish();
  EXPECT_EQ(content("tracing_on"), "0\n");
}

TEST_F(TraceTest, OnlyTheFirstAreTracedAllAreCounted) {
  options.assign("--trace-threshold", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  for (int i = 0; i < 100; ++i) EXPECT_FALSE(trace.exceeded(6000, i, i));
  trace.finish();
  EXPECT_EQ(trace.above(), 100);
  EXPECT_EQ(trace.files().size(), OutlierTrace::traced_at_most);
  EXPECT_EQ(trace.files().back(), "out-trace-15.txt");
}

TEST_F(TraceTest, WhatCannotBeCopiedIsTold) {
  options.assign("--break-trace", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  unlink((folder + "/trace").c_str());
  EXPECT_TRUE(trace.exceeded(6000, 1, 1));
  testing::internal::CaptureStderr();
  trace.finish();
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "\tWARNING: 1 of 1 traces " + output() +
                                                        "-trace-*.txt could not be copied: No such file or directory\n");
  EXPECT_TRUE(trace.files().empty());
  EXPECT_NE(trace.reason(), "");
}

TEST_F(TraceTest, HalfACopyIsRemoved) {
  options.assign("--break-trace", "5");
  OutlierTrace trace(options, "program", output(), current_cpus(), {folder});
  unlink((folder + "/trace").c_str());
  ASSERT_EQ(mkdir((folder + "/trace").c_str(), 0700), 0);  // it can be opened, but not read
  EXPECT_TRUE(trace.exceeded(6000, 1, 1));
  testing::internal::CaptureStderr();
  trace.finish();
  EXPECT_NE(testing::internal::GetCapturedStderr().find("could not be copied: Is a directory"), std::string::npos);
  EXPECT_TRUE(trace.files().empty());
  EXPECT_FALSE(is_there("out-trace-1.txt"));
}

TEST_F(TraceTest, NeedsTracefsOnlyWhenAskedFor) {
  OutlierTrace trace(options, "program", output(), current_cpus(), {});
  EXPECT_FALSE(trace.exceeded(INT64_C(9000000000000000000), 0, 0));
  trace.finish();
  EXPECT_EQ(trace.above(), 0);
  options.assign("--trace-threshold", "5");
  EXPECT_THROW(OutlierTrace(options, "program", output(), current_cpus(), {folder + "/no"}), Failure);
}
