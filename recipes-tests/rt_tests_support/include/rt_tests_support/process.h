// The real-time set-up of a process (thesis, section 2.3.3), and its state as the kernel reports it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rt_tests_support/cpus.h"
#include "rt_tests_support/options.h"

namespace rt_tests {

struct ThreadState {
  int tid;
  std::string name;
  std::string policy;  // OTHER, RR, FIFO
  int priority;
  std::vector<int> cpus;
};

bool is_realtime(const Options& options);

// Where threads allocate. Malloc locks a heap without priority inheritance: a real-time thread that shares one with threads of
// normal scheduling waits until these get the CPU. On a busy CPU 1 allocation in 7 then took 5 to 8 ms, instead of 28 us at most.
enum class Heaps {
  shared,      // of all threads, which therefore have one policy and priority
  per_thread,  // of each thread
};
Heaps heaps_of(const Options& options);  // shared, unless --rt-scope measuring-thread leaves the other threads at normal scheduling

// The set-up of a process, in the order in which no real-time thread waits for memory: lock it, touch the stack, allocate, and
// only then set the policy. Libraries may have started threads before main(), as LTTng's does in programs of ROS 2: these get
// what the process gets.
class ProcessSetUp {
 public:
  // Affinity; with RR or FIFO memory locked and the stack touched. Throws Failure that names the missing right.
  ProcessSetUp(const Options& options, Heaps heaps);
  explicit ProcessSetUp(const Options& options) : ProcessSetUp(options, heaps_of(options)) {}

  // For threads that must not disturb the measurement: the CPUs that --cpu leaves free, or all CPUs of this process if it leaves
  // none.
  const CpuSet& spare_cpus() const { return spare_cpus_; }

  // When all that is measured has its memory, and before the middleware starts, whose threads inherit it: with RR or FIFO, unless
  // --rt-scope measuring-thread, the heap reserved, then policy and priority. Threads of Background that have started meanwhile
  // keep theirs. Throws Failure that names the missing right.
  void set_policy() const;

 private:
  const Options& options_;
  const std::vector<int> threads_;  // that the process had
  CpuSet spare_cpus_;
};

// On a measuring thread, once ROS is initialised and before its timer or publisher starts: with RR or FIFO the heap reserved, then
// policy and priority if --rt-scope measuring-thread, which the threads that start afterwards inherit.
void set_up_measuring_thread(const Options& options);

// Policy ("0", RR or FIFO), priority and CPUs of the calling thread alone, of whatever the process has; with RR or FIFO its heap is
// reserved before. Throws Failure.
void set_up_thread(const std::string& policy, int64_t priority, const std::string& cpus);

// Before any thread starts: the heaps, of which nothing is handed back to the kernel.
void set_up_heaps(Heaps heaps);

// Extends the heap of the calling thread, so that it can allocate this much without a system call or a page fault: a
// subscriber's queue of 1000 messages may take 2 KiB for each.
constexpr std::size_t heap_reserve_bytes = 2 * 1024 * 1024;
void reserve_heap();

// While it lives, idle CPUs wake within the microseconds of --cpu-dma-latency, if it was given: the kernel lets them
// sleep no deeper while /dev/cpu_dma_latency is open with that value. Throws Failure if it cannot be held.
class CpuDmaLatency {
 public:
  explicit CpuDmaLatency(const Options& options);
  ~CpuDmaLatency();
  CpuDmaLatency(const CpuDmaLatency&) = delete;
  CpuDmaLatency& operator=(const CpuDmaLatency&) = delete;

 private:
  int file_ = -1;
};

// The lowest latency that any program holds, in microseconds, as the kernel reports it; none where it cannot be read.
std::optional<int32_t> cpu_dma_latency_us();

CpuSet current_cpus();  // of the calling thread

// After the last measurement: puts every thread back to normal scheduling. A node that keeps a higher priority than the
// ROS master can block a single CPU in ros::shutdown (thesis, section 4.4).
void give_up_realtime();

std::vector<ThreadState> read_threads();  // every thread of this process

// The calls by which threads asked for memory, and gave it back.
struct Allocations {
  int64_t allocations = 0, frees = 0;  // of all threads
  int64_t of_measuring_thread = 0;     // allocations of the one that asks
};

// What all threads of this process cost together, those that ended included.
struct Costs {
  int64_t minor_faults = 0, major_faults = 0;  // page faults: without and with reading from a disk
  int64_t voluntary_switches = 0, involuntary_switches = 0;
  int64_t cpu_time_ns = 0;  // user and system
  std::optional<Allocations> allocations;  // where the library of rt_tests_sampler that counts them is preloaded
};
Costs costs_so_far();
Costs operator-(const Costs& later, const Costs& earlier);

bool memory_is_locked();

// Throws Failure if the kernel reports that less memory is available. To be called before samples are allocated and
// touched: with too little memory the kernel would kill the process.
void require_memory(int64_t bytes);

}  // namespace rt_tests
