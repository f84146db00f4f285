#!/bin/sh
# Print what stands in the way of real time, or not: one section for each fact, headed "== name", empty where the target
# lacks it. Nothing but a POSIX shell is needed; without zcat a packed configuration stays unread.
# A shell may read byte by byte, and a number in /proc/sys is then cut after its first digit: cat where there is one.
set -u
section() { echo "== $1"; }
show() {
    [ -r "$1" ] || return 0
    command -v cat >/dev/null && { cat "$1"; return 0; }
    while IFS= read -r line || [ -n "$line" ]; do printf '%s\n' "$line"; done <"$1"
} 2>/dev/null
# The value of each file, after the file's name.
each() { for file; do [ -r "$file" ] && { read -r value <"$file"; echo "${file#/sys/devices/system/} $value"; }; done; } 2>/dev/null

cpus=/sys/devices/system/cpu
release=
[ -r /proc/sys/kernel/osrelease ] && read -r release </proc/sys/kernel/osrelease

section kernel;          show /proc/sys/kernel/osrelease
section kernel_version;  show /proc/sys/kernel/version
section cmdline;         show /proc/cmdline
section config
if [ -r /proc/config.gz ] && command -v zcat >/dev/null 2>&1; then zcat /proc/config.gz 2>/dev/null
else show "/boot/config-$release"; fi
section clocksource;     show /sys/devices/system/clocksource/clocksource0/current_clocksource
section clockevent;      each /sys/devices/system/clockevents/clockevent[0-9]*/current_device
section high_resolution
[ -r /proc/timer_list ] && while read -r name colon value; do
    [ "$name" = .hres_active ] && echo "$value"
done </proc/timer_list
section governor;        each $cpus/cpu[0-9]*/cpufreq/scaling_governor
section frequency
for folder in $cpus/cpu[0-9]*/cpufreq; do
    [ -r "$folder/cpuinfo_max_freq" ] || continue
    read -r most <"$folder/cpuinfo_max_freq"
    allowed=$most current=$most
    [ -r "$folder/scaling_max_freq" ] && read -r allowed <"$folder/scaling_max_freq"
    [ -r "$folder/scaling_cur_freq" ] && read -r current <"$folder/scaling_cur_freq"
    word=full
    [ "$current" -lt "$most" ] && word=lowered
    [ "$allowed" -lt "$most" ] && word=limited
    echo "$word: ${folder#"$cpus/"} runs at $current kHz, may $allowed, can $most"
done
section cooling
for folder in /sys/class/thermal/cooling_device[0-9]*; do
    [ -r "$folder/cur_state" ] || continue
    read -r kind <"$folder/type"
    read -r state <"$folder/cur_state"
    echo "$kind $state"
done
section idle_states
for folder in $cpus/cpu[0-9]*/cpuidle/state[0-9]*; do
    [ -r "$folder/latency" ] || continue
    read -r name <"$folder/name"
    read -r latency <"$folder/latency"
    read -r disabled <"$folder/disable"
    [ "$disabled" = 0 ] && echo "$latency us to leave $name (${folder#"$cpus/"})"
done
section swap;            show /proc/swaps
section huge_pages;      show /sys/kernel/mm/transparent_hugepage/enabled
section same_pages;      show /sys/kernel/mm/ksm/run
section watchdog
for name in watchdog soft_watchdog nmi_watchdog; do
    [ -r /proc/sys/kernel/$name ] && { read -r value </proc/sys/kernel/$name; echo "$name $value"; }
done
section rt_runtime;      show /proc/sys/kernel/sched_rt_runtime_us
section rt_scheduling
# Whether a thread may become a real-time one is asked of the kernel by trying: rights, limits and control groups decide.
if command -v chrt >/dev/null; then
    if message=$(chrt -f 1 sh -c : 2>&1); then echo granted; else echo "refused: $message"; fi
fi
section timer_migration; show /proc/sys/kernel/timer_migration
section turbo_mode
# The driver may be there and have nothing to drive.
for device in /sys/bus/usb/drivers/smsc95xx/[0-9]*; do
    [ -e "$device" ] && { show /sys/module/smsc95xx/parameters/turbo_mode; break; }
done
section isolated
isolated=
[ -r $cpus/isolated ] && { read -r isolated <$cpus/isolated; echo "${isolated:-none}"; }
section interrupts
# A list of CPUs, as 0,2-3, with blanks around each number.
numbers() {
    list=$1,
    while [ -n "$list" ]; do
        part=${list%%,*} list=${list#*,}
        first=${part%-*} last=${part#*-}
        while [ -n "$first" ] && [ "$first" -le "$last" ]; do
            echo " $first "
            first=$((first + 1))
        done
    done
}
isolated=$(numbers "$isolated")
for folder in /proc/irq/[0-9]*; do
    # Only an interrupt with a handler has a folder in its own.
    for handler in "$folder"/*/; do
        [ -d "$handler" ] && [ -r "$folder/effective_affinity_list" ] || continue
        read -r where <"$folder/effective_affinity_list"
        for cpu in $(numbers "$where"); do
            case "$isolated" in *" $cpu "*) echo "${handler#/proc/irq/} on CPU $cpu" ;; esac
        done
    done
done
section tracer
for folder in /sys/kernel/tracing /sys/kernel/debug/tracing; do
    [ -r "$folder/current_tracer" ] && { show "$folder/current_tracer"; break; }
done
section threads
# proc(5): after the name, in brackets, come state and then flags (7th), rt_priority (38th) and policy (39th). A thread at
# SCHED_DEADLINE (6) has no priority; the chrt of busybox does not know its budget.
for file in /proc/[0-9]*/task/[0-9]*/stat; do
    # A line end in a name becomes "\n".
    line=
    while IFS= read -r part; do line="$line${line:+\\n}$part"; done 2>/dev/null <"$file" || continue
    rest=${line##*) }
    name=${line%) *}
    # shellcheck disable=SC2086 # the fields are to be split
    set -- $rest
    [ $# -ge 39 ] || continue
    # A zombie has its policy still, and never runs again.
    case $1 in Z | X | x) continue ;; esac
    [ "${38}" -gt 0 ] || [ "${39}" -eq 6 ] || continue
    kind=program priority=${38} budget=
    [ $(($7 / 2097152 % 2)) -eq 1 ] && kind=kernel
    if [ "${39}" -eq 6 ]; then
        priority=deadline
        budget=$(LC_ALL=C chrt -p "${line%% *}" 2>/dev/null) || budget=
        case $budget in *"/period parameters: "*) ;; *) budget= ;; esac
        budget=${budget:+ (${budget##* } ns of runtime/deadline/period)}
    fi
    # A name may hold backslashes, which echo would read.
    printf '%s\n' "$priority $kind ${name#*(}$budget"
done
exit 0
