// A process of a graph of nodes, as a text tells it, which the runner writes: a line each topic, executor, node, and each of a
// node's inputs and outputs. docs/formats.md explains the words.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace topology {

struct Topic {
  std::string name;
  int64_t payload_bytes;
  bool reliable;
  int32_t depth;  // messages that the middleware keeps

  std::size_t message_bytes() const;  // with the head
};

// What stands before the payload of every message. Both ends are on one machine, and so are of one byte order.
struct Head {
  static constexpr uint64_t magic_number = 0x7274'6772'6170'6831;
  uint64_t magic;
  uint64_t seq;            // the number of the activation that published it, from 0 on
  int64_t publication_ns;  // CLOCK_MONOTONIC, right before the middleware has it
};

// A thread, which runs its nodes one activation at a time.
struct Executor {
  std::string name;
  std::string policy;  // 0, FIFO, RR
  int64_t priority;
  std::string cpus;  // empty: all
};

enum class Waits {
  period,  // for its grid, and takes the newest message of each input then
  any,     // for a message of any input
  all,     // for a new message of every input, and takes the newest of each
};

struct Input {
  std::size_t topic;
  int64_t messages_max;
};

struct Output {
  std::size_t topic;
  int64_t subscriptions;  // nodes that take it, in all processes
  int64_t processes;      // in which these are
};

struct Node {
  std::string name;
  std::size_t executor;
  Waits waits;
  int64_t period_ns, offset_ns;
  int64_t busy_ns;  // CPU time of the thread
  int64_t touched_bytes;
  int64_t activations_max;
  std::vector<Input> inputs;
  std::vector<Output> outputs;
};

struct Process {
  std::string name;
  int64_t processes = 0;  // of the whole graph: they begin together
  int64_t measure_ns = 0;
  std::vector<Topic> topics;
  std::vector<Executor> executors;
  std::vector<Node> nodes;
};

// Throws UsageError that names the line.
Process read_process(const std::string& path);

}  // namespace topology
