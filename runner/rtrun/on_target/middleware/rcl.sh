#!/bin/sh
# What rcl has on this target, as roscpp.sh tells it of roscpp: beside $ros_setup, the file that sets it up, or below /opt/ros.
folder=${ros_setup%/*}
# Of a library of ROS 2.
tell_ros2() {
    for prefix in ${folder:-/opt/ros/*}; do
        for program in "$prefix"/lib/*_tests/*_"$1" "$prefix/lib/rt_tests_sampler/rt_tests_sampler"; do
            [ -x "$program" ] && echo "program $program"
        done
        [ -e "$prefix/lib/lib$1.so" ] || continue
        echo "setup $prefix/setup.sh"
        sed -n 's/.*<version>\(.*\)<.version>.*/version \1/p' "$prefix/share/$1/package.xml"
    done
}
tell_ros2 rcl
