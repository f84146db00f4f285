// Nothing is allocated while measuring. What this proves: with malloc and its relatives counted on every thread, the
// measuring loop of the one-shot timer (measuring thread and callback thread, shots that fire and shots that do not),
// the cyclic timer's bookkeeping and the subscriber's bookkeeping allocate nothing, whatever happens in them. What it
// does not: roscpp around them is not in here, and allocates (its timer thread makes a callback object for each shot).
#include <gtest/gtest.h>
#include <malloc.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <cstdlib>
#include <thread>

#include "rt_tests_support/measure/jitter.h"
#include "rt_tests_support/measure/receptions.h"
#include "rt_tests_support/blocks.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/measure/shots.h"

extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
}

namespace {
std::atomic<bool> counting{false};
std::atomic<int> allocations{0};

void count() {
  if (counting.load(std::memory_order_relaxed)) allocations.fetch_add(1);
}
}  // namespace

// operator new ends here, too.
extern "C" void* malloc(size_t size) noexcept { count(); return __libc_malloc(size); }
extern "C" void* calloc(size_t n, size_t size) noexcept { count(); return __libc_calloc(n, size); }
extern "C" void* realloc(void* old, size_t size) noexcept { count(); return __libc_realloc(old, size); }
extern "C" void* aligned_alloc(size_t align, size_t size) noexcept { count(); return __libc_memalign(align, size); }

namespace {

template <class Body>
int allocations_in(Body body) {
  allocations = 0;
  counting = true;
  body();
  counting = false;
  return allocations;
}

rt_tests::Options no_options() {
  static const rt_tests::Program program = {"", "", "", {"clock", "break_trace_us", "trace_threshold_us"}};
  return rt_tests::Options(program);
}

}  // namespace

TEST(Allocations, AreSeen) {
  EXPECT_EQ(allocations_in([] { free(malloc(1000)); }), 1);
  std::vector<int> growing;
  EXPECT_GT(allocations_in([&] { for (int i = 0; i < 1000; ++i) growing.push_back(i); }), 1);
}

TEST(Allocations, NoneInTheOneshotLoop) {
  constexpr clockid_t clock_used = CLOCK_MONOTONIC_RAW;
  rt_tests::OutlierTrace trace(no_options(), "", "", rt_tests::current_cpus(), {});
  oneshot::ShotBox box(clock_used, 1000000);
  oneshot::Samples samples(3000);
  rt_tests::Events not_fired;
  std::atomic<int> pending{0};
  std::atomic<bool> ended{false};
  std::thread spinner([&] {
    while (!ended) {
      if (pending.exchange(0) > 0) box.fire(rt_tests::now_ns(clock_used), 1);
      if (box.settle()) box.wake();
      std::this_thread::yield();
    }
  });
  const int count = allocations_in([&] {
    oneshot::measure(
        clock_used, 1000, box, samples, not_fired, trace, [&] { pending = samples.size() % 2; }, [] {},
        [&] { return box.wait(); });
  });
  ended = true;
  spinner.join();
  EXPECT_EQ(samples.size(), 3000u);
  EXPECT_EQ(not_fired.count(), 1500);  // more than are listed
  EXPECT_EQ(count, 0);
}

TEST(Allocations, NoneInTheCyclicBookkeeping) {
  cyclic::Samples samples(10000);
  EXPECT_EQ(allocations_in([&] { for (int64_t i = 0; i < 20000; ++i) samples.append({i, i, i}); }), 0);
  EXPECT_TRUE(samples.full());
}

TEST(Allocations, NoneInTheSubscribersBookkeeping) {
  communication::Samples samples(10000);
  communication::Receptions receptions(samples);
  EXPECT_EQ(allocations_in([&] {
              for (uint32_t i = 0; i < 30000; ++i) receptions.receive(0, 1, (i * 7919u) % 12000u, false);
            }),
            0);
  EXPECT_EQ(samples.size(), 10000u);
  EXPECT_GT(receptions.duplicate.count(), 1000);
  EXPECT_GT(receptions.out_of_order.count(), 1000);
}

TEST(Allocations, NoneInTheWriterOfBlocks) {
  char folder[] = "/tmp/rt_tests_XXXXXX";
  const std::string npy = mkdtemp(folder) + std::string("/a.npy");
  const std::string part = npy + ".part";
  cyclic::Samples samples(200);
  rt_tests::Blocks blocks(npy, samples, INT64_C(1000000000), rt_tests::current_cpus(), 1);
  struct stat state {};
  EXPECT_EQ(allocations_in([&] {
              for (int64_t i = 0; i < 200; ++i) {
                samples.append({i, i, i});
                timespec pause{0, 1000000};
                nanosleep(&pause, nullptr);
              }
              for (int i = 0; i < 3000 && (stat(part.c_str(), &state) != 0 || state.st_size < 200 * 24); ++i) {
                timespec pause{0, 10000000};
                nanosleep(&pause, nullptr);
              }
            }),
            0);
  EXPECT_GT(state.st_size, 200 * 24);  // it did write meanwhile
  blocks.discard();
  rmdir(folder);
}

TEST(Allocations, NoneInTheTraces) {
  const rt_tests::Program program = {"", "", "", {"clock", "break_trace_us", "trace_threshold_us"}};
  rt_tests::Options options(program);
  options.assign("--break-trace", "5");
  options.assign("--trace-threshold", "1");
  char folder[] = "/tmp/rt_tests_XXXXXX";
  const std::string path = mkdtemp(folder);
  for (const char* file : {"trace_marker", "trace", "tracing_on"}) fclose(fopen((path + "/" + file).c_str(), "w"));
  rt_tests::OutlierTrace trace(options, "program", path + "/a", rt_tests::current_cpus(), {path});
  struct stat state {};
  EXPECT_EQ(allocations_in([&] {
              trace.exceeded(2000, 1, 2000);
              char copied[100];
              std::snprintf(copied, sizeof copied, "%s/a-trace-1.txt", path.c_str());
              for (int i = 0; i < 3000 && stat(copied, &state) != 0; ++i) {
                timespec pause{0, 10000000};
                nanosleep(&pause, nullptr);
              }
              trace.exceeded(6000, 2, 3000);
            }),
            0);
  EXPECT_EQ(stat((path + "/a-trace-1.txt").c_str(), &state), 0);
  trace.finish();
  EXPECT_EQ(trace.files(), (std::vector<std::string>{"a-trace-1.txt", "a-trace-2.txt"}));
  [[maybe_unused]] const int done = std::system(("rm -r " + path).c_str());
}
