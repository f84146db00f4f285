// The program that hosts the nodes of one process of a graph, through any middleware that has the following, beside the Context
// of middleware.h:
//
//   struct M {
//     static constexpr bool counts_processes;  // subscribers() counts the processes that take a topic, not their nodes
//
//     struct Sender {
//       Sender(Context& context, const topology::Topic& topic);  // throws Failure
//       unsigned char* bytes() noexcept;                         // topic.message_bytes() of them, to be filled
//       bool send() noexcept;                                    // false: no further message can be sent; checked
//       std::string problem();                                   // why, after that
//       int64_t subscribers();                                   // how many are connected
//     };
//
//     // Of the inputs of all nodes of a thread. Calls call_back(input, bytes, size) for each message, on the thread that calls
//     // receive().
//     template <class CallBack>
//     struct Receiver {
//       Receiver(Context& context, const std::vector<topology::Topic>& inputs, CallBack& call_back);  // throws Failure
//       void receive(int64_t limit_ns);          // takes one message of each input that has some, or waits for one, at most so long
//       int64_t publishers(std::size_t input);  // how many are connected
//     };
//   };
#pragma once

#include <semaphore.h>
#include <time.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"
#include "rt_tests_support/measure/activations.h"
#include "rt_tests_support/measure/graph.h"
#include "rt_tests_support/middleware.h"
#include "rt_tests_support/options.h"
#include "rt_tests_support/process.h"
#include "rt_tests_support/report.h"
#include "rt_tests_support/stop.h"

namespace topology {

// After the last period nodes go on until nothing has come for so long, so that every message has a fate. Where that takes
// longer than the second time they work no more, and count what comes, as long again.
constexpr int64_t quiet_ns = 500 * 1000000;
constexpr int64_t drained_ns = 10 * rt_tests::ns_per_s;

// What came of a thread of nodes.
struct Hosted {
  std::vector<HostedNode*> nodes;
  int64_t foreign = 0;   // messages from outside the graph
  int64_t left_ns = 0;   // when it stopped receiving
  std::string problem;   // why it could not go on; empty: it could
};

// Everything of a run but the middleware.
struct Run {
  Run(const Process& process, const rt_tests::Program& program, const rt_tests::Options& options,
      const rt_tests::Destination& destination);

  const Process& process;
  const rt_tests::Program& program;
  const rt_tests::Options& options;
  const rt_tests::Destination& destination;
  std::vector<std::unique_ptr<HostedNode>> nodes;
  rt_tests::Surroundings surroundings;
  int64_t start_ns = 0;  // the same for all processes
};

// Polls `missing`, which says what this process still lacks, until it lacks nothing; says that this process is ready, and waits
// until all are. Returns when they start. Throws Failure when that takes longer than a minute.
int64_t wait_for_start(const Run& run, const std::function<std::string()>& missing);

void sleep_until(int64_t due_ns, int64_t limit_ns) noexcept;  // CLOCK_MONOTONIC; at most so long

// Writes the tables, then the json. Throws Failure where the graph could not be run to its end.
void report(Run& run, const std::vector<Hosted>& threads);

// From now on the program has 20 s to end; then it is ended, with this status. Fast DDS at times waits for ever for peers that
// end at the same moment.
void end_within_limit(int status);

template <class M>
class ExecutorThread {
 public:
  ExecutorThread(typename M::Context& context, Run& run, std::size_t number)
      : context_(context), run_(run), executor_(run.process.executors[number]), call_back_{this} {
    std::vector<Topic> topics;
    for (const auto& node : run.nodes) {
      const Node& described = *node->description;
      if (described.executor != number) continue;
      hosted.nodes.push_back(node.get());
      Ends ends{node.get(), {}};
      for (const Output& output : described.outputs) {
        ends.outputs.push_back(std::make_unique<typename M::Sender>(context, run.process.topics[output.topic]));
      }
      for (std::size_t input = 0; input < described.inputs.size(); ++input) {
        topics.push_back(run.process.topics[described.inputs[input].topic]);
        inputs_.push_back({nodes_.size(), input, topics.back().message_bytes()});
      }
      nodes_.push_back(std::move(ends));
    }
    topics_ = topics;
    if (!topics.empty()) receiver_ = std::make_unique<Receiver>(context, topics, call_back_);
  }

  // Where something threw before the thread was told to end.
  ~ExecutorThread() {
    if (!thread_.joinable()) return;
    rt_tests::request_stop();
    begin();
    end();
  }
  ExecutorThread(const ExecutorThread&) = delete;
  ExecutorThread& operator=(const ExecutorThread&) = delete;

  // What is not connected yet, empty: nothing.
  std::string missing() {
    if (!is_set_up_.load()) return "executor " + executor_.name + " is not set up";
    for (auto& [node, outputs] : nodes_) {
      for (std::size_t output = 0; output < outputs.size(); ++output) {
        const Output& described = node->description->outputs[output];
        const int64_t wanted = M::counts_processes ? described.processes : described.subscriptions;
        const int64_t connected = outputs[output]->subscribers();
        if (connected < wanted) {
          return run_.process.topics[described.topic].name + " has " + std::to_string(connected) + " of " +
                 std::to_string(wanted) + " subscribers";
        }
      }
    }
    for (std::size_t input = 0; input < topics_.size(); ++input) {
      if (receiver_->publishers(input) < 1) return topics_[input].name + " has no publisher";
    }
    return "";
  }

  void start() { thread_ = std::thread([this] { run(); }); }
  void begin() { sem_post(&begin_.semaphore); }
  void wait() { done_.wait(); }  // until its nodes are through; the thread stays as it is
  void end() {
    sem_post(&leave_.semaphore);
    thread_.join();
  }

  Hosted hosted;

 private:
  struct Semaphore {
    Semaphore() { sem_init(&semaphore, 0, 0); }
    ~Semaphore() { sem_destroy(&semaphore); }
    void wait() {
      while (sem_wait(&semaphore) != 0) {
      }
    }
    sem_t semaphore;
  };
  struct CallBack {
    ExecutorThread* thread;
    void operator()(std::size_t input, const unsigned char* bytes, std::size_t size) { thread->receive(input, bytes, size); }
  };
  struct Ends {
    HostedNode* node;
    std::vector<std::unique_ptr<typename M::Sender>> outputs;
  };
  struct InputOf {
    std::size_t node, input;
    std::size_t message_bytes;
  };
  using Receiver = typename M::template Receiver<CallBack>;

  void run() {
    pthread_setname_np(pthread_self(), executor_.name.substr(0, 15).c_str());
    try {
      rt_tests::set_up_thread(executor_.policy, executor_.priority, executor_.cpus);
      is_set_up_.store(true);
      begin_.wait();
      if (run_.start_ns > 0) go_on();
    } catch (const std::exception& failure) {
      hosted.problem = failure.what();
      rt_tests::request_stop();
    }
    hosted.left_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
    sem_post(&done_.semaphore);
    leave_.wait();
  }

  void go_on() {
    const int64_t until_ns = run_.start_ns + run_.process.measure_ns;
    works_until_ns_ = until_ns + drained_ns;
    while (!rt_tests::stop_requested() && rt_tests::now_ns(CLOCK_MONOTONIC) < run_.start_ns) {
      sleep_until(run_.start_ns, rt_tests::spin_limit_ns);
    }
    last_message_ns_ = until_ns;
    while (!rt_tests::stop_requested() && hosted.problem.empty()) {
      // The middleware may ask it to end, as a ROS master does when another node takes its name.
      if (!context_.ok()) rt_tests::request_stop();
      int64_t next_ns = activate_what_is_due(until_ns);
      const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
      if (next_ns == never) {
        // Messages may be under way, here or in the middleware.
        const int64_t quiet_since_ns = std::max(until_ns, last_message_ns_);
        if (now_ns >= quiet_since_ns + quiet_ns || now_ns >= works_until_ns_ + drained_ns) return;
        next_ns = quiet_since_ns + quiet_ns;
      }
      if (receiver_) {
        receiver_->receive(std::clamp<int64_t>(next_ns - now_ns, 0, rt_tests::spin_limit_ns));
      } else {
        sleep_until(next_ns, rt_tests::spin_limit_ns);
      }
    }
  }

  static constexpr int64_t never = std::numeric_limits<int64_t>::max();

  // Each node whose period has come, once. Returns when the next one comes.
  int64_t activate_what_is_due(int64_t until_ns) {
    int64_t next_ns = never;
    for (Ends& ends : nodes_) {
      HostedNode& node = *ends.node;
      const Node& described = *node.description;
      if (described.waits != Waits::period) continue;
      int64_t due_ns = grid_ns(node);
      const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
      if (due_ns < until_ns && due_ns <= now_ns) {
        // As timers of ROS 2 do: what is past when a late call begins is left out.
        ++node.period;
        while (grid_ns(node) < now_ns && grid_ns(node) < until_ns) {
          ++node.period;
          ++node.skipped;
        }
        activate(ends, due_ns, HostedNode::all_inputs);
        due_ns = grid_ns(node);
      }
      if (due_ns < until_ns) next_ns = std::min(next_ns, due_ns);
    }
    return next_ns;
  }

  int64_t grid_ns(const HostedNode& node) const noexcept {
    return run_.start_ns + node.description->offset_ns + node.period * node.description->period_ns;
  }

  void receive(std::size_t input, const unsigned char* bytes, std::size_t size) {
    const int64_t now_ns = rt_tests::now_ns(CLOCK_MONOTONIC);
    const InputOf& owner = inputs_[input];
    Head head;
    if (size == owner.message_bytes) std::memcpy(&head, bytes, sizeof head);
    if (size != owner.message_bytes || head.magic != Head::magic_number) {
      ++hosted.foreign;
      return;
    }
    last_message_ns_ = now_ns;
    Ends& ends = nodes_[owner.node];
    if (!ends.node->receive(owner.input, head, now_ns)) {
      const std::size_t topic = ends.node->description->inputs[owner.input].topic;
      stop("more messages came than there can be: others publish on " + run_.process.topics[topic].name);
    } else if (now_ns >= works_until_ns_) {
      return;  // a queue that is longer than the run: it is not used
    } else if (ends.node->description->waits == Waits::any) {
      activate(ends, now_ns, owner.input);
    } else if (ends.node->description->waits == Waits::all && ends.node->has_all_new()) {
      activate(ends, now_ns, HostedNode::all_inputs);
    }
  }

  void activate(Ends& ends, int64_t due_ns, std::size_t only) {
    const bool good = ends.node->activate(due_ns, only, [&](std::size_t output, int64_t number) {
      auto& sender = *ends.outputs[output];
      static_assert(noexcept(sender.send()), "what a send throws is kept in Sending");
      const Head head{Head::magic_number, static_cast<uint64_t>(number), rt_tests::now_ns(CLOCK_MONOTONIC)};
      std::memcpy(sender.bytes(), &head, sizeof head);
      if (!sender.send()) stop(sender.problem());
    });
    if (!good) stop("more activations came than there can be");
  }

  void stop(const std::string& why) {
    hosted.problem = why;
    rt_tests::request_stop();
  }

  typename M::Context& context_;
  Run& run_;
  const Executor& executor_;
  CallBack call_back_;
  std::vector<Ends> nodes_;
  std::vector<InputOf> inputs_;
  std::vector<Topic> topics_;  // of the inputs
  std::unique_ptr<Receiver> receiver_;
  int64_t last_message_ns_ = 0;
  int64_t works_until_ns_ = 0;
  std::atomic<bool> is_set_up_{false};
  Semaphore begin_, done_, leave_;
  std::thread thread_;
};

// The file that the command line names, and what else it says. Throws UsageError.
struct CommandLine {
  CommandLine(const char* middleware, int argc, char* argv[]);

  Process process;
  rt_tests::Program program;
  // With policy, priority and CPUs of the process: what threads of the middleware inherit, which serve all of its executors.
  rt_tests::Options options;
};

template <class M>
int run(int argc, char* argv[]) {
  const CommandLine line(M::name, argc, argv);
  const Process& process = line.process;
  const rt_tests::Options& options = line.options;
  const rt_tests::Destination destination{rt_tests::destination(options, "process-" + process.name)};
  // Its executors have policies of their own, and some have none.
  const rt_tests::ProcessSetUp set_up(options, rt_tests::Heaps::per_thread);
  const rt_tests::CpuDmaLatency cpu_dma_latency(options);
  Run run(process, line.program, options, destination);
  set_up.set_policy();
  typename M::Context context(argc, argv, line.program, options);
  rt_tests::add_facts(run.surroundings.facts, context);
  rt_tests::set_up_measuring_thread(options);
  rt_tests::catch_stop_signals(nullptr);

  std::vector<std::unique_ptr<ExecutorThread<M>>> threads;
  for (std::size_t number = 0; number < process.executors.size(); ++number) {
    threads.push_back(std::make_unique<ExecutorThread<M>>(context, run, number));
  }
  for (auto& thread : threads) thread->start();
  std::string failure;
  try {
    run.start_ns = wait_for_start(run, [&] {
      if (!context.ok()) rt_tests::request_stop();
      std::string missing;
      for (auto& thread : threads) {
        if (missing.empty()) missing = thread->missing();
      }
      return missing;
    });
  } catch (const std::exception& error) {
    failure = error.what();
  }
  run.surroundings.begin();
  for (auto& thread : threads) thread->begin();
  for (auto& thread : threads) thread->wait();
  run.surroundings.end();
  run.surroundings.finish();
  rt_tests::give_up_realtime();
  std::vector<Hosted> hosted;
  for (auto& thread : threads) {
    thread->end();
    if (thread->hosted.problem.empty()) thread->hosted.problem = failure;
    hosted.push_back(thread->hosted);
  }
  const int status = rt_tests::guarded([&] {
    report(run, hosted);
    return 0;
  });
  end_within_limit(status);
  threads.clear();
  context.shutdown();
  return status;
}

template <class M>
int main(int argc, char* argv[]) {
  return rt_tests::guarded([&] { return run<M>(argc, argv); });
}

}  // namespace topology
