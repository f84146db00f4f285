#!/bin/sh
# What roscpp has on this target: one line "name value" for each fact. Read by inspect.sh's caller, in one shell with it.
# A folder with librcl is a ROS 2, which has another setup.
for setup in /opt/ros/*/setup.sh; do
    [ -e "$setup" ] && [ ! -e "${setup%/*}/lib/librcl.so" ] && echo "setup $setup"
done
for master in /opt/ros/*/bin/rosmaster /usr/bin/rosmaster; do
    [ -x "$master" ] && echo "server $master"
done
for program in /opt/ros/*/lib/*_tests/* /opt/ros/*/lib/rt_tests_sampler/rt_tests_sampler; do
    [ -x "$program" ] && echo "program $program"
done
{
    sed -n 's/.*<version>\(.*\)<.version>.*/version \1/p' /opt/ros/*/share/roscpp/package.xml /usr/share/roscpp/package.xml
    ls /usr/lib/libroscpp.so.*.* /usr/lib/*/libroscpp.so.*.* | sed 's/.*[.]so[.]/version /'
} 2>/dev/null | head -n 1
