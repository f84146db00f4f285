#!/bin/sh
# The processes of what was started here: which they are, and how they are ended. Functions only: supervise.sh and
# watch_probes.sh read this file, and targets/groups.py puts it before the commands that it sends.
#
# A process belongs to a program where nobody else could make it look so:
#   - it is in the control group that was made for the program, or below it; or, where the target gives none,
#   - it has the secret of the program in its environment, or its parent does. The secret stands in no command line, and
#     who is neither the user of the program nor root cannot read an environment. Or it is of the session of the
#     program's supervisor and holds the program's lock, which others cannot open.
# `known_by` of a program is a line: the folder of its group, or its secret. NAME.known_by in the folder of a run holds
# it, and is for nobody else to read.
#
# Numbers of processes are used again: a process is PID:START here, with the ticks from the boot to its start.

# Nothing is read from the memory of another user's process, as /proc/PID/environ and cmdline are: he can let the reader
# wait for ever, for a file system (FUSE) of his own.

# Of a process: its state, parent, process group, session, number of threads and start. Its name may hold anything, brackets and lines too:
# the fields stand behind the last bracket of the last line (proc(5)).
look() {
    fields=
    while IFS= read -r line || [ -n "$line" ]; do fields=$line; done <"/proc/$1/stat" || return 1
    # shellcheck disable=SC2086 # without the name there are numbers and a letter
    set -- ${fields##*) }
    [ $# -ge 20 ] || return 1
    state=$1 parent=$2 process_group=$3 session=$4 threads=${18} start=${20}
} 2>/dev/null

# Whether PID:START lives. The first thread of a process may end before the others.
is_alive() {
    look "${1%:*}" && [ "$start" = "${1#*:}" ] || return 1
    case $state in [ZX]) [ "$threads" -gt 1 ] ;; esac
}

# Whether a process is of root or of this user.
is_trusted() {
    while read -r key _ user _; do
        [ "$key" != Uid: ] || break
    done <"/proc/$1/status"
    [ "$user" = 0 ] || [ "$user" = "${me:=$(id -u)}" ]
} 2>/dev/null

# Signal a process, PID:START.
send() { is_alive "$2" && kill "-$1" "${2%:*}" 2>/dev/null; }

# Signal a child of this shell, or of the subshell $3. Nobody else's process can be one.
send_child() { look "$2" && [ "$parent" = "${3:-$$}" ] && kill "-$1" "$2" 2>/dev/null; }

# Make a control group for a program, and set `known_by`; a secret where none can be made. The group is below that of this
# shell, and changes nothing but that: with controllers the program would be measured with other shares of the CPUs than
# it has by itself. It gets none in version 2 below a group that hands none down, and in the hierarchies of version 1
# that limit nothing.
mark() {
    read -r uuid </proc/sys/kernel/random/uuid || return 1
    while read -r _ _ _ root place rest; do
        rest=${rest#*- }
        while IFS=: read -r _ controllers path; do
            case "${rest%% *} $controllers" in
            "cgroup2 ") ;;
            "cgroup name="* | "cgroup freezer") case ",${rest##* }," in *",$controllers,"*) ;; *) continue ;; esac ;;
            *) continue ;;
            esac
            # A container may see its own group at the top, and have the whole path all the same.
            for above in "$place${path#"${root%/}"}" "$place"; do
                above=${above%/}
                grep -qx $$ "$above/cgroup.procs" || continue
                handed_down=
                [ ! -e "$above/cgroup.subtree_control" ] || read -r handed_down <"$above/cgroup.subtree_control"
                group=$above/rtrun-$uuid
                [ -z "$handed_down" ] && mkdir "$group" || continue
                # Whether a process may go there is seen when one does.
                if (join "$group"); then
                    known_by=$group
                    # The kernel would count the stalls of the group at each change of threads.
                    echo 0 >"$group/cgroup.pressure"
                    return 0
                fi
                rmdir "$group"
            done
        done </proc/self/cgroup
    done </proc/self/mountinfo
    known_by=RTRUN_PROGRAM=$uuid
} 2>/dev/null

# Put this process, or subshell, into a control group.
join() { echo 0 >"$1/cgroup.procs"; } 2>/dev/null

# Set `known_by`, `lock` and `leader`, which is the session, from the files of the program NAME in this folder.
know() {
    known_by= leader= lock=$PWD/$1.lock
    IFS= read -r known_by <"$1.known_by" || known_by=
    read -r leader <"$1.pid" || leader=
    # Whatever the file holds: nothing is ended but what is in a group that was made here, or has a whole secret.
    case ${known_by##*[/=]} in
    rtrun-????????-????-????-????-???????????? | ????????-????-????-????-????????????) ;;
    *) known_by= ;;
    esac
    case $known_by in
    */../*) known_by= ;;
    /*/rtrun-*) [ -e "$known_by/cgroup.procs" ] || known_by= ;;
    RTRUN_PROGRAM=*) ;;
    *) known_by= ;;
    esac
} 2>/dev/null

# Whether a thread has the secret.
has_secret() {
    # The kernel's own threads run no program.
    is_trusted "$1" && [ -e "/proc/$1/exe" ] || return 1
    # A search program would have the secret in its command line, and that of busybox reads to the first variable only.
    case $(tr '\0' '\n' <"/proc/$1/environ") in *"$known_by"*) ;; *) return 1 ;; esac
} 2>/dev/null

# Whether a process itself is known to be of the program, not by its parent.
is_marked() {
    case $known_by in
    /*) is_in_group "$1" ;;
    ?*)
        look "$1" || return 1
        thread=/proc/$1
        # What belongs to the process is shown by the threads that live.
        [ "$state" != Z ] || for thread in "/proc/$1/task"/*; do [ ! -e "$thread/exe" ] || break; done
        { [ "$session" = "$leader" ] && [ "$thread/fd/9" -ef "$lock" ]; } || has_secret "${thread#/proc/}"
        ;;
    *) return 1 ;;
    esac
}

# Print the numbers of the processes in the group, or below it. How a process names its group in /proc is no proof: others
# may have a group of the same name.
list_group() { find "$known_by" -name cgroup.procs -exec cat {} + 2>/dev/null; }

is_in_group() { list_group | grep -qx "$1"; }

# Print the processes of the program that `known_by` tells from all others, a line each. $spared and what it has started
# are not among them, nor this shell.
list_processes() {
    case $known_by in
    /*)
        # One that was in the group after its start was read is the one that started then, if it still lives.
        seen=" $(list_group | while read -r pid; do look "$pid" && echo "$pid:$start"; done | tr '\n' ' ')"
        list_group | while read -r pid; do
            case $seen in *" $pid:"*) first=${seen#*" $pid:"} && echo "$pid:${first%% *}" ;; esac
        done
        ;;
    RTRUN_PROGRAM=*)
        for process in /proc/[0-9]*; do echo "$process/status"; done |
            xargs grep -s '^PPid:' /dev/null | sed 's,^/proc/\([0-9]*\)/status:PPid:[[:blank:]]*,\1 ,' |
            while read -r pid ppid; do
                if is_marked "$pid"; then echo "$pid $ppid marked"; else echo "$pid $ppid"; fi
            done | awk '
                { parent[$1] = $2 }
                $3 { ours[$1] }
                END {
                    do {
                        found = 0
                        for (pid in parent) if (!(pid in ours) && (parent[pid] in ours)) { ours[pid]; by[pid] = parent[pid]; found = 1 }
                    } while (found)
                    for (pid in ours) print pid, by[pid]
                }' | while read -r pid by; do
            # It may have ended, and its number be another's, since. Only one that is a child still was one of that parent.
            look "$pid" || continue
            first=$start
            if [ -n "$by" ]; then [ "$parent" = "$by" ]; else is_marked "$pid"; fi && echo "$pid:$first"
        done
        ;;
    esac | while read -r pid_start; do
        is_alive "$pid_start" && ! is_spared "${pid_start%:*}" && echo "$pid_start"
    done
}

is_spared() {
    [ "$1" != $$ ] || return 0
    ancestor=$1
    while [ -n "${spared:-}" ] && [ "$ancestor" -gt 1 ]; do
        [ "$ancestor" != "$spared" ] || return 0
        look "$ancestor" || return 0
        ancestor=$parent
    done
    return 1
}

# Those of these processes that do not ignore SIGINT, which is the bit of 2: a shell in the background lets its programs
# ignore it, and those of ROS set that right.
listening() {
    for pid_start; do
        case $(sed -n 's/^SigIgn:.*\(.\)$/\1/p' "/proc/${pid_start%:*}/status" 2>/dev/null) in
        [014589cd]) echo "$pid_start" ;;
        esac
    done
}

# Let the processes of the group stand still (FROZEN), or go on (THAWED): those that fork and end faster than they are
# listed would never be found. A group that this process is in is left alone, and so is one that knows no freezing.
freeze() {
    case $known_by in /*) ;; *) return 0 ;; esac
    ! is_in_group "${spared:-$$}" || return 0
    [ "$1" = FROZEN ] && frozen=1 || frozen=0
    find "$known_by" -name cgroup.freeze -o -name freezer.state | while read -r file; do
        case $file in */cgroup.freeze) echo $frozen >"$file" && continue ;; esac
        echo "$1" >"$file"
        # It is so when a look at it says so.
        for _ in 1 2 3 4 5; do
            read -r word <"$file" && [ "$word" != "$1" ] || break
            sleep 0.1
        done
    done
} 2>/dev/null

# End the processes of programs, and print those that stay.
#   end_processes STAGES EACH
# STAGES are signals with the tenths of a second that each may take: "TERM:20 KILL:10". EACH calls a function of this file
# for each program: `this` for the one that is known.
end_processes() {
    known=
    for stage in $1; do
        signal=${stage%:*} tries=${stage#*:} sent=
        while :; do
            [ "$signal" != KILL ] || $2 freeze FROZEN
            # What is a program's once is so still when it has lost its parent.
            for pid_start in $($2 list_processes); do
                case " $known " in *" $pid_start "*) ;; *) known="$known $pid_start" ;; esac
            done
            keep_living
            for pid_start in $known; do
                # Each signal once: a second Ctrl-C tells many programs to leave everything as it is.
                case " $sent " in *" $pid_start "*) ;; *) send "$signal" "$pid_start" ;; esac
                sent="$sent $pid_start"
            done
            [ "$signal" != KILL ] || $2 freeze THAWED
            [ -n "$known" ] || break
            while [ -n "$known" ]; do
                # shellcheck disable=SC2086 # numbers
                [ "$signal" != INT ] || [ -n "$(listening $known)" ] || break 2
                [ "$tries" -gt 0 ] || break 2
                sleep 0.1
                tries=$((tries - 1))
                keep_living
            done
        done
    done
    for pid_start in $known; do echo "$pid_start"; done
}

this() { "$@"; }

keep_living() {
    # shellcheck disable=SC2086
    set -- $known
    known=
    for pid_start; do if is_alive "$pid_start"; then known="$known $pid_start"; fi; done
}

# Remove the control group of a program that has ended.
remove_group() {
    case $known_by in /*) find "$known_by" -depth -type d -exec rmdir {} \; ;; esac
} 2>/dev/null

# Print what holds the lock of a program, each PID:START.
list_holders() {
    for process in /proc/[0-9]*; do
        [ "$process/fd/9" -ef "$lock" ] && look "${process#/proc/}" && echo "${process#/proc/}:$start"
    done
} 2>/dev/null

# A line "PID NAME" for each process. A name is any bytes.
name_processes() {
    for pid_start; do
        echo "${pid_start%:*} $(LC_ALL=C tr -c '[:alnum:] ._:/@+-' '?' <"/proc/${pid_start%:*}/comm")" | sed 's/?$//'
    done
} 2>/dev/null

# Whether a process group has a marked process: it was made by what was started here then, as nobody can join the group of
# another session.
is_our_group() {
    [ "$1" -gt 1 ] || return 1
    for process in /proc/[0-9]*; do
        look "${process#/proc/}" && [ "$process_group" = "$1" ] && is_marked "${process#/proc/}" && return
    done
    return 1
} 2>/dev/null

# Set `group` to that of the program NAME, whose supervisor leads it.
find_group() { know "$1" && group=$leader && is_our_group "$group"; } 2>/dev/null

# Print the locks below a folder whose programs live, each once. Programs are looked for among the processes: whatever lies
# in the folders of runs, those are few. /proc shows the path that has no links. Which files a process of another user has
# open it does not show, but how supervise.sh was called. A lock that is free is only named so.
living() {
    below=$(cd "$1" 2>/dev/null && pwd -P) || return 0
    {
        LC_ALL=C ls -l /proc/[0-9]*/fd/9 2>/dev/null | sed -n 's,^.* -> ,,p'
        for process in /proc/[0-9]*; do
            [ -r "$process/fd" ] || ! is_trusted "${process#/proc/}" || echo "$process/cmdline"
        done | xargs grep -lsF "$below/" /dev/null | while IFS= read -r call; do
            tr '\0' '\n' <"$call" | sed -n '/\/supervise[.]sh$/{n;N;s,\n,/,;s,$,.lock,p;q;}'
        done 2>/dev/null
    } | sort -u | while IFS= read -r lock; do
        case $lock in
        # Anybody may start a program of root (setuid) with such words.
        */../*) ;;
        "$below"/*.lock) [ -f "$lock" ] && { flock -n -s "$lock" true || echo "$lock"; } ;;
        esac
    done 2>/dev/null
}
