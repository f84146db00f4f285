#!/bin/sh
# Builds packages of the suites on the ROS 2 of a machine, with its own compiler and CMake:
#   sh ros2.sh SETUP SOURCES WORK STAGE PACKAGE...
# SETUP is the shell file of the ROS 2, as /opt/ros/jazzy/setup.sh, STAGE the folder where each package is installed, and found
# by those after it. Prints a line "name version" for each thing it built with.
setup=$1 sources=$2 work=$3 stage=$4
shift 4
. "$setup" || exit
set -eu
export ROS_VERSION=2
for package; do
    cmake -S "$sources/$package" -B "$work/$package" -DCMAKE_BUILD_TYPE=None -DPython3_EXECUTABLE=/usr/bin/python3 \
        -DCMAKE_INSTALL_PREFIX="$stage" -DCMAKE_PREFIX_PATH="$stage;$(echo "$AMENT_PREFIX_PATH" | tr : ';')" >&2
    cmake --build "$work/$package" --target install >&2
done
echo "distro $ROS_DISTRO"
for package in rcl rclcpp; do
    for prefix in $(echo "$AMENT_PREFIX_PATH" | tr : ' '); do
        [ -e "$prefix/share/$package/package.xml" ] || continue
        sed -n "s/.*<version>\(.*\)<.version>.*/$package \1/p" "$prefix/share/$package/package.xml"
        break
    done
done
