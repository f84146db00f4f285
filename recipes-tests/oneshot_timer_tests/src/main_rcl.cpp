// Measures the latency of a timer of rcl that is called once.
#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/rcl.h"

int main(int argc, char* argv[]) { return oneshot::main<oneshot::Spinning<rt_tests::Rcl>>(argc, argv); }
