#include "rt_tests_support/measure/subscriber.h"

#include "rclcpp.h"

int main(int argc, char* argv[]) { return communication::subscriber_main<Rclcpp>(argc, argv); }
