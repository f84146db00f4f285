// The real-time set-up of a process (thesis, section 2.3.3) and what the kernel says became of it.
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
void set_up_process(const Options& options);

// On a thread that measures, once the threads of ROS run: policy and priority if --rt-scope measuring-thread. Threads
// it starts afterwards inherit them.
void set_up_measuring_thread(const Options& options);

// CPUs for what is not to disturb the measurement: those that --cpu leaves; all this process has, if it leaves none.
cpu_set_t spare_cpus();

// After the last measurement: every thread back to normal scheduling. A node that stays above the ROS master's
// priority can lock up a single CPU in ros::shutdown (thesis, section 4.4).
void give_up_realtime();

std::vector<ThreadState> read_threads();  // every thread of this process
bool memory_is_locked();

// Before the samples are allocated and touched, which would otherwise end in the kernel's out-of-memory killer. Throws
// Failure if the kernel says that less memory is available.
void require_memory(int64_t bytes);

}  // namespace rt_tests
