#include "rt_tests_support/stop.h"

#include <atomic>
#include <cerrno>
#include <csignal>

namespace rt_tests {
namespace {

constexpr int by_ros = -1;
std::atomic<int> cause{0};
std::atomic<sem_t*> waiter{nullptr};

void stop(int why) {
  cause.store(why);
  if (sem_t* wake = waiter.load()) sem_post(wake);
}

void on_signal(int signal) {
  const int saved = errno;
  stop(signal);
  errno = saved;
}

}  // namespace

void catch_stop_signals(sem_t* wake) {
  waiter.store(wake);
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

void request_stop() noexcept { stop(by_ros); }

bool stop_requested() noexcept { return cause.load(std::memory_order_relaxed) != 0; }

std::string stop_reason() {
  switch (cause.load()) {
    case 0: return "";
    case SIGINT: return "ended by SIGINT";
    case SIGTERM: return "ended by SIGTERM";
    default: return "ended by ROS";
  }
}

}  // namespace rt_tests
