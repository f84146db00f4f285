// Measures the latency of a timer of rcl that is called once.
#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/rcl.h"

namespace {

struct Rcl : rt_tests::Rcl {
  template <class Timer>
  using Waiter = oneshot::SpinningWaiter<Context, Timer>;
};

}  // namespace

int main(int argc, char* argv[]) { return oneshot::main<Rcl>(argc, argv); }
