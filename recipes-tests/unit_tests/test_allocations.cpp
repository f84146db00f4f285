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
#include "rt_tests_support/measure/topology.h"
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
  EXPECT_GE(not_fired.count(), 1500);  // more than are listed; on a busy machine others come too late
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

namespace {

// A middleware whose topics keep one message each.
struct Boxes {
  static constexpr bool counts_processes = false;
  struct Context {
    bool ok() const noexcept { return true; }
    std::vector<unsigned char> message;
    std::size_t sent = 0;
  };
  struct Sender {
    Sender(Context& context, const topology::Topic& topic) : context_(context) {
      context.message.assign(topic.message_bytes(), 0);
    }
    unsigned char* bytes() { return context_.message.data(); }
    bool send() noexcept { return ++context_.sent > 0; }
    std::string problem() { return ""; }
    int64_t subscribers() { return 2; }
    Context& context_;
  };
  template <class CallBack>
  struct Receiver {
    Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back)
        : context_(context), seen_(inputs.size()), call_back_(call_back) {}
    void receive(int64_t limit_ns) {
      topology::sleep_until(rt_tests::now_ns(CLOCK_MONOTONIC) + limit_ns, 100000);
      for (std::size_t input = 0; input < seen_.size(); ++input) {
        if (seen_[input] == context_.sent) continue;
        seen_[input] = context_.sent;
        call_back_(input, context_.message.data(), context_.message.size());
      }
    }
    int64_t publishers(std::size_t) { return 1; }
    Context& context_;
    std::vector<std::size_t> seen_;
    CallBack& call_back_;
  };
};

}  // namespace

TEST(Allocations, NoneInTheLoopOfNodes) {
  const int64_t ms = 1000000;
  topology::Process process;
  process.name = "all";
  process.measure_ns = 200 * ms;
  process.topics = {{"/t", 100, true, 10}};
  process.executors = {{"all", "0", 0, ""}};
  process.nodes = {{"sends", 0, topology::Waits::period, 2 * ms, 0, 10000, 4096, 100, {}, {{0, 2, 1}}},
                   {"each", 0, topology::Waits::any, 0, 0, 0, 0, 100, {{0, 100}}, {}},
                   {"newest", 0, topology::Waits::period, 10 * ms, ms, 0, 0, 20, {{0, 100}}, {}}};
  const rt_tests::Program program = {"", "", "", {"clock"}};
  const rt_tests::Options options(program);
  const rt_tests::Destination nowhere{"", ""};
  topology::Run run(process, program, options, nowhere);
  Boxes::Context context;
  topology::ExecutorThread<Boxes> thread(context, run, 0);
  thread.start();
  while (!thread.missing().empty()) topology::sleep_until(rt_tests::now_ns(CLOCK_MONOTONIC) + ms, ms);
  run.start_ns = rt_tests::now_ns(CLOCK_MONOTONIC) + 10 * ms;
  EXPECT_EQ(allocations_in([&] {
              thread.begin();
              thread.wait();
            }),
            0);
  thread.end();
  EXPECT_EQ(thread.hosted.problem, "");
  const auto rows = [&](int node) { return static_cast<int64_t>(run.nodes[node]->activations.rows()); };
  EXPECT_EQ(rows(0) + run.nodes[0]->skipped, 100);
  EXPECT_GT(rows(0), 1);
  EXPECT_EQ(rows(1), rows(0));
  EXPECT_EQ(rows(2) + run.nodes[2]->skipped, 20);
  // What it took last, it took first of a message that had come.
  int64_t* const last = run.nodes[2]->activations.row(static_cast<std::size_t>(rows(2)) - 1);
  const int64_t taken = last[topology::HostedNode::first_input];
  EXPECT_GE(run.nodes[2]->receptions[0].row(static_cast<std::size_t>(taken))[topology::HostedNode::taken], 0);
}

TEST(Allocations, NoneInTheWriterOfBlocks) {
  char folder[] = "/tmp/rt_tests_XXXXXX";
  const std::string output = mkdtemp(folder) + std::string("/a");
  const std::string part = output + ".npy.part";
  cyclic::Samples samples(200);
  const auto value_of = [](const cyclic::Samples& rows, std::size_t row) { return cyclic::lateness_of(rows, row, 100); };
  rt_tests::Blocks blocks(output, samples, INT64_C(1000000000), rt_tests::current_cpus(), value_of, 1);
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
  EXPECT_EQ(stat((output + ".live").c_str(), &state), 0);
  EXPECT_GT(state.st_size, 0);
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
