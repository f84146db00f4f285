#!/bin/sh
# Place probes in a trace of their own, print what they record once a second, and take everything off when the standard
# input ends: the runner was killed, or the link was cut. probes/stream.py reads what is printed.
#
#   watch_probes.sh SECONDS SILENCE BUFFER_KB LIMIT PATTERN [EVENT...]
#       SECONDS    after which everything is taken off in any case
#       SILENCE    seconds without a line after which it is taken off as well, with exit status 4: a link may be dead
#                  without an end. At the end, seconds in which the last events have to be read
#       BUFFER_KB  of memory for each CPU
#       LIMIT      events in a second; above it the probes rest for a share of the time
#       PATTERN    for find_programs.sh beside this file
#       EVENT      of the kernel, below `events` in tracefs, recorded as well; left out where the kernel does not have it
#
# Standard input: a line "p NAME SHA256 PATH:OFFSET ARGUMENT..." for each probe, "watch PID..." for the programs
# whose threads are to be told, "raw" if CLOCK_MONOTONIC_RAW is to be read, "loops LIMIT ADDRESS..." where loops are to be
# observed, "go"; then a line now and then, as long as the probes are to stay. SHA256 is of the first 64 MiB of the file at
# PATH. While there are threads with loops, there may be LIMIT more events in a second. ADDRESS is of a function of the
# kernel that the timer of a sleeping thread calls. "name NAME" is a name for find_threads.sh, in which a blank is the
# character 1.
# Of loops the events in $loop_events are recorded, for their threads alone unless there is an EVENT.
#
# The names of trace and probes tell which process takes them off: "rtrun-observe-" and "rtrun_observe_", then its
# namespace, pid and start time. What a killed one has left is removed at the next start; other names are left alone.
set -u
scripts=${0%/*}
# shellcheck source=runner/rtrun/on_target/processes.sh
. "$scripts/processes.sh"
case $1 in
inside) shift ;;
*)
    command -v setsid >/dev/null || { echo "observing needs the program setsid on the target" >&2; exit 3; }
    # In a session of its own: whoever kills a command kills its group, and this one has to live on to clean up.
    exec 3<&0
    setsid "$0" inside "$@" <&3 3<&- &
    inside=$!
    trap 'send_child TERM $inside' TERM HUP INT
    wait $inside
    status=$?
    # A signal ends `wait` early.
    [ $status -le 128 ] || { wait $inside; status=$?; }
    exit $status
    ;;
esac
seconds=$1 silence=$2 buffer_kb=$3 limit=$4 pattern=$5
shift 5
events=$*
tracing=/sys/kernel/tracing
# What a sleep and its end are read from (probes/loop_events.py).
loop_events="timer/hrtimer_start timer/hrtimer_expire_entry sched/sched_waking sched/sched_switch"
is_filtered=
# The events of so many threads: the kernel takes a filter of a page.
followed_max=100
# Whoever reads may go away: a failed print ends what prints, not this.
trap '' PIPE

fail() {
    echo "$1" >&2
    exit "${2:-3}"
}

# The start time of a process, in ticks since the boot.
started() { if look "$1"; then echo "$start"; fi; }

# Whether the process in a name has ended. Processes of another namespace cannot be seen from here.
is_gone() {
    rest=${1#raw_}
    case $rest in
    "${namespace}"_[0-9]*_[0-9]*) ;;
    *) return 1 ;;
    esac
    rest=${rest#*_}
    [ "$(started "${rest%_*}")" != "${rest#*_}" ]
}

# Open a file as 5, where it is the one whose functions are known. The kernel is told that open file and no path: whoever
# may give the path another meaning, as the owner of a program that is observed, would have a probe placed anywhere in any
# file, and so change what programs of root do.
open_library() {
    [ "$opened" != "$*" ] || return 0
    opened=
    [ -f "$2" ] && command exec 5<"$2" || return 1
    digest=$(head -c 67108864 <&5 | sha256sum)
    [ "${digest%% *}" = "$1" ] && opened="$*"
} 2>/dev/null

# Take off what has a name. Of several tries: what still reads a page keeps its trace busy.
remove() {
    old=$tracing/instances/rtrun-observe-$1
    if [ -d "$old" ]; then
        echo 0 >"$old/tracing_on"
        echo 0 >"$old/events/enable"
        for _ in 1 2 3 4 5 6 7 8 9 10; do
            rmdir "$old" && break
            sleep 0.1
        done
    fi
    sed -n "s,^[pr][0-9]*:\(rtrun_observe_$1/[^ ]*\) .*,-:\1,p" $tracing/uprobe_events | sort -u | while read -r line; do
        echo "$line" >>$tracing/uprobe_events
    done
    ! [ -d "$old" ] && ! grep -q ":rtrun_observe_$1/" $tracing/uprobe_events
} 2>/dev/null

remove_leftovers() {
    {
        for leftover in $tracing/instances/rtrun-observe-*; do echo "${leftover##*/rtrun-observe-}"; done
        sed -n 's,^[pr][0-9]*:rtrun_observe_\([^/]*\)/.*,\1,p' $tracing/uprobe_events
    } | sort -u | while read -r old_name; do
        if is_gone "$old_name"; then remove "$old_name"; fi
    done
}

mark() {
    echo "rtrun $1" >"$instance/trace_marker"
} 2>/dev/null

# Of the buffer of a CPU: entries, overrun, bytes, dropped, read.
statistics() {
    while IFS=: read -r key value; do
        case $key in
        entries) entries=${value# } ;;
        overrun) overrun=${value# } ;;
        bytes) bytes=${value# } ;;
        "dropped events") dropped=${value# } ;;
        "read events") read=${value# } ;;
        esac
    done <"$1/stats"
}

# Only what is there already is read: to read more would be to wait for it. Of a page there are at most $data_bytes.
print_cpu() {
    statistics "$1"
    total=$((total + entries + read + overrun))
    if [ "$overrun $dropped" != "0 0" ]; then echo "lost ${1##*/cpu} $overrun $dropped"; fi
    [ "$entries" -gt 0 ] || return 0
    goal=$((entries + read))
    echo "pages ${1##*/cpu}" || exit 1
    for _ in 1 2 3 4 5 6 7 8; do
        pages=1
        # Old kernels may count bytes below zero.
        if [ ${#bytes} -lt 12 ] && [ "$bytes" -gt "$data_bytes" ]; then pages=$((bytes / data_bytes)); fi
        [ $pages -le $((buffer_kb * 1024 / data_bytes + 1)) ] || pages=1
        dd if="$1/trace_pipe_raw" bs=$page_bytes count=$pages 2>/dev/null || exit 1
        statistics "$1"
        if [ "$entries" -eq 0 ] || [ "$read" -ge $goal ]; then break; fi
    done
    echo "rtrun end pages" || exit 1
}

# How far CLOCK_REALTIME is ahead of CLOCK_MONOTONIC.
print_realtime() {
    sed -n '/^ clock 1:/,/offset/{s,^ *\.offset: *\(-\{0\,1\}[0-9]*\) nsecs.*,realtime \1,p;/offset/q;}' /proc/timer_list
} 2>/dev/null

# Mark a round in a trace of CLOCK_MONOTONIC_RAW, and before and after that in the trace of CLOCK_MONOTONIC.
mark_raw() {
    [ -n "$raw" ] || return 0
    for _ in 1 2 3 4 5 6 7 8; do
        mark "raw $1"
        echo "rtrun raw $1" >"$raw/trace_marker"
        mark "raw $1"
    done
} 2>/dev/null

# In microseconds, as the kernel prints them.
print_raw() {
    [ -n "$raw" ] || return 0
    sed -n "s,.* \([0-9]*\)\.\([0-9]\{6\}\): tracing_mark_write: rtrun raw $1\$,raw $1 \1\2,p" "$raw/trace"
} 2>/dev/null

print_formats() {
    for file; do
        [ -r "$file" ] || continue
        echo "format ${file#"$instance/events/"}"
        cat "$file"
        echo "rtrun end format"
    done
}

# Programs whose threads have changed, and programs that are new: a library may be loaded seconds after the start. Once in
# half a minute all processes are looked at. There may be thousands of any of them.
print_programs() {
    asked=
    still=
    for pid in $watched; do
        if [ -d "/proc/$pid" ]; then
            still="$still $pid"
            set -- "/proc/$pid"/task/*
            eval "[ \"\${tasks_$pid-}\" = \"\$*\" ]" || asked="$asked $pid"
            eval "tasks_$pid=\$*"
        else
            echo "ended $pid"
        fi
    done
    watched=$still
    set -- /proc/[0-9]*
    all=
    [ $((number % 30)) -ne 1 ] || all=1
    found=
    if [ "$*" != "$processes" ] || [ -n "$all$young" ]; then
        # Each with the number of rounds in which it is looked at once more. An old one may have begun to run another
        # program.
        # shellcheck disable=SC2086 # names without blanks
        young=$(printf '%s\n' known $processes young $young watched $watched now "$@" | awk -v all="$all" '
            /^[a-z]/ { part = $0 }
            part == "known" { known[$0] }
            part == "young" && split($0, pair, ":") == 2 { left[pair[1]] = pair[2] }
            part == "watched" { watched["/proc/" $0] }
            part == "now" && /^[/]/ && !($0 in watched) {
                age = ($0 in left) ? left[$0] - 1 : ($0 in known) ? -1 : 8
                if (age < 0 && all) age = 0
                if (age >= 0) print $0 ":" age
            }')
        processes=$*
    fi
    [ -z "$young" ] || found=$(printf '%s\n' "$young" | sed 's,:.*,/maps,' | xargs grep -lsE -- "$pattern" |
        sed 's,^/proc/\([0-9]*\)/.*,\1,')
    find_loops
    for pid in $changed; do
        # Those that are watched were asked above if the list of their threads is another one.
        case " $asked " in *" $pid "*) continue ;; esac
        case " $watched " in *" $pid "*) asked="$asked $pid" ;; *) found="$found $pid" ;; esac
    done
    # shellcheck disable=SC2086 # numbers
    set -- $(printf '%s\n' $asked $found | awk '!seen[$0]++')
    [ $# -gt 0 ] || return 0
    # shellcheck disable=SC2086
    [ -z "$found" ] || watched="$watched $(printf '%s\n' $found | awk -v watched=" $watched " '
        !seen[$0]++ && !index(watched, " " $0 " ")' | tr '\n' ' ')"
    echo "programs"
    printf '%s\n' "$@" | "$scripts/find_programs.sh" "$pattern" -
    echo "rtrun end programs"
}

# Record the events of these threads alone, each PID:TID. No thread has the number 4194305. An interrupt records which
# thread it interrupts, so its event is told by the function that the timer calls: 0 where no thread is followed.
filter_threads() {
    any=4194305
    called="function == 0"
    for address in ${1:+$functions}; do called="$called || function == 0x$address"; done
    filter="common_pid==$any" waking="pid==$any" switch="prev_pid==$any"
    for thread; do
        tid=${thread#*:}
        filter="$filter||common_pid==$tid"
        waking="$waking||pid==$tid"
        switch="$switch||prev_pid==$tid||next_pid==$tid"
    done
    echo "$called" >"$instance/events/timer/hrtimer_expire_entry/filter"
    echo "$filter" >"$instance/events/timer/hrtimer_start/filter"
    echo "$waking" >"$instance/events/sched/sched_waking/filter"
    echo "$switch" >"$instance/events/sched/sched_switch/filter"
} 2>/dev/null

# Find the threads whose loops are observed, in all processes now and then, else in those that are new or have new
# threads. Sets `changed` to the processes whose threads of that kind are others than before.
find_loops() {
    changed=
    [ -n "$functions" ] || return 0
    if [ $((number % 5)) -eq 1 ]; then
        now_followed=$(printf '%s\n' /proc/[0-9]* | "$scripts/find_threads.sh" "$names" | tr ' ' ':')
    else
        [ -n "$young$asked" ] || return 0
        # shellcheck disable=SC2086 # numbers
        now_followed=$(printf '%s\n' $threads
            { printf '%s\n' "$young" | sed 's,:.*,,' && printf '/proc/%s\n' $asked; } |
                "$scripts/find_threads.sh" "$names" | tr ' ' ':')
    fi
    now_followed=$(printf '%s\n' "$now_followed" | awk 'NF && !seen[$0]++')
    [ "$now_followed" != "$threads" ] || return 0
    changed=$(printf '%s\n' old $threads new $now_followed | awk -F: '
        /^[a-z]/ { part = $0; next }
        part == "old" { old[$0] = 1; next }
        { if ($0 in old) delete old[$0]; else changed[$1] }
        END { for (thread in old) { split(thread, ids, ":"); changed[ids[1]] } for (pid in changed) print pid }')
    threads=$now_followed
    # shellcheck disable=SC2086
    set -- $threads
    if [ $# -gt $followed_max ]; then echo "unfollowed $(($# - followed_max))"; fi
    # shellcheck disable=SC2046,SC2086
    [ -z "$is_filtered" ] || filter_threads $(printf '%s\n' $threads | head -n $followed_max)
}

# Above the limit the events are switched off for so long that the mean is below it.
rest_above_limit() {
    # A round of a busy machine takes longer than a second, and most of it may be after the events were counted. In
    # hundredths, as the kernel tells it.
    now=${now%.*}${now#*.}
    passed=$((now - last))
    [ $passed -ge 50 ] || passed=50
    rate=$(((total - before) * 100 / passed))
    before=$total
    last=$now
    allowed=$limit
    [ -z "$threads" ] || allowed=$((limit + loop_limit))
    [ $rate -gt $allowed ] || return 0
    pause=$((rate / allowed))
    [ $pause -le 10 ] || pause=10
    mark rests
    echo 0 >"$instance/events/enable"
    sleep $pause >/dev/null &
    wait $!
    enable_events
    mark observes
}

enable_events() {
    for event in $events "$group"; do
        if [ -e "$instance/events/$event/enable" ]; then echo 1 >"$instance/events/$event/enable"; fi
    done
} 2>/dev/null

print_rounds() {
    is_ended=
    trap 'is_ended=1' USR1
    number=0
    before=0
    read -r last _ </proc/uptime
    last=${last%.*}${last#*.}
    young=
    while :; do
        # A round that had begun before the end has read some CPUs up to then only.
        is_last=$is_ended
        total=0
        number=$((number + 1))
        mark "round $number"
        echo "round $number" || exit 1
        mark_raw $number
        read -r now _ </proc/uptime
        print_realtime
        print_raw $number
        for cpu in "$instance"/per_cpu/cpu*; do print_cpu "$cpu"; done
        [ -z "$is_last" ] || { print_raw 0; break; }
        [ -z "$is_ended" ] || continue
        print_programs
        rest_above_limit
        sleep 1 >/dev/null &
        wait $!
    done
    # Without this line somebody has ended what prints, and events are missing.
    echo "rounds end"
}

# The last events are printed first, unless nobody reads any more: a busy machine may read late.
take_off() {
    trap '' TERM HUP INT USR1 USR2
    trap - EXIT
    if [ -n "$sleeper" ]; then send_child KILL "$sleeper"; fi
    if [ -n "$printer" ]; then
        mark_raw 0
        echo 0 >"$instance/tracing_on"
        send_child USR1 "$printer"
        give_time "$printer"
    fi 2>/dev/null
    # Whatever still sleeps, or still reads a page where what prints was killed.
    kill -TERM 0
    word=done
    remove "$name" || word="left $name"
    [ -z "$raw" ] || remove "raw_$name" || word="left raw_$name"
    # A dead link takes no more lines.
    echo "rtrun end $word" &
    give_time $!
}

# Wait for the end of a child as long as nothing may be heard, then end it, and all else that was started: this group is
# ours alone. Nothing sleeps beside it that would have to be ended in turn.
give_time() {
    tries=$((silence * 10))
    while look "$1" && [ "$parent" = $$ ] && [ "$state" != Z ]; do
        if [ $tries -eq 0 ]; then
            kill -TERM 0
            send_child KILL "$1"
            return
        fi
        sleep 0.1
        tries=$((tries - 1))
    done
}

# Tell the script of each line of the standard input, and of its end. Where it was killed, what it has left is ended.
listen() {
    read -r own _ </proc/self/stat
    while read -r _; do tell USR2; done
    # Again, as one that is killed may not be gone yet. This ends with the script.
    while :; do
        tell USR1
        sleep 1
    done
}

tell() {
    if look "$own" && [ "$parent" = $$ ]; then kill "-$1" $$; else kill -KILL 0; fi
}

[ -d $tracing/instances ] || mount -t tracefs tracefs $tracing 2>/dev/null ||
    fail "no kernel trace: it needs CONFIG_FTRACE, tracefs on $tracing, and root"
[ -w $tracing/trace_marker ] || fail "no kernel trace: observing takes root"
namespace=$(readlink /proc/self/ns/pid)
namespace=${namespace##*[}
namespace=${namespace%]}
name=${namespace:-0}_$$_$(started $$)
# The kernel records pids as its own first namespace has them (PROC_PID_INIT_INO). Nobody within another one can tell
# whose they are. /proc/1 is of the namespace whose pids this /proc shows.
case $(readlink /proc/1/ns/pid) in
"pid:[4026531836]" | "") ;;
*)
    fail "this is a container with pids of its own, and the kernel records those of the host:\
 start the container with --pid=host, or observe the host itself"
    ;;
esac
namespace=${namespace:-0}
group=rtrun_observe_$name
instance=$tracing/instances/rtrun-observe-$name
raw=
printer=
sleeper=
remove_leftovers
mkdir "$instance" 2>/dev/null || fail "no kernel trace: $instance cannot be made; are there too many already?"
trap take_off EXIT
trap 'exit 3' TERM HUP
echo mono >"$instance/trace_clock" || fail "no kernel trace: the kernel has no trace clock mono"
echo "$buffer_kb" >"$instance/buffer_size_kb" 2>/dev/null ||
    fail "no kernel trace: there is no memory for $buffer_kb kB for each CPU"
echo "rtrun observes"
echo "header_page"
cat "$instance/events/header_page"
echo "rtrun end header_page"
data_bytes=$(sed -n 's,.*field: *char data;.*size:\([0-9]*\);.*,\1,p' "$instance/events/header_page")
page_bytes=$((data_bytes + $(sed -n 's,.*field: *char data;.*offset:\([0-9]*\);.*,\1,p' "$instance/events/header_page")))

watched=
is_told=
opened=
functions=
loop_limit=
names=
processes=$(echo /proc/[0-9]*)
threads=
while read -r word first second third rest; do
    case $word in
    p)
        [ -e $tracing/uprobe_events ] || fail "no probes: the target's kernel is built without CONFIG_UPROBE_EVENTS"
        if ! open_library "$second" "${third%:*}"; then
            echo "refused $first its file was replaced while the program runs: restart the program"
            continue
        fi
        # The same library at another place: the kernel places what belongs to an event when that is switched on.
        { echo 0 >"$instance/events/$group/$first/enable"; } 2>/dev/null
        # Never by > alone: it would remove the probes of everybody.
        if ! { printf '%s\n' "$word:$group/$first /proc/self/fd/5:${third##*:} $rest" >>$tracing/uprobe_events; } 2>/dev/null; then
            reason=$(sed -n 's,.* trace_uprobe: error: ,,p' $tracing/error_log 2>/dev/null | tail -n 1)
            case $reason in
            # The same file, which another container sees by another name.
            *"exact same probe"*) ;;
            *) echo "refused $first ${reason:-the kernel does not take it}" && continue ;;
            esac
        fi
        if ! { echo 1 >"$instance/events/$group/$first/enable"; } 2>/dev/null; then
            echo "refused $first the kernel cannot place a probe on the instruction there"
            { echo "-:$group/$first" >>$tracing/uprobe_events; } 2>/dev/null
            continue
        fi
        echo "placed $first"
        print_formats "$instance/events/$group/$first/format"
        ;;
    watch) watched="$first $second $third $rest" ;;
    loops) loop_limit=$first functions="$second $third $rest" ;;
    name) names="${names:+$names
}$(printf '%s' "$first" | tr '\001' ' ')" ;;
    raw)
        raw=$tracing/instances/rtrun-observe-raw_$name
        # Few kilobytes hold the marks of the last rounds.
        { mkdir "$raw" && echo mono_raw >"$raw/trace_clock" && echo 16 >"$raw/buffer_size_kb"; } 2>/dev/null ||
            { remove "raw_$name" && raw=; }
        ;;
    go) is_told=1 && break ;;
    esac
done
exec 5<&-
[ -n "$is_told" ] || exit 3
if [ -n "$functions" ] && [ -z "$events" ]; then
    is_filtered=1
    events=$loop_events
    filter_threads
fi
for event in $events; do
    if [ -e "$instance/events/$event/format" ]; then
        print_formats "$instance/events/$event/format"
    else
        print_formats "$instance/events/$event"/*/format
    fi
done
print_formats "$tracing/events/ftrace/print/format"
enable_events
mark observes
echo "ready"
print_rounds &
printer=$!
trap 'exit 0' USR1
trap 'is_heard=1' USR2
# In the background it would read nothing.
exec 4<&0
listen <&4 4<&- >/dev/null 2>&1 &
exec </dev/null 4<&-
read -r now _ </proc/uptime
end=$((${now%.*} + seconds))
while :; do
    is_heard=
    read -r now _ </proc/uptime
    left=$((end - ${now%.*}))
    [ $left -gt 0 ] || exit 3
    [ $left -le "$silence" ] || left=$silence
    # A signal ends the waiting, not the sleeping.
    sleep $left >/dev/null 2>&1 &
    sleeper=$!
    wait $sleeper
    send_child KILL $sleeper
    [ -n "$is_heard" ] || [ $left -lt "$silence" ] ||
        fail "nothing was heard from rtrun for $silence s, so the probes were taken off" 4
done
