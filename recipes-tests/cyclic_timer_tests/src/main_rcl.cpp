// Measures the jitter of a timer of rcl.
#include "rt_tests_support/measure/cyclic.h"
#include "rt_tests_support/rcl.h"

int main(int argc, char* argv[]) { return cyclic::main<rt_tests::Rcl>(argc, argv); }
