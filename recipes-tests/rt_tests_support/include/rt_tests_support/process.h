// The real-time set-up of a process (thesis, section 2.3.3), and its state as the kernel reports it.
#pragma once

#include <sched.h>

#include <cstdint>
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

// Before ros::init, so that every later thread inherits it: affinity; with RR or FIFO memory locked and the stack
// touched; policy and priority unless --rt-scope measuring-thread. Throws Failure that names the missing right.
// Returns the CPUs for threads that must not disturb the measurement: those that --cpu leaves free, or all CPUs of this
// process if --cpu leaves none.
cpu_set_t set_up_process(const Options& options);

// On a measuring thread, once the threads of ROS run: policy and priority if --rt-scope measuring-thread. Threads that
// it starts afterwards inherit them.
void set_up_measuring_thread(const Options& options);

cpu_set_t current_cpus();  // of the calling thread

// After the last measurement: puts every thread back to normal scheduling. A node that keeps a higher priority than the
// ROS master can block a single CPU in ros::shutdown (thesis, section 4.4).
void give_up_realtime();

std::vector<ThreadState> read_threads();  // every thread of this process
bool memory_is_locked();

// Throws Failure if the kernel reports that less memory is available. To be called before samples are allocated and
// touched: with too little memory the kernel would kill the process.
void require_memory(int64_t bytes);

}  // namespace rt_tests
