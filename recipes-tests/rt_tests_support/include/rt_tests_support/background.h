// Work of low priority while a measurement runs.
#pragma once

#include <pthread.h>
#include <functional>

#include "rt_tests_support/cpus.h"

namespace rt_tests {

// Calls `work` every `period_ms` milliseconds on a thread of its own, until destroyed. That thread has normal
// scheduling and the lowest nice value, whatever the rest of the process has. `work` must neither throw nor allocate.
class Background {
 public:
  // `name` is the thread's name in the kernel, at most 15 characters. Throws Failure if no thread can be started.
  Background(const char* name, int period_ms, const CpuSet& cpus, std::function<void()> work);
  ~Background();  // waits for a call of `work` that has begun
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

 private:
  static void* run(void* self);
  bool wait_for_period() noexcept;  // false when the thread must end

  const int period_ms_;
  const std::function<void()> work_;
  pthread_mutex_t mutex_ = PTHREAD_MUTEX_INITIALIZER;
  pthread_cond_t end_;
  bool ended_ = false;
  pthread_t thread_;
};

}  // namespace rt_tests
