#!/bin/sh
# What rclcpp has on this target, by the function of rcl.sh, which comes before this in the same shell.
tell_ros2 rclcpp
