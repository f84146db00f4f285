// Measures the latency of a timer of rclcpp that is called once.
#include "rt_tests_support/measure/oneshot.h"
#include "rt_tests_support/rclcpp.h"

int main(int argc, char* argv[]) { return oneshot::main<oneshot::Spinning<rt_tests::Rclcpp>>(argc, argv); }
