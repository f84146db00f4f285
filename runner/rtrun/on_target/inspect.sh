#!/bin/sh
# Print what the runner needs to know before it can use this target: one line "name value" for each fact.
#   inspect.sh WORK_DIR ROS_SETUP
# The scripts of middlewares, which come after this in the same shell, look beside the file that sets up ROS; empty: where
# their own packages are.
# shellcheck disable=SC2034 # they read it
ros_setup=${2-}
for tool in setsid flock sha256sum md5sum chrt sed; do
    command -v $tool >/dev/null || echo "missing $tool"
done
# A lock tells whether a program lives: where locking fails, everything would seem to run for ever. A lock that is taken
# fails in silence.
if command -v flock >/dev/null; then
    message=$(flock -n -s "$1/.rt-tests" true 2>&1) || [ -z "$message" ] || echo "no_locks $message" | head -n 1
fi
# Those that build_suites.sh built come before others.
for lib in "$1/built/lib" /usr/lib; do
    for program in "$lib"/*_tests/*_tests* "$lib"/*_tests/topology_node* "$lib/rt_tests_sampler/rt_tests_sampler"; do
        [ -x "$program" ] && echo "program $program"
    done
done
head -n 32 "$1/built/built_with" 2>/dev/null | sed 's/^/built /'
# The ELF header of a program of the target's own, in hexadecimal.
# shellcheck disable=SC2046 # several lines become one
echo elf $(od -An -tx1 -N20 /bin/sh 2>/dev/null || hexdump -n 20 -e '20/1 "%02x "' /bin/sh 2>/dev/null)
# Debian's release decides which libraries there are. In a shell of its own, as the file sets variables.
# shellcheck source=/dev/null
(. /etc/os-release && [ "$ID" = debian ] && echo "debian $VERSION_CODENAME") 2>/dev/null
echo "cpus $(grep -c '^processor' /proc/cpuinfo)"
# shellcheck disable=SC2046 # the words of the line are wanted
set -- $(df -Pk "$1" | tail -n 1)
echo "free_kib $4"
# What follows is of each middleware: middleware/<name>.sh.
