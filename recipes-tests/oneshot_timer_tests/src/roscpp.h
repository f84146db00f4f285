// roscpp for the one-shot timer: callbacks run on a thread of their own, as in 2014, unless in busy mode.
#pragma once

#include <atomic>
#include <exception>
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
        try {
          while (!ended_ && context.ok()) {
            timer.spin(rt_tests::spin_limit_ns);
            if (box_.settle()) box_.wake();
          }
        } catch (...) {
          thrown_ = std::current_exception();
          threw_ = true;
          rt_tests::request_stop();
        }
        if (!context.ok()) rt_tests::request_stop();
      });
    }
    ~Waiter() {
      ended_ = true;
      if (spinner_.joinable()) spinner_.join();
    }
    // Throws what the spinning thread has thrown.
    bool wait() {
      if (!spinner_.joinable()) return busy_.wait();
      const bool is_settled = box_.wait();
      if (threw_) std::rethrow_exception(thrown_);
      return is_settled;
    }

   private:
    oneshot::ShotBox& box_;
    oneshot::SpinningWaiter<Context, Timer> busy_;
    std::atomic<bool> ended_{false};
    std::exception_ptr thrown_;
    std::atomic<bool> threw_{false};  // then the other one is complete
    std::thread spinner_;
  };
};
