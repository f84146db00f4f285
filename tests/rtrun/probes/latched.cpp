// A node of ROS 1. latched_publisher publishes one message, which it latches, for each line that it reads; latched_subscriber
// prints a line for each that it takes. Messages without a header: nothing tells them apart but their bytes.
#include <ros/ros.h>
#include <std_msgs/Float64.h>

#include <cstdio>
#include <iostream>
#include <string>

int main(int argc, char* argv[]) {
  const std::string name = argv[1];
  ros::init(argc, argv, name);
  ros::NodeHandle node;
  std::puts("begins");
  std::fflush(stdout);
  if (name == "latched_publisher") {
    ros::Publisher publisher = node.advertise<std_msgs::Float64>("latched", 1, true);
    for (std::string line; std::getline(std::cin, line);) publisher.publish(std_msgs::Float64());
  } else {
    const boost::function<void(const std_msgs::Float64::ConstPtr&)> took = [](const std_msgs::Float64::ConstPtr&) {
      std::puts("took");
      std::fflush(stdout);
    };
    const ros::Subscriber subscriber = node.subscribe<std_msgs::Float64>("latched", 1, took);
    ros::spin();
  }
}
