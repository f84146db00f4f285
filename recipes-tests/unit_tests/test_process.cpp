#include <dlfcn.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <thread>
#include <vector>

#include "rt_tests_support/background.h"
#include "rt_tests_support/process.h"

using namespace rt_tests;

// A kernel for 4096 CPUs, where it is asked for: as Linux, it refuses to tell them to a smaller set (sched_setaffinity(2)), and
// what it was told to have a thread run on is what it tells afterwards.
namespace {
constexpr int many = 4096;
constexpr std::size_t many_bytes = many / 8;
bool has_many = false;
cpu_set_t assigned[many / CPU_SETSIZE];
}  // namespace

extern "C" int sched_getaffinity(pid_t tid, std::size_t bytes, cpu_set_t* set) noexcept {
  if (!has_many) {
    const long got = syscall(SYS_sched_getaffinity, tid, bytes, set);
    if (got < 0) return -1;
    std::memset(reinterpret_cast<char*>(set) + got, 0, bytes - static_cast<std::size_t>(got));
    return 0;
  }
  if (bytes < many_bytes) {
    errno = EINVAL;
    return -1;
  }
  std::memset(set, 0, bytes);
  std::memcpy(set, assigned, many_bytes);
  return 0;
}

extern "C" int sched_setaffinity(pid_t tid, std::size_t bytes, const cpu_set_t* set) noexcept {
  if (!has_many) return static_cast<int>(syscall(SYS_sched_setaffinity, tid, bytes, set));
  std::memset(assigned, 0, sizeof assigned);
  std::memcpy(assigned, set, std::min(bytes, many_bytes));
  return 0;
}

extern "C" long sysconf(int name) noexcept {
  if (has_many && name == _SC_NPROCESSORS_CONF) return many;
  static const auto real = reinterpret_cast<long (*)(int)>(dlsym(RTLD_NEXT, "sysconf"));
  return real(name);
}

namespace {

struct ManyCpus : testing::Test {
  ManyCpus() {
    std::memset(assigned, 0xff, sizeof assigned);
    has_many = true;
  }
  ~ManyCpus() override { has_many = false; }
  static Options on(const std::string& cpus) {
    static const Program program = {"", "", "", {"cpu", "policy", "rt_scope"}};
    Options options(program);
    options.assign("--cpu", cpus);
    return options;
  }
};

}  // namespace

TEST_F(ManyCpus, AreAllOfThemTold) {
  const auto threads = read_threads();
  ASSERT_EQ(threads.size(), 1u);
  EXPECT_EQ(threads[0].cpus.size(), static_cast<std::size_t>(many));
  EXPECT_TRUE(current_cpus().has(4095));
}

TEST_F(ManyCpus, AProcessRunsOnAnyOfThem) {
  const auto options = on("1023-1024,4095");
  const ProcessSetUp set_up(options);
  EXPECT_EQ(read_threads()[0].cpus, (std::vector<int>{1023, 1024, 4095}));
  EXPECT_EQ(set_up.spare_cpus().cpus().size(), many - 3u);
  EXPECT_FALSE(set_up.spare_cpus().has(4095));
  EXPECT_TRUE(set_up.spare_cpus().has(4094));
}

TEST_F(ManyCpus, ASetOfThemIsTakenByTheThreadsOfALibrary) {
  const CpuSet all = current_cpus();
  has_many = false;
  std::atomic<bool> called{false};
  {
    const Background background("many", 1, all, [&] { called = true; });
    while (!called) std::this_thread::yield();
  }
}

TEST(CpuSet, ItsCpusAreThoseItWasGiven) {
  const std::vector<int> cpus = {0, 1023, 1024, 2047, 2048, 8191};
  EXPECT_EQ(CpuSet(cpus).cpus(), cpus);
  EXPECT_EQ(CpuSet(cpus).without(CpuSet({0, 1024})).cpus(), (std::vector<int>{1023, 2047, 2048, 8191}));
  EXPECT_EQ(CpuSet({0, 5}).without(CpuSet(cpus)).cpus(), std::vector<int>{5});
  EXPECT_TRUE(CpuSet().empty() && CpuSet(std::vector<int>{}).empty());
  EXPECT_FALSE(CpuSet::of_thread(1 << 22).has_value());  // no such thread: pid_max
}

// Each growth of the heap costs a system call and, where memory is locked, the time to fill the new pages with zeros.
TEST(Process, AReservedHeapNeitherGrowsNorFaultsOnAnyThread) {
  set_up_heaps(Heaps::shared);
  reserve_heap();
  constexpr std::size_t size = 4000;
  constexpr std::size_t blocks = heap_reserve_bytes * 9 / 10 / size;
  const void* const end = sbrk(0);
  long faults = -1;
  bool in_heap = true;
  std::thread([&] {
    std::vector<char*> all(blocks);
    rusage before{}, after{};
    getrusage(RUSAGE_THREAD, &before);
    for (auto& block : all) {
      block = static_cast<char*>(malloc(size));
      block[0] = block[size - 1] = 1;
      in_heap = in_heap && block < end;
    }
    getrusage(RUSAGE_THREAD, &after);
    faults = after.ru_minflt - before.ru_minflt;
    for (char* block : all) free(block);
  }).join();
  EXPECT_TRUE(in_heap);  // of the one heap that all threads share
  EXPECT_LE(faults, 2);  // the thread's stack, the code of malloc
  EXPECT_EQ(sbrk(0), end);
}

TEST(Process, TheHeapIsOneWhereAllThreadsAreScheduledAlike) {
  static const Program program = {"", "", "", {"rt_scope"}};
  Options options(program);
  EXPECT_EQ(heaps_of(options), Heaps::shared);
  options.assign("--rt-scope", "measuring-thread");
  EXPECT_EQ(heaps_of(options), Heaps::per_thread);
}
