#!/bin/sh
# Run one program detached from the connection that starts it, so that a lost link does not end a measurement.
#
#   supervise.sh FOLDER NAME DEADLINE_S SETUP PROGRAM [ARGUMENT...]
#
# SETUP is a shell file to read first, or empty. In FOLDER stand afterwards NAME.boot_id, NAME.known_by (processes.sh),
# NAME.pid (also the process group), NAME.stdout, NAME.stderr, NAME.cgroups (cgroups.sh before and after it), NAME.expired
# when the deadline ended it, and last NAME.exit with the exit status and the time since the boot in seconds.
# NAME.lock is held as long as a process of it lives: waiting for the lock costs the target nothing. NAME.supervised is held
# by its supervisor alone. Where that is killed, the program has no deadline any more, and is ended.
# A program that was started already is not started again, so the caller may repeat the call after a lost link.
set -u
# shellcheck source=runner/rtrun/on_target/processes.sh
. "${0%/*}/processes.sh"
cd "$1" || exit 1
name=$2

if [ "${RTRUN_INSIDE:-}" != 1 ]; then
    [ -e "$name.boot_id" ] && exit 0
    # Whoever opens a lock can hold it, or give it to others; whoever reads what a program is known by can have it too.
    (umask 077 && : >>"$name.lock" && : >>"$name.supervised" && : >"$name.known_by.new") || exit 1
    exec 9>"$name.lock"
    # A caller that tests whether the program lives takes the lock for a moment.
    for pause in 0 0.1 0.2 0.4 taken; do
        flock -n 9 && break
        [ $pause != taken ] || exit 0
        sleep $pause
    done
    # The program may have run and ended while this waited for the lock. In a folder that was given up nothing starts.
    { [ -e "$name.boot_id" ] || [ -e given_up ]; } && exit 0
    # Room for its process id, without which nobody can end it, and for the exit status: a run that is whole must not be
    # lost to a disk that is full when it ends.
    for file in pid exit; do
        printf '%40s\n' '' >"$name.$file.new" ||
            { echo "no room for the $file file of $name: is the disk full (df -h)?" >&2; exit 1; }
    done
    mark
    printf '%s\n' "$known_by" >"$name.known_by.new" && mv "$name.known_by.new" "$name.known_by" || {
        remove_group
        echo "no room for the known_by file of $name: is the disk full (df -h)?" >&2
        exit 1
    }
    exec 8>"$name.supervised"
    flock 8
    cat /proc/sys/kernel/random/boot_id >"$name.boot_id.new" && mv "$name.boot_id.new" "$name.boot_id" || exit 1
    # After a power cut the runner must see that this run was cut off.
    sync "$name.boot_id" .
    # What kills the command that called this must not take it for that.
    unset RTRUN_COMMAND
    case $known_by in
    /*) RTRUN_INSIDE=1 ;;
    *) RTRUN_INSIDE=1 && export "$known_by" ;;
    esac
    export RTRUN_INSIDE
    (
        case $known_by in /*) join "$known_by" || exit 1 ;; esac
        exec setsid "$0" "$@"
    ) </dev/null >/dev/null 2>&1 &
    exit 0
fi

# The folder may have been given up and made anew since this was called.
{ [ -e "$name.boot_id" ] && [ ! -e given_up ]; } || exit 1
deadline_s=$3 setup=$4
shift 4
unset RTRUN_INSIDE RTRUN_COMMAND
# Only now is this process the leader of its session, so that its pid names the process group. It is written over the
# blanks: more room there may not be.
echo $$ 1<>"$name.pid.new" && mv "$name.pid.new" "$name.pid"
if [ -n "$setup" ]; then
    set +u
    # shellcheck disable=SC1090
    . "$setup"
    set -u
fi

know "$name"
# Ends the program at its deadline, and when the supervisor was killed. It ends by itself when that has ended.
watch() {
    # It is no part of what lives: of that 9 tells, and to the lock of all builds 7.
    exec 7>&- 8>&- 9>&-
    read -r spared _ </proc/self/stat
    # Nor does it stand still when the group does.
    case $known_by in /*) join "${known_by%/*}" ;; esac
    sleep "$deadline_s" &
    sleeper=$!
    { flock "$name.supervised" true; send_child KILL $sleeper "$spared"; } &
    if wait $sleeper; then
        # true, not ":": a shell exits where a special builtin cannot open its file, and the program would run on.
        true >"$name.expired"
        end_processes "TERM:50 KILL:20" this
        wait
    elif ! [ -e "$name.exit" ]; then
        end_processes "TERM:50 KILL:20" this
    fi >/dev/null
    remove_group
} 2>/dev/null

"${0%/*}/cgroups.sh" >"$name.cgroups" 2>/dev/null
# Before the program: that may kill this shell at once.
watch &
"$@" </dev/null >"$name.stdout" 2>"$name.stderr" 8>&- &
program=$!

wait $program
status=$?
read -r uptime _ </proc/uptime
{ echo "== after"; "${0%/*}/cgroups.sh"; } >>"$name.cgroups" 2>/dev/null
echo "$status $uptime" 1<>"$name.exit.new" && mv "$name.exit.new" "$name.exit"
