#!/bin/sh
# Build the suites on the target, with its own compiler and ROS:
#   build_suites.sh SOURCES FOLDER PREFIX [SETUP...]
# SOURCES is a copy of recipes-tests, FOLDER where it works, PREFIX what gets the programs, and the file `built_with` with a
# line "name value" for what each was built with. SETUP are shell files of ROS; a ROS 1 of the distribution's own packages,
# which has none, is found in /usr. Errors are in the last lines of standard error.
set -u
export LC_ALL=C
sources=$1 folder=$2 prefix=$3
shift 3
cd "$folder" || exit

fail() {
    echo "$1" >&2
    exit 1
}
# A compiler's errors begin before the end of what is printed, as several compile at a time. Without the colon, a line that
# names a source like errors.cpp would be one.
fail_with_log() {
    [ "$(df -Pk . | awk 'END {print $4}')" -ge 1024 ] || {
        rm -rf work-* stage # or there is no room for a word
        fail "the target's disk is full (df -h $folder)"
    }
    fail "$1:
$(sed -n '/CMake Error\|[Ee]rror: \|undefined reference/,$p' log | head -n 12 | cut -c 1-300 | grep . || tail -n 12 log)"
}

lacks=
for tool in cc c++ cmake; do
    command -v $tool >/dev/null || lacks="$lacks $tool"
done
command -v ninja >/dev/null || command -v make >/dev/null || lacks="$lacks make"
[ -z "$lacks" ] || fail "the target lacks$lacks: install build-essential and cmake, or what the target's system calls them"
command -v ninja >/dev/null && export CMAKE_GENERATOR=Ninja
if command -v ccache >/dev/null; then
    export CMAKE_C_COMPILER_LAUNCHER=ccache CMAKE_CXX_COMPILER_LAUNCHER=ccache CCACHE_BASEDIR="${prefix%/*}" CCACHE_NOHASHDIR=1
fi
# That of Debian's own packages.
ros1=/usr/share/roscpp/cmake
[ $# -gt 0 ] || [ -d $ros1 ] || fail "no ROS on the target: neither /opt/ros/*/setup.sh nor roscpp in /usr is there: \
install one, or name its setup.sh as ros_setup in the target file"
ros2=
for setup; do
    [ -r "$setup" ] || fail "$setup: no such file: name the setup.sh of a ROS as ros_setup in the target file"
    # shellcheck source=/dev/null
    case $(set +u && . "$setup" >&2 && echo "${ROS_VERSION:-}") in
    1) ros1= ;;
    2) ros2=$setup ;;
    *) fail "$setup sets up no ROS, by its ROS_VERSION: name the setup.sh of one as ros_setup in the target file" ;;
    esac
done
# A compiler may need as much as 1 GiB, for rclcpp's templates.
JOBS=$(awk -v cpus="$(nproc)" '/^MemAvailable/ {n = int($2 / 1048576)} END {print n < 1 ? 1 : n < cpus ? n : cpus}' /proc/meminfo)
export JOBS CFLAGS=-O2 CXXFLAGS=-O2

{
    echo "compiler $(c++ --version | head -n 1)"
    cmake --version | sed -n 's/^cmake version/cmake/p'
    echo "flags $CXXFLAGS"
    echo "sources ${sources##*/}"
} >built_with

build() {
    setup=$1 work=$2
    shift 2
    sh "$sources/build.sh" "$setup" "$folder/work-$work" "$folder/stage" "$@" >>built_with 2>log ||
        fail_with_log "the suites could not be built${setup:+ on $setup}"
}
build "" plain rt_tests_support rt_tests_sampler
# Over the DDS of a ROS 2, where there is one that has it.
[ -n "$ros2" ] || build "" plain transport_tests
suites=$(cd "$sources" && grep -l roscpp ./*/package.xml | sed 's,^[.]/,,; s,/.*,,')
number=0
for setup; do
    number=$((number + 1))
    # shellcheck disable=SC2086 # each word is a package
    build "$setup" $number $suites
    [ "$setup" != "$ros2" ] || build "$setup" transports transport_tests
done
# shellcheck disable=SC2086
[ ! -d "$ros1" ] || ROS_VERSION=1 build "" ros1 $suites

rm -rf "$prefix.new"
mkdir -p "$prefix.new/lib" && mv stage/lib/*_tests stage/lib/rt_tests_sampler "$prefix.new/lib" &&
    sort -u built_with >"$prefix.new/built_with" && rm -rf "$prefix" && mv "$prefix.new" "$prefix" || fail_with_log "cannot install"
