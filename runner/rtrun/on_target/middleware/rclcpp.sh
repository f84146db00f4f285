#!/bin/sh
# What rclcpp has on this target, as roscpp.sh tells it of roscpp: beside $ros_setup, or below /opt/ros.
folder=${ros_setup%/*}
for prefix in ${folder:-/opt/ros/*}; do
    [ -e "$prefix/lib/librclcpp.so" ] || continue
    echo "setup $prefix/setup.sh"
    sed -n 's/.*<version>\(.*\)<.version>.*/version \1/p' "$prefix/share/rclcpp/package.xml"
    for program in "$prefix"/lib/*_tests/*_tests*_rclcpp; do
        [ -x "$program" ] && echo "program $program"
    done
done
