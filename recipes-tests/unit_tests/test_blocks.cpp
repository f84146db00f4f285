// Rows on disk while they are still being taken.
#include <dirent.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstring>
#include <fstream>
#include <iterator>
#include <optional>
#include <thread>
#include <vector>

#include "rt_tests_support/blocks.h"
#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/files.h"
#include "rt_tests_support/process.h"

using namespace rt_tests;

namespace {

constexpr int period_ms = 10;
constexpr int64_t long_ns = 1000000000;

struct BlocksTest : testing::Test {
  std::string folder, output, part, live;
  BlocksTest() {
    char name[] = "/tmp/rt_tests_XXXXXX";
    folder = mkdtemp(name);
    output = folder + "/a";
    part = output + ".npy.part";
    live = output + ".live";
  }
  ~BlocksTest() override {
    unlink(part.c_str());
    EXPECT_EQ(rmdir(folder.c_str()), 0) << "figures stay when no more are written";
  }
  bool is_there() const { return access(part.c_str(), F_OK) == 0; }
};

std::string content(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// The limit on a file's size fails like a full disk does: in the middle.
struct FullDisk {
  const rlim_t bytes;
  rlimit before{};
  explicit FullDisk(rlim_t room) : bytes(room) {
    signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &before);
    const rlimit limit{bytes, before.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FullDisk() { make_room(); }
  void make_room() const { setrlimit(RLIMIT_FSIZE, &before); }
};

template <class Condition>
bool comes_true(Condition condition) {
  for (int i = 0; i < 3000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

const auto first_column = [](const auto& samples, std::size_t row) -> std::optional<int64_t> {
  return samples[row][0];
};

template <std::size_t Columns>
std::string part_of(const Samples<Columns>& samples, std::size_t rows) {
  return npy_header(samples.capacity(), Columns) +
         std::string(reinterpret_cast<const char*>(samples.data()), rows * Columns * sizeof(int64_t));
}

std::string error_of(const std::function<void()>& body) {
  testing::internal::CaptureStderr();
  body();
  return testing::internal::GetCapturedStderr();
}

}  // namespace

TEST_F(BlocksTest, RowsReachTheDiskWhileMoreAreTaken) {
  Samples<2> samples(100);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, period_ms);
  for (const int64_t rows : {3, 40, 100}) {
    for (auto i = static_cast<int64_t>(samples.size()); i < rows; ++i) samples.append({i, -i});
    const std::string expected = part_of(samples, static_cast<std::size_t>(rows));
    EXPECT_TRUE(comes_true([&] { return content(part) == expected; })) << rows;
  }
  EXPECT_EQ(error_of([&] { blocks.discard(); }), "");
  EXPECT_FALSE(is_there());
}

TEST_F(BlocksTest, FiguresOfAllRowsSoFarAreInOneLine) {
  Samples<1> samples(10);
  const auto but_zero = [](const auto& rows, std::size_t row) {
    return rows[row][0] == 0 ? std::nullopt : std::optional<int64_t>(rows[row][0]);
  };
  Blocks blocks(output, samples, long_ns, current_cpus(), but_zero, period_ms);
  const auto figures_are = [&](std::vector<int64_t> expected) {
    return comes_true([&] {
      std::ifstream stream(live);
      return std::vector<int64_t>{std::istream_iterator<int64_t>(stream), {}} == expected;
    });
  };
  samples.append({0});
  for (const int64_t value : {INT64_C(-5000000000), INT64_C(7000000000), INT64_C(4)}) samples.append({value});
  EXPECT_TRUE(figures_are({3, INT64_C(-5000000000), 666666668, INT64_C(7000000000)}));
  samples.append({8});
  EXPECT_TRUE(figures_are({4, INT64_C(-5000000000), 500000003, INT64_C(7000000000)}));
  EXPECT_EQ(content(live).find('\n'), content(live).size() - 1);
  blocks.discard();
  EXPECT_NE(access(live.c_str(), F_OK), 0);
}

TEST_F(BlocksTest, WhoMeasuresNeverWaitsForTheDisk) {
  const auto waits = [] {
    rusage usage{};
    getrusage(RUSAGE_THREAD, &usage);
    return usage.ru_nvcsw;
  };
  Samples<4> samples(3000);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, 1);
  const auto before = waits();
  for (int64_t i = 0; i < 3000; ++i) {
    for (const int64_t until_ns = now_ns(CLOCK_MONOTONIC) + 100000; now_ns(CLOCK_MONOTONIC) < until_ns;) {
    }
    samples.append({i, i, i, i});
  }
  EXPECT_EQ(waits(), before);
  EXPECT_TRUE(comes_true([&] { return content(part) == part_of(samples, 3000); }));
}

TEST_F(BlocksTest, WithoutResultsThePartKeepsEveryRow) {
  Samples<1> samples(10);
  {
    Blocks blocks(output, samples, 1000000 * long_ns, current_cpus(), first_column, 1000000);
    for (int64_t i = 0; i < 7; ++i) samples.append({i});
  }
  EXPECT_EQ(content(part), part_of(samples, 7));
}

TEST_F(BlocksTest, NoneForAShortRunAndNoneOfNothing) {
  Samples<1> samples(10);
  samples.append({1});
  {
    Blocks blocks(output, samples, period_ms * 1000000, current_cpus(), first_column, period_ms);
    EXPECT_EQ(read_threads().size(), 1u);
    EXPECT_FALSE(is_there());
    EXPECT_NE(access(live.c_str(), F_OK), 0);
  }
  EXPECT_FALSE(is_there());
  Samples<1> empty(10);
  { Blocks blocks(output, empty, long_ns, current_cpus(), first_column, period_ms); }
  EXPECT_FALSE(is_there());
}

TEST_F(BlocksTest, FullDiskIsToldAndDisturbsNobody) {
  FullDisk disk(npy_header(100, 1).size() + 12);  // room for one row and a half
  Samples<1> samples(100);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, period_ms);
  for (int64_t i = 1; i <= 50; ++i) ASSERT_TRUE(samples.append({i}));
  EXPECT_TRUE(comes_true([&] { return content(part).size() == disk.bytes; }));
  EXPECT_EQ(error_of([&] { blocks.discard(); }), "\tWARNING: cannot write " + part +
                                                     ": File too large; a power cut would have lost all but the first 0 rows\n");
  EXPECT_FALSE(is_there());
}

TEST_F(BlocksTest, ABlockThatFailedIsWrittenWithTheNext) {
  FullDisk disk(npy_header(100, 1).size() + 12);
  Samples<1> samples(100);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, period_ms);
  for (int64_t i = 1; i <= 50; ++i) samples.append({i});
  EXPECT_TRUE(comes_true([&] { return content(part).size() == disk.bytes; }));
  disk.make_room();
  EXPECT_TRUE(comes_true([&] { return content(part) == part_of(samples, 50); }));
  EXPECT_EQ(error_of([&] { blocks.discard(); }), "");
}

TEST_F(BlocksTest, WhatCannotBeOpenedIsTold) {
  ASSERT_EQ(mkdir(part.c_str(), 0755), 0);
  Samples<1> samples(10);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, period_ms);
  samples.append({5});
  EXPECT_NE(error_of([&] { blocks.discard(); }).find("Is a directory"), std::string::npos);
  rmdir(part.c_str());
}

TEST_F(BlocksTest, TheWriterIsOfNormalPriorityWhateverTheRest) {
  sched_param parameters{};
  parameters.sched_priority = 10;
  if (sched_setscheduler(0, SCHED_FIFO, &parameters) != 0) {
    ASSERT_EQ(errno, EPERM);
    GTEST_SKIP() << "needs the right to real-time priorities";
  }
  Samples<1> samples(10);
  Blocks blocks(output, samples, long_ns, current_cpus(), first_column, period_ms);
  const auto is_running = [] {
    const auto threads = read_threads();
    return threads.size() == 2 && threads[1].name == "rt_blocks" && getpriority(PRIO_PROCESS, threads[1].tid) == 19;
  };
  EXPECT_TRUE(comes_true(is_running));
  const auto threads = read_threads();
  EXPECT_EQ(threads[0].policy, "FIFO");
  EXPECT_EQ(threads[1].policy, "OTHER");
  EXPECT_EQ(threads[1].priority, 0);
  give_up_realtime();
}

TEST_F(BlocksTest, TheWriterRunsOnTheCpusThatAreLeft) {
  const auto cpus = read_threads()[0].cpus;
  if (cpus.size() < 2) GTEST_SKIP() << "one CPU leaves nothing";
  static const Program program = {"", "", "", {"cpu", "policy", "rt_scope"}};
  Options options(program);
  options.assign("--cpu", std::to_string(cpus[0]));
  const ProcessSetUp set_up(options);
  const CpuSet& spare = set_up.spare_cpus();
  EXPECT_EQ(spare.cpus(), std::vector<int>(cpus.begin() + 1, cpus.end()));
  Samples<1> samples(10);
  Blocks blocks(output, samples, long_ns, spare, first_column, period_ms);
  EXPECT_EQ(read_threads()[1].cpus, std::vector<int>(cpus.begin() + 1, cpus.end()));
}
