#include "rt_tests_support/background.h"

#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/errors.h"

namespace rt_tests {
namespace {
constexpr std::size_t stack_bytes = 128 * 1024;  // locked with the rest of the process
constexpr int lowest_nice = 19;
}  // namespace

Background::Background(const char* name, int period_ms, const CpuSet& cpus, std::function<void()> work)
    : period_ms_(period_ms), work_(std::move(work)) {
  // The period must not depend on the wall clock, which may jump.
  pthread_condattr_t monotonic;
  pthread_condattr_init(&monotonic);
  pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
  pthread_cond_init(&end_, &monotonic);
  pthread_condattr_destroy(&monotonic);

  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, stack_bytes);
  pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
  pthread_attr_setschedpolicy(&attributes, SCHED_OTHER);
  const sched_param none{};
  pthread_attr_setschedparam(&attributes, &none);
  pthread_attr_setaffinity_np(&attributes, cpus.bytes(), cpus.get());

  // Signals end a measurement, so only the measuring threads take them.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  const int problem = pthread_create(&thread_, &attributes, run, this);
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  pthread_attr_destroy(&attributes);
  if (problem != 0) {
    pthread_cond_destroy(&end_);
    throw Failure(std::string("cannot start the thread ") + name + ": " + std::strerror(problem));
  }
  pthread_setname_np(thread_, name);
}

Background::~Background() {
  pthread_mutex_lock(&mutex_);
  ended_ = true;
  pthread_cond_signal(&end_);
  pthread_mutex_unlock(&mutex_);
  pthread_join(thread_, nullptr);
  pthread_cond_destroy(&end_);
}

void* Background::run(void* self) {
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), lowest_nice);  // on Linux: of this thread only
  auto& background = *static_cast<Background*>(self);
  while (background.wait_for_period()) background.work_();
  return nullptr;
}

bool Background::wait_for_period() noexcept {
  const int64_t due_ns = now_ns(CLOCK_MONOTONIC) + int64_t{period_ms_} * 1000000;
  timespec due;
  due.tv_sec = static_cast<time_t>(due_ns / ns_per_s);
  due.tv_nsec = static_cast<long>(due_ns % ns_per_s);
  pthread_mutex_lock(&mutex_);
  while (!ended_ && pthread_cond_timedwait(&end_, &mutex_, &due) != ETIMEDOUT) {
  }
  const bool ended = ended_;
  pthread_mutex_unlock(&mutex_);
  return !ended;
}

}  // namespace rt_tests
