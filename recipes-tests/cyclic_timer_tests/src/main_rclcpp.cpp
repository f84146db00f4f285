// Measures the jitter of a timer of rclcpp.
#include "rt_tests_support/measure/cyclic.h"
#include "rt_tests_support/rclcpp.h"

int main(int argc, char* argv[]) { return cyclic::main<rt_tests::Rclcpp>(argc, argv); }
