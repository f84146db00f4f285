#!/bin/sh
# What rcl has on this target, as roscpp.sh tells it of roscpp: beside $ros_setup, the file that sets it up, or below /opt/ros.
folder=${ros_setup%/*}
for prefix in ${folder:-/opt/ros/*}; do
    for program in "$prefix"/lib/*_tests/*_tests*_rcl "$prefix/lib/rt_tests_sampler/rt_tests_sampler"; do
        [ -x "$program" ] && echo "program $program"
    done
    [ -e "$prefix/lib/librcl.so" ] || continue
    echo "setup $prefix/setup.sh"
    sed -n 's/.*<version>\(.*\)<.version>.*/version \1/p' "$prefix/share/rcl/package.xml"
done
