// Work of low priority beside a measurement.
#pragma once

#include <pthread.h>

#include <functional>

namespace rt_tests {

// Calls `work` every so many milliseconds on a thread of its own, until destroyed. Whatever the rest of the process
// has, this thread has normal scheduling, the lowest nice value and the CPUs that --cpu leaves: it runs when nobody
// else wants to, and nobody waits for it. `work` must neither throw nor allocate.
class Background {
 public:
  // `name` is how the kernel shows the thread, at most 15 characters. Throws Failure if there is no thread to have.
  Background(const char* name, int period_ms, std::function<void()> work);
  ~Background();  // waits for a call under way
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

 private:
  static void* run(void* self);
  bool rest() noexcept;  // false when it is to end

  const int period_ms_;
  const std::function<void()> work_;
  pthread_mutex_t mutex_ = PTHREAD_MUTEX_INITIALIZER;
  pthread_cond_t end_;
  bool ended_ = false;
  pthread_t thread_;
};

}  // namespace rt_tests
