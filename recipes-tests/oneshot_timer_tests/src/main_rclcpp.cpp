// Measures the latency of a timer of rclcpp that is called once.
#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/rclcpp.h"

namespace {

struct Rclcpp : rt_tests::Rclcpp {
  template <class Timer>
  using Waiter = oneshot::SpinningWaiter<Context, Timer>;
};

}  // namespace

int main(int argc, char* argv[]) { return oneshot::main<Rclcpp>(argc, argv); }
