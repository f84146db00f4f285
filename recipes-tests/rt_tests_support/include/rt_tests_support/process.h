// The real-time set-up of a process (thesis, section 2.3.3), and its state as the kernel reports it.
#pragma once

#include <sched.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

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

// Before the middleware starts, so that every later thread inherits it: affinity; with RR or FIFO memory locked and the stack
// touched; policy and priority unless --rt-scope measuring-thread. Libraries may have started threads before main(), as
// LTTng's does in programs of ROS 2: these get it, too. Throws Failure that names the missing right.
// Returns the CPUs for threads that must not disturb the measurement: those that --cpu leaves free, or all CPUs of this
// process if --cpu leaves none.
cpu_set_t set_up_process(const Options& options);

// On a measuring thread, once ROS is initialised and before its timer or publisher starts: policy and priority if
// --rt-scope measuring-thread, which the threads that start afterwards inherit; with RR or FIFO the heap reserved.
void set_up_measuring_thread(const Options& options);

// Policy ("0", RR or FIFO), priority and CPUs of the calling thread alone, of whatever the process has. Throws Failure.
void set_up_thread(const std::string& policy, int64_t priority, const std::string& cpus);

// Before any thread starts: one heap for all threads, of which nothing is handed back to the kernel.
void share_heap();

// Extends that heap, so that the threads can allocate this much without a system call or a page fault: a
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

cpu_set_t current_cpus();  // of the calling thread

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
