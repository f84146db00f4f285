#!/bin/sh
# Print the processes that map a file whose path matches, and their threads. probes/programs.py reads it.
#
#   find_programs.sh PATTERN [PROC...]     PATTERN as of grep -E; PROC are folders of processes [/proc/[0-9]*]
#
# For each process, between lines "program PID" and "end PID": parts of its files in /proc, each line behind a word that
# says of which. Its arguments are lines, in which a newline is the character 1. What ends meanwhile has less of them.
pattern=$1
shift
[ $# -gt 0 ] || set -- /proc/[0-9]*

for process; do echo "$process/maps"; done | xargs grep -lsE -- "$pattern" | while IFS=/ read -r _ _ pid _; do
    cd "/proc/$pid" || continue
    echo "program $pid"
    tr '\0\n' '\n\001' <cmdline | sed 's/^/argument /'
    echo
    sed -n 's/^VmLck:[[:blank:]]*/locked /p' status
    sed 's/^/stat /' task/[0-9]*/stat
    grep -sH '^Cpus_allowed_list:' task/[0-9]*/status | sed 's,^task/\([0-9]*\)/[^:]*:Cpus_allowed_list:,cpus \1 ,'
    grep -E -- "$pattern" maps | sed -n 's,^\([0-9a-f-]*\) ..xp [0-9a-f]* \([0-9a-f:]* [0-9]*\) *,maps \1 \2 ,p'
    echo "end $pid"
done 2>/dev/null
exit 0
