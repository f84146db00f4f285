// The measurements over a middleware of this file's own: whatever fills the concept of middleware.h is measured alike.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "rt_tests_support/measure/activations.h"
#include "rt_tests_support/measure/cyclic.h"
#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/measure/publisher.h"
#include "rt_tests_support/measure/subscriber.h"

namespace {

// Timers by sleeping. What is published is received by the subscriber of the same process.
struct Fake {
  static constexpr char name[] = "fake";
  static constexpr int64_t payload_bytes_max = 1000;
  static inline int shutdowns = 0;
  static inline int64_t connected = 0;   // subscribers: one more each time that they are counted
  static inline int64_t sent_at_most = 0;
  static inline bool throws = false;     // when it cannot send
  static inline std::vector<rt_tests::Stamp> sent;

  struct Context : rt_tests::NoContext {
    using rt_tests::NoContext::NoContext;
    void shutdown() { ++shutdowns; }
    rt_tests::Facts facts() const { return {{"version", "1.2.3"}}; }
  };

  template <class CallBack>
  struct Timer {
    static constexpr char never_fired[] = ": is it a fake?";
    Timer(Context&, rt_tests::Repeats repeats, int64_t period_ns, CallBack& call_back)
        : repeats(repeats == rt_tests::Repeats::yes), period_ns(period_ns), call_back(call_back) {}
    void start(int64_t first_ns) { due_ns = rt_tests::now_ns(CLOCK_MONOTONIC) + first_ns; }
    void arm() { start(period_ns); }
    void cancel() { due_ns = 0; }
    void spin(int64_t limit_ns) {
      const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
      if (due_ns == 0 || due_ns > now_ns + limit_ns) return communication::pause(limit_ns);
      communication::pause(std::max<int64_t>(due_ns - now_ns, 0));
      const int64_t expected_ns = due_ns;
      due_ns = repeats ? due_ns + period_ns : 0;
      call_back(expected_ns, rt_tests::now_ns(CLOCK_MONOTONIC));
    }
    const bool repeats;
    const int64_t period_ns;
    CallBack& call_back;
    int64_t due_ns = 0;
  };
  template <class Timer>
  using Waiter = oneshot::SpinningWaiter<Context, Timer>;

  struct Publisher {
    Publisher(Context&, const rt_tests::Options&) {}
    bool publish(const rt_tests::Stamp& stamp) noexcept {
      if (static_cast<int64_t>(sent.size()) == sent_at_most && !throws) return false;
      return sending.succeeds([&] {
        if (static_cast<int64_t>(sent.size()) == sent_at_most) throw std::runtime_error("no room");
        sent.push_back(stamp);
      });
    }
    std::string problem() const { return throws ? sending.problem(name) : "it is full"; }
    int64_t subscribers() { return sent.empty() ? connected++ : 0; }
    rt_tests::Sending sending;
  };

  template <class CallBack>
  struct Subscriber {
    Subscriber(Context&, const rt_tests::Options&, CallBack& call_back) : call_back(call_back) {}
    void receive(int64_t) {
      if (next < sent.size()) call_back(sent[next++]);
    }
    int64_t publishers() const { return next < sent.size() ? 1 : 0; }
    CallBack& call_back;
    std::size_t next = 0;
  };
};

struct Folder {
  std::string path;
  Folder() {
    char name[] = "/tmp/rt_tests_XXXXXX";
    path = mkdtemp(name);
  }
  ~Folder() { [[maybe_unused]] const int done = std::system(("rm -r " + path).c_str()); }
  std::string operator/(const std::string& name) const {
    std::ifstream stream(path + "/" + name, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
};

template <class Main>
int called(Main main, std::vector<std::string> words) {
  words.insert(words.begin(), "program");
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  return main(static_cast<int>(argv.size()), argv.data());
}

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST(Middleware, ItsProgramsCarryItsName) {
  const auto program = rt_tests::described("communication_tests_publisher", "fake", "");
  EXPECT_EQ(program.executable(), "communication_tests_publisher_fake");
  EXPECT_TRUE(rt_tests::Options(program).has("awaited_subscribers"));
  EXPECT_FALSE(rt_tests::Options(program).has("depth"));
  const auto of_ros2 = rt_tests::described("communication_tests_publisher", "rcl", "");
  EXPECT_TRUE(rt_tests::Options(of_ros2).has("awaited_subscribers"));
  EXPECT_TRUE(rt_tests::Options(of_ros2).has("depth"));
  const auto of_2014 = rt_tests::described("communication_tests_publisher", "roscpp", "");
  EXPECT_EQ(of_2014.executable(), "communication_tests_publisher");
  EXPECT_EQ(rt_tests::Options(of_2014).values().back().option.key, std::string("cpu_dma_latency_us"));
  EXPECT_THROW(rt_tests::described("communication_tests_publisher_fake", "fake", ""), std::logic_error);
}

TEST(Middleware, TimersAreMeasuredAndOutputsAreThoseOfTheSuite) {
  const Folder folder;
  Fake::shutdowns = 0;
  for (const char* busy : {"0", "1"}) {
    EXPECT_EQ(called(oneshot::main<Fake>, {"-r", "20", "-t", "100", "-b", busy, "--out-dir", folder.path}), 0);
  }
  EXPECT_EQ(called(cyclic::main<Fake>, {"-r", "20", "-f", "1000", "--out-dir", folder.path}), 0);
  EXPECT_EQ(Fake::shutdowns, 3);
  for (const char* name : {"oneshot_timer_tests_l20_tm100", "oneshot_timer_tests_l20_tm100-bm",
                           "cyclic_timer_tests_l20_fq1000"}) {
    const std::string json = folder / (std::string(name) + ".json");
    EXPECT_TRUE(has(json, "\"middleware\": \"fake\"")) << json;
    EXPECT_TRUE(has(json, "\"version\": \"1.2.3\"")) << json;
    EXPECT_TRUE(has(json, "\"complete\": true") && has(json, "\"measured\": 20")) << json;
    EXPECT_FALSE(has(json, "\"costs\": null")) << json;
  }
}

TEST(Middleware, MessagesArePublishedOnceAllSubscribersAreThereAndReceived) {
  const Folder folder;
  const std::vector<std::string> options = {"-r", "10", "-f", "10000", "--out-dir", folder.path};
  Fake::sent_at_most = 10;
  Fake::connected = 0;
  auto awaiting = options;
  awaiting.insert(awaiting.end(), {"--subscribers", "3"});
  EXPECT_EQ(called(communication::publisher_main<Fake>, awaiting), 0);
  EXPECT_EQ(Fake::connected, 5);  // 0, 1, 2, 3, and once more before the first message
  EXPECT_EQ(called(communication::subscriber_main<Fake>, options), 0);
  EXPECT_TRUE(has(folder / "ct_gnuplot_l10_fq10000_pl0-publisher.json", "\"sent\": 10"));
  EXPECT_TRUE(has(folder / "ct_gnuplot_l10_fq10000_pl0.json", "\"measured\": 10"));
  Fake::sent.clear();
}

TEST(Middleware, SubscribersThatDoNotComeAreCounted) {
  rt_tests::Program program = {"", "", "", {}};
  const rt_tests::Options options(program);
  Fake::Context context(0, nullptr, program, options);
  Fake::Publisher publisher(context, options);
  Fake::connected = 2;
  try {
    communication::wait_for_subscribers(5, context, publisher, 0);
    FAIL();
  } catch (const rt_tests::Failure& failure) {
    EXPECT_STREQ(failure.what(), "2 of 5 subscribers were connected after 0 s");
  }
}

// It would spin with the CPU of those that still read. In a process of its own: a stop cannot be undone.
TEST(Middleware, APublisherThatIsStoppedDoesNotWaitForSubscribers) {
  const auto leave = [] {
    rt_tests::Program program = {"", "", "", {}};
    const rt_tests::Options options(program);
    Fake::Context context(0, nullptr, program, options);
    Fake::Publisher publisher(context, options);
    Fake::connected = 2;
    rt_tests::request_stop();
    communication::wait_for_subscribers_to_leave(context, publisher);
    std::exit(Fake::connected > 3 ? 1 : 0);
  };
  EXPECT_EXIT(leave(), testing::ExitedWithCode(0), "");
}

// The messages that went are written, and what came of them adds up.
TEST(Middleware, APublisherThatCannotGoOnSaysWhy) {
  const Folder folder;
  const std::vector<std::string> options = {"-r", "10", "-f", "10000", "--out-dir", folder.path};
  Fake::sent_at_most = 4;
  testing::internal::CaptureStderr();
  EXPECT_EQ(called(communication::publisher_main<Fake>, options), 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "\tERROR: it is full after 4 of 10 messages\n");
  EXPECT_TRUE(has(folder / "ct_gnuplot_l10_fq10000_pl0-publisher.json", "\"incomplete_reason\": \"it is full\""));
  EXPECT_EQ(called(communication::subscriber_main<Fake>, options), 0);
  const std::string json = folder / "ct_gnuplot_l10_fq10000_pl0.json";
  EXPECT_TRUE(has(json, "\"incomplete_reason\": \"the publisher left, last message seen: 3\"")) << json;
  EXPECT_TRUE(has(json, "\"measured\": 4") && has(json, "\"missing\": 0")) << json;
  Fake::sent.clear();
}

// roscpp's send may throw in the middle of a measurement: that is an end with a reason, as any other.
TEST(Middleware, APublisherThatThrowsSaysWhy) {
  const Folder folder;
  Fake::sent_at_most = 4;
  Fake::throws = true;
  testing::internal::CaptureStderr();
  EXPECT_EQ(called(communication::publisher_main<Fake>, {"-r", "10", "-f", "10000", "--out-dir", folder.path}), 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "\tERROR: fake: cannot publish: no room after 4 of 10 messages\n");
  EXPECT_TRUE(has(folder / "ct_gnuplot_l10_fq10000_pl0-publisher.json", "\"sent\": 4"));
  Fake::throws = false;
  Fake::sent.clear();
}

TEST(Middleware, WhatIsNoExceptionOfTheStandardIsToldToo) {
  rt_tests::Sending sending;
  EXPECT_TRUE(sending.succeeds([] {}));
  EXPECT_EQ(sending.problem("m"), "");
  EXPECT_FALSE(sending.succeeds([] { throw 5; }));
  EXPECT_EQ(sending.problem("m"), "m: cannot publish: something that is no std::exception was thrown");
}

// What its thread catches: the node itself lets it pass.
TEST(Middleware, AnActivationThatThrowsIsNotTheEndOfTheProgram) {
  topology::Node described{};
  described.activations_max = 1;
  described.outputs = {{0, 1, 1}};
  topology::HostedNode node(described);
  const auto publish = [](std::size_t, int64_t) { throw std::runtime_error("no room"); };
  EXPECT_THROW(node.activate(0, topology::HostedNode::all_inputs, publish), std::runtime_error);
}

TEST(Middleware, APayloadBeyondItsLimitIsRefused) {
  for (const auto main : {communication::publisher_main<Fake>, communication::subscriber_main<Fake>}) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(called(main, {"-l", "1001"}), 2);
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "\tERROR: -l takes at most 1000 bytes through fake, got '1001'\n");
  }
}

TEST(Costs, AreCounted) {
  const auto before = rt_tests::costs_so_far();
  constexpr std::size_t pages = 1000;
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  auto* const memory = static_cast<volatile char*>(std::aligned_alloc(page, pages * page));
  for (std::size_t i = 0; i < pages; ++i) memory[i * page] = 1;
  for (int i = 0; i < 5; ++i) communication::pause(1000000);
  const auto costs = rt_tests::costs_so_far() - before;
  std::free(const_cast<char*>(memory));
  EXPECT_GE(costs.minor_faults, 100);  // pages may be large ones
  EXPECT_GE(costs.voluntary_switches, 5);
  EXPECT_GT(costs.cpu_time_ns, 0);
}
