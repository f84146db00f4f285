#!/bin/sh
# Builds packages of the suites with a machine's own compiler, CMake and ROS:
#   sh build.sh SETUP WORK STAGE PACKAGE...
# SETUP is the shell file of the ROS, as /opt/ros/jazzy/setup.sh; empty: ROS_VERSION of the environment says which it is, in
# /usr, or there is none. STAGE is the folder where each package is installed, and found by those after it. Prints a line
# "name version" for each thing of a ROS that it built with.
setup=$1 work=$2 stage=$3 sources=$(cd "${0%/*}" && pwd)
shift 3
if [ -n "$setup" ]; then
    # shellcheck source=/dev/null
    . "$setup" || exit
fi
set -eu
prefixes=$(echo "${AMENT_PREFIX_PATH:-${CMAKE_PREFIX_PATH:-}}" | tr : ' ')
# Only C++ messages are needed; for other languages ROS 1 would need packages, too, and it must keep its own set-up.
export ROS_LANG_DISABLE=genlisp:genpy:geneus:gennodejs
for package; do
    cmake -S "$sources/$package" -B "$work/$package" -DCMAKE_BUILD_TYPE=None -DPython3_EXECUTABLE=/usr/bin/python3 \
        -DPython_EXECUTABLE=/usr/bin/python3 -DPYTHON_EXECUTABLE=/usr/bin/python3 -DCATKIN_ENABLE_TESTING=OFF \
        -DCATKIN_BUILD_BINARY_PACKAGE=1 -DCMAKE_INSTALL_PREFIX="$stage" \
        -DCMAKE_PREFIX_PATH="$stage;$(echo "$prefixes" | tr ' ' ';')" >&2
    cmake --build "$work/$package" --target install --parallel "${JOBS:-$(nproc)}" >&2
done
# The version of a package, by the first of the folders of the ROS that has it.
tell() {
    for prefix in $prefixes /usr; do
        [ -e "$prefix/share/$1/package.xml" ] || continue
        sed -n "s/.*<version>\(.*\)<.version>.*/$1 \1/p" "$prefix/share/$1/package.xml"
        break
    done
}
case ${ROS_VERSION:-} in
1) tell roscpp ;;
2)
    echo "distro $ROS_DISTRO"
    tell rcl
    tell rclcpp
    for prefix in $prefixes; do
        ls "$prefix/share/ament_index/resource_index/rmw_typesupport" 2>/dev/null || true
    done | sort -u | while read -r rmw; do
        # What chooses one of them when a program starts is none itself.
        [ "$rmw" = rmw_implementation ] || tell "$rmw"
    done
    ;;
esac
