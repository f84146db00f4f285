// roscpp for the one-shot timer: callbacks run on a thread of their own, as in 2014, unless in busy mode.
#pragma once

#include <atomic>
#include <thread>

#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/roscpp.h"

struct Roscpp : rt_tests::Roscpp {
  template <class Timer>
  class Waiter {
   public:
    Waiter(const rt_tests::Options& options, Context& context, Timer& timer, oneshot::ShotBox& box)
        : box_(box), busy_(options, context, timer, box) {
      if (options.number("busy_mode") == 1) return;
      spinner_ = std::thread([this, &context, &timer] {
        while (!ended_ && context.ok()) {
          timer.spin(rt_tests::spin_limit_ns);
          if (box_.settle()) box_.wake();
        }
        if (!context.ok()) rt_tests::request_stop();
      });
    }
    ~Waiter() {
      ended_ = true;
      if (spinner_.joinable()) spinner_.join();
    }
    bool wait() { return spinner_.joinable() ? box_.wait() : busy_.wait(); }

   private:
    oneshot::ShotBox& box_;
    oneshot::SpinningWaiter<Context, Timer> busy_;
    std::atomic<bool> ended_{false};
    std::thread spinner_;
  };
};
