#!/bin/sh
# Print the threads whose loops are observed, a line "PID TID" each: those with a real-time policy first, then those of
# the programs that are named. Not the kernel's own threads.
#
#   find_threads.sh [NAMES]    NAMES: a line each, PROGRAM or PROGRAM/THREAD. PROGRAM is the name of a file; of a script
#                              for an interpreter, that of the script. THREAD is as in /proc/PID/task/TID/comm
#
# Standard input names the processes, a line "/proc/PID" each. Of a named program with real-time threads these alone are
# printed, unless its name has a THREAD.
names=${1-}
export LC_ALL=C
processes=$(cat)

# Fields 40 and 41 of stat are priority and policy: FIFO 1, RR 2, DEADLINE 6. Field 4 is the parent: 2 for threads of the
# kernel. A name may hold anything but has 15 bytes at most, so it cannot look like these fields.
list_stat() { printf '%s\n' "$processes" | while IFS= read -r process; do printf '%s\n' "$process"/task/[0-9]*/stat; done; }
real_time=$(list_stat | xargs grep -lsE '\) [A-Za-z] ([013-9]|[0-9]{2,})( -?[0-9]+){35} [0-9]+ [126]( |$)' |
    sed 's,^/proc/\([0-9]*\)/task/\([0-9]*\)/stat$,\1 \2,')
[ -z "$real_time" ] || printf '%s\n' "$real_time"
[ -n "$names" ] || exit 0

# Whether a process runs this program.
is_of() {
    file=$(readlink "/proc/$2/exe") || return 1
    file=${file%" (deleted)"}
    case ${file##*/} in
    "$1") ;;
    python*) tr '\0' '\n' <"/proc/$2/cmdline" | sed -n '2,20s,.*/,,;2,20p' | grep -qxF -e "$1" ;;
    *) return 1 ;;
    esac
}

printf '%s\n' "$names" | while IFS= read -r name; do
    program=${name%%/*}
    # The name is in the arguments, or begins with what the kernel calls the process. What only looks so is sorted out.
    printf '%s\n' "$processes" | sed 'h;s,$,/cmdline,p;g;s,$,/comm,' | xargs grep -lsF -e "$(printf '%.15s' "$program")" |
        sed 's,^/proc/\([0-9]*\)/.*,\1,' | sort -un | while read -r pid; do
        is_of "$program" "$pid" || continue
        case $name in
        */*) grep -lsxF -e "${name#*/}" "/proc/$pid"/task/[0-9]*/comm ;;
        *) case "
$real_time" in
            *"
$pid "*) ;;
            *) printf '%s\n' "/proc/$pid"/task/[0-9]* ;;
            esac ;;
        esac | sed 's,^/proc/\([0-9]*\)/task/\([0-9]*\).*,\1 \2,'
    done
done 2>/dev/null
exit 0
