#!/bin/sh
# Print what the control groups of a process, and those above them, let it have of a CPU, and how often that was used up.
#
#   cgroups.sh [PROC]      PROC is the folder of the process in /proc [/proc/self]
#
# For each group a line "group VERSION PATH", the lowest first, then a line "FILE VALUE" for each limit and "cpu.stat NAME
# NUMBER" for each count. Nothing but a POSIX shell is needed.
proc=${1:-/proc/self}

# The limits in a folder of a group.
limits() {
    for file in cpu.rt_runtime_us cpu.rt_period_us cpu.cfs_quota_us cpu.cfs_period_us cpu.max; do
        [ -r "$1/$file" ] && { read -r value <"$1/$file"; printf '%s\n' "$file $value"; }
    done
    [ -r "$1/cpu.stat" ] || return 0
    while read -r name value; do
        case $name in nr_periods | nr_throttled | throttled_time | throttled_usec) printf '%s\n' "cpu.stat $name $value" ;; esac
    done <"$1/cpu.stat"
}

# A mounted hierarchy: its version, the group that is at its top, and where it is mounted.
hierarchy() {
    while IFS=: read -r id controllers path; do
        case $1 in
        1) case ",$controllers," in *,cpu,*) ;; *) continue ;; esac ;;
        2) [ "$id" = 0 ] || continue ;;
        esac
        # A container may see its own group at the top, and have the whole path all the same.
        top=${2%/}
        below=${path#"$top"}
        below=${below%/}
        [ -d "$3$below" ] || below=
        # Made by processes.sh, without limits of its own.
        case $below in */rtrun-????????-????-????-????-????????????) below=${below%/*} ;; esac
        while :; do
            group=$top$below
            # Names may hold backslashes, which echo would read.
            printf '%s\n' "group $1 ${group:-/}"
            limits "$3$below"
            [ -n "$below" ] || break
            below=${below%/*}
        done
    done <"$proc/cgroup"
}

# proc(5): the root of the mount is the 4th field, its place the 5th; after a dash come type, source and options.
[ -r "$proc/mountinfo" ] && [ -r "$proc/cgroup" ] && while read -r _ _ _ root place rest; do
    rest=${rest#*- }
    case $rest in
    "cgroup2 "*) hierarchy 2 "$root" "$place" ;;
    "cgroup "*) case ",${rest##* }," in *,cpu,*) hierarchy 1 "$root" "$place" ;; esac ;;
    esac
done <"$proc/mountinfo" 2>/dev/null
