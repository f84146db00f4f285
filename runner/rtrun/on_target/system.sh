#!/bin/sh
# The user's system: run by its command, and ended with everything that it started, in whatever session.
#
#   system.sh run FOLDER COMMAND   run COMMAND by sh, in the home folder; it and what it starts have a secret in their
#                                  environment. On SIGTERM all of that is ended.
#   system.sh pids FOLDER          print the processes that have it, and their children
#   system.sh end FOLDER           end them: as Ctrl-C does first, then by SIGTERM, finally by SIGKILL; print those that stay
#
# FOLDER is that of the run. The secret is in a file there that only this user can read, and in no command line: whoever
# knew it could let root end any process as a child of theirs.
set -u
folder=$2
file=$folder/system.secret

# Set `secret` to that of the run; it stays empty where there is none.
read_secret() {
    secret=${RTRUN_SECRET:-}
    [ -n "$secret" ] || IFS= read -r secret <"$file" || secret=
    # Whatever the file holds: an empty pattern would be found in every process.
    case ${secret##*/} in ????????-????-????-????-????????????) ;; *) secret= ;; esac
} 2>/dev/null

# A program may have cleared its environment: it is known by its parent then. Names of processes may hold anything, line
# ends as well; in `status` they are escaped.
pids() {
    read_secret
    [ -n "$secret" ] || return 0
    {
        printf '%s\n' "RTRUN_SYSTEM=$secret" | grep -lsFf - /proc/[0-9]*/environ | sed 's,^/proc/\([0-9]*\)/.*,\1 marked,'
        grep -s -e '^PPid:' -e '^State:' /proc/[0-9]*/status | sed 's,^/proc/\([0-9]*\)/status:,\1 ,'
    } | awk '
        $2 == "marked" { ours[$1] }
        $2 == "State:" { state[$1] = $3 }
        $2 == "PPid:" { parent[$1] = $3 }
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
    campaign=${folder%/*}
    read -r secret </proc/sys/kernel/random/uuid || exit 1
    secret=${campaign##*/}/${folder##*/}/$secret
    # Of an attempt before nothing lives.
    rm -f "$file"
    (umask 077 && printf '%s\n' "$secret" >"$file") || exit 1
    # Whoever ends this one kills it soon, and removes the folder.
    trap 'RTRUN_SECRET=$secret setsid "$0" end "$folder" >/dev/null 2>&1 9>&- &' TERM
    RTRUN_SYSTEM=$secret sh -c "$3" &
    wait $!
    status=$?
    exit $status
    ;;
pids) pids ;;
end) end ;;
esac
