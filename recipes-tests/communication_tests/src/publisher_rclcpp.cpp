#include "rt_tests_support/measure/publisher.h"

#include "rclcpp.h"

int main(int argc, char* argv[]) { return communication::publisher_main<Rclcpp>(argc, argv); }
