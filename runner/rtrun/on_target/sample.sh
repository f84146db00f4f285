#!/bin/sh
# Observe what is in effect while a run measures, every two seconds, where the suites on the target lack rt_tests_sampler:
# that program does and prints the same for a fraction of the CPU time.
#
#   sample.sh FOLDER PRIORITY LOADS
#
# FOLDER is that of the run, whose programs are known by their NAME.pid (also the session). PRIORITY is that of the
# suite, LOADS the names of the background programs, separated by blanks. Prints for each observation a line
#   at UPTIME_S LOAD_1MIN TEMPERATURE_MC,.. FREQUENCY_KHZ,.. THEN THE FIRST LINE OF /proc/stat
#   counts NAME=NUMBER..
# with what was counted since the observation before, without zeros: context_switches, new_processes, interrupts,
# memory_stall_us (proc(5), "some" of Documentation/accounting/psi.rst), and each line of /proc/interrupts, as 24:eth0;
# and, where something has changed since the observation before, the present state, up to the line "end UPTIME_S": when all
# of it had been read, which on a busy target takes seconds:
#   thread PROGRAM TID POLICY PRIORITY CPUS NAME      each thread of the suite
#   load PROGRAM PROCESSES CPUS                       each background program
#   rival TID POLICY PRIORITY NAME                    every other thread of its priority or above; one at SCHED_DEADLINE
#                                                     (policy 6) has RUNTIME_NS/PERIOD_NS, or -, instead of a priority
#   governor NAME,..    sched_rt_runtime_us NUMBER
# Ends with the number of ENOSPC where the disk is full: what is printed after a gap would tell something else.
set -u
cd "$1" || exit 1
folder=$(pwd) priority=$2 loads=" $3 "
trap 'exit 0' TERM
# Not every busybox has nice or renice; chrt every target has.
renice -n 19 -p $$ >/dev/null 2>&1 || chrt --idle -p 0 $$

say() { printf '%s\n' "$@" || exit 28; }

joined() {
    joined=$(cat "$@" 2>/dev/null | tr '\n' ',')
    joined=${joined%,}
    echo "${joined:--}"
}

read_processes() {
    for file in *.pid; do
        read -r pid <"$file" && echo "session ${file%.pid} $pid"
    done 2>/dev/null
    # A thread that ends meanwhile is skipped in silence.
    grep -s '' /proc/[0-9]*/task/[0-9]*/stat
}

threads() {
    read_processes | awk -v priority="$priority" -v loads="$loads" '
        /^session / { program[$3] = $2; next }
        # A name may hold line ends: the first line of a thread begins with its number.
        {
            begin = index($0, ":"); begun = substr($0, 1, begin - 1)
            text = substr($0, begin + 1)
            split(begun, parts, "/")
            if (begun == file && index(text, parts[5] " (") != 1) { whole = whole "\\n" text; next }
            if (file != "") list(file, whole)
            file = begun; whole = text
        }
        END { if (file != "") list(file, whole) }
        function list(file, whole,    path, part, name, owner) {
            path = file; sub(/\/stat$/, "", path)
            split(path, part, "/")
            # The name itself may hold brackets.
            $0 = whole
            name = $0; sub(/^[^(]*\(/, "", name)
            sub(/.*\) /, "")
            name = substr(name, 1, length(name) - length($0) - 2)
            # From here $1 is field 3 of proc(5), the state: $4 the session, $38 and $39 the real-time priority and the
            # policy. Of a zombie they are those that it had, but it never runs again.
            if (NF < 39 || $1 ~ /^[ZXx]$/) return
            owner = program[$4]
            if (owner == "" && $39 == 6) print "rival", part[5], 6, "-", name
            else if (owner == "") { if ($38 >= priority && $38 > 0) print "rival", part[5], $39, $38, name }
            # supervise.sh and its watchdog, which sleeps and waits for a lock, are not the program that they started.
            else if (owner == "sampler" || name ~ /^(supervise[.]sh|sleep|flock)$/) return
            else if (index(loads, " " owner " ")) { if (part[3] == part[5]) print "process", owner, path }
            else print "thread", owner, part[5], $39, $38, path, name
        }'
}

# The budget of each thread at SCHED_DEADLINE that is listed; the chrt of busybox does not know it.
budgets() {
    for tid in $(printf '%s\n' "$1" | awk '$1 == "rival" && $3 == 6 { print $2 }'); do
        LC_ALL=C chrt -p "$tid" 2>/dev/null |
            sed -n "s|.* runtime/deadline/period parameters: \([0-9]*\)/[0-9]*/\([0-9]*\)$|budget $tid \1/\2|p"
    done
}

details() {
    awk '
        /^budget / { budget[$2] = $3; next }
        $1 == "rival" && ($2 in budget) { sub(/ 6 - /, " 6 " budget[$2] " ") }
        /^cpus / { sub(/\/status:.*/, "", $2); cpus[$2] = $4; next }
        $1 == "thread" { sub(" " $6 " ", " " (($6 in cpus) ? cpus[$6] : "-") " "); print; next }
        $1 == "process" { count[$2]++; if ($3 in cpus) load_cpus[$2] = cpus[$3]; next }
        { print }
        END { for (name in count) print "load", name, count[name], (name in load_cpus) ? load_cpus[name] : "-" }'
}

# Two lines: the totals, and what is above those of $1.
count() {
    cat /proc/stat /proc/pressure/memory /proc/interrupts 2>/dev/null | awk -v before="$1" '
        BEGIN {
            words = split(before, word, " ")
            for (i = 1; i <= words; i++) { name = word[i]; sub(/=.*/, "", name); sub(/.*=/, "", word[i]); old[name] = word[i] }
        }
        # As many names as the reader takes.
        function add(name, number) { if (number > 0 && (name in total || names++ < 511)) total[name] += number }
        $1 == "ctxt" { add("context_switches", $2) }
        $1 == "intr" { add("interrupts", $2) }
        $1 == "processes" { add("new_processes", $2) }
        $1 == "some" { sub(/.*total=/, ""); add("memory_stall_us", $1) }
        $1 ~ /^CPU[0-9]+$/ { cpus = NF; online = $0; gsub(/[ \t]+/, ",", online); next }
        cpus && $1 ~ /:$/ {
            number = 0
            for (i = 2; i <= cpus + 1 && $i ~ /^[0-9]+$/; i++) number += $i
            name = ($1 ~ /^[0-9]/) ? $1 $NF : $1
            sub(/:$/, "", name)
            gsub(/[^A-Za-z0-9_.:-]/, "_", name)
            name = substr(name, 1, 32)
            of_cpus[name]
            add(name, number)
        }
        END {
            # What a CPU had counted before it went offline is counted again once it is back, and is not new.
            totals = " /online=" online
            are_same_cpus = online == old["/online"]
            for (name in total) {
                totals = totals " " name "=" sprintf("%.0f", total[name])
                new = total[name] - old[name]
                if (words && new > 0 && (are_same_cpus || !(name in of_cpus))) more = more " " name "=" sprintf("%.0f", new)
            }
            print totals
            print "counts" more
        }'
}

before=
counted=
newline='
'
pause=1
while :; do
    # The observation must not see processes of its own. With wait, TERM ends the pause at once.
    sleep $pause &
    wait $!
    pause=2
    [ -d "$folder" ] || exit 0
    read -r uptime _ </proc/uptime
    read -r load _ </proc/loadavg
    read -r busy </proc/stat
    # Not within the line that is printed: TERM ends $( ) at once, and the shell only after its present command.
    temperature=$(joined /sys/class/thermal/thermal_zone[0-9]*/temp)
    frequency=$(joined /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_cur_freq)
    counts=$(count "$counted")
    counted=${counts%%"$newline"*}
    say "at $uptime $load $temperature $frequency $busy" "${counts#*"$newline"}"
    listed=$(threads)
    # The CPUs of one process of each load are enough: its other processes inherit them.
    # Names may hold backslashes, which echo would read.
    paths=$(printf '%s\n' "$listed" | awk '$1 == "thread" { print $6 "/status" } $1 == "process" && !seen[$2]++ { print $3 "/status" }')
    # shellcheck disable=SC2086 # the words of the list are wanted
    now=$({
        [ -z "$paths" ] || grep -sH Cpus_allowed_list: $paths | sed 's/^/cpus /; s/Cpus_allowed_list:/ x /'
        budgets "$listed"
        # Nothing is listed where the kernel threads are hidden, as in a container, and no program has begun.
        [ -z "$listed" ] || printf '%s\n' "$listed"
    } | details
        echo "governor $(joined /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor)"
        echo "sched_rt_runtime_us $(joined /proc/sys/kernel/sched_rt_runtime_us)")
    if [ "$now" != "$before" ]; then
        read -r until _ </proc/uptime
        say "$now" "end $until"
        before=$now
    fi
done
