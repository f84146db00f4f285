#!/bin/sh
# The user's system: run by its command, and ended with everything that it started, in whatever session.
#
#   system.sh run MARK COMMAND   run COMMAND by sh, in the home folder; it and what it starts have RTRUN_SYSTEM=MARK in
#                                their environment. On SIGTERM all of that is ended.
#   system.sh pids MARK          print the processes that have it, and their children
#   system.sh end MARK           end them: as Ctrl-C does first, then by SIGTERM, at last by SIGKILL; print those that stay
#
# MARK is of one run alone, and ends with a slash, so that none is the beginning of another.
set -u
mark=$2

# A program may have cleared its environment: it is known by its parent then. Of a process: its parent and its state.
pids() {
    {
        grep -lsF "RTRUN_SYSTEM=$mark" /proc/[0-9]*/environ | sed 's,^/proc/\([0-9]*\)/.*,marked \1,'
        # Names may hold blanks and brackets.
        cat /proc/[0-9]*/stat 2>/dev/null | sed -n 's/^\([0-9]*\) (.*) \([A-Za-z]\) \([0-9]*\) .*/\1 \2 \3/p'
    } | awk '
        $1 == "marked" { ours[$2]; next }
        { state[$1] = $2; parent[$1] = $3 }
        END {
            do {
                found = 0
                for (pid in parent) if (!(pid in ours) && (parent[pid] in ours)) { ours[pid]; found = 1 }
            } while (found)
            for (pid in ours) if ((pid in state) && state[pid] != "Z" && state[pid] != "X") print pid
        }'
}

# Those of these processes that do not ignore SIGINT, which is the bit of 2: a shell in the background lets its programs
# ignore it, and those of ROS set that right.
listening() {
    for pid; do
        case $(sed -n 's/^SigIgn:.*\(.\)$/\1/p' "/proc/$pid/status" 2>/dev/null) in
        [014589cd]) echo "$pid" ;;
        esac
    done
}

# The seconds are for what puts something right at its end: a driver that stops its motors.
end() {
    for each in INT:10 TERM:5 KILL:2; do
        signal=${each%:*} tries=$((${each#*:} * 5)) number=0
        while [ $number -lt $tries ]; do
            left=$(pids)
            [ -n "$left" ] || return 0
            # shellcheck disable=SC2086 # numbers
            [ $signal != INT ] || [ -n "$(listening $left)" ] || break
            # shellcheck disable=SC2086
            if [ $number -eq 0 ] || [ $signal = KILL ]; then kill -$signal $left 2>/dev/null; fi
            sleep 0.2
            number=$((number + 1))
        done
    done
    pids
}

case $1 in
run)
    cd "${HOME:-/}" || cd /
    trap '' INT
    # Whoever ends this one kills it soon.
    trap 'setsid "$0" end "$mark" >/dev/null 2>&1 9>&- &' TERM
    RTRUN_SYSTEM=$mark sh -c "$3" &
    wait $!
    status=$?
    exit $status
    ;;
pids) pids ;;
end) end ;;
esac
