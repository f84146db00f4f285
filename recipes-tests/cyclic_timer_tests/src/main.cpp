// Measures the jitter of roscpp's cyclic timer.
#include "rt_tests_support/measure/cyclic.h"
#include "rt_tests_support/roscpp.h"

int main(int argc, char* argv[]) { return cyclic::main<rt_tests::Roscpp>(argc, argv); }
