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
values_of() { for file; do [ -r "$file" ] && { read -r value <"$file"; echo "${file#/sys/devices/system/} $value"; }; done; } 2>/dev/null

cpus=/sys/devices/system/cpu
release=
[ -r /proc/sys/kernel/osrelease ] && read -r release </proc/sys/kernel/osrelease

section kernel;          show /proc/sys/kernel/osrelease
section kernel_version;  show /proc/sys/kernel/version
section cmdline;         show /proc/cmdline
section config
if [ -r /proc/config.gz ] && command -v zcat >/dev/null 2>&1; then zcat /proc/config.gz 2>/dev/null
else show "/boot/config-$release"; fi
clocksource=/sys/devices/system/clocksource/clocksource0
section clocksource;     show $clocksource/current_clocksource
section slow_clock
# Why the kernel gave up a better clock is in its log, which not everybody may read.
clock=
[ -r $clocksource/current_clocksource ] && read -r clock <$clocksource/current_clocksource
case $clock in
hpet | acpi_pm)
    echo "$clock"
    if command -v dmesg >/dev/null && command -v grep >/dev/null; then
        dmesg 2>/dev/null | grep -i -m 2 'tsc.*unstable\|unstable.*tsc'
    fi
    ;;
esac
section clockevent;      values_of /sys/devices/system/clockevents/clockevent[0-9]*/current_device
section high_resolution
[ -r /proc/timer_list ] && while read -r name colon value; do
    [ "$name" = .hres_active ] && echo "$value"
done </proc/timer_list
section governor;        values_of $cpus/cpu[0-9]*/cpufreq/scaling_governor
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
# proc(5): after the name, in brackets, come state and then flags (7th), minor and major page faults (8th, 10th),
# rt_priority (38th) and policy (39th). A thread at SCHED_DEADLINE (6) has no priority; the chrt of busybox does not know
# its budget.
top=0 top_name='' programs=' ' threads='' irq_threads='' wanting=''
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
    tid=${line%% *} name=${name#*(} pid=${file#/proc/}
    pid=${pid%%/*}
    # Programs that want a real-time thread: the kernel's own name of their first one, which ends after 15 bytes.
    [ "$pid" = "$tid" ] && case $name in ros2_control_no* | rtapi_app* | jackd) wanting="$wanting $pid" ;; esac
    [ "${38}" -gt 0 ] || [ "${39}" -eq 6 ] || continue
    kind=program priority=${38} budget=
    [ $(($7 / 2097152 % 2)) -eq 1 ] && kind=kernel
    if [ "${39}" -eq 6 ]; then
        priority=deadline
        budget=$(LC_ALL=C chrt -p "$tid" 2>/dev/null) || budget=
        case $budget in *"/period parameters: "*) ;; *) budget= ;; esac
        budget=${budget:+ (${budget##* } ns of runtime/deadline/period)}
    fi
    # A name may hold backslashes, which echo would read.
    printf '%s\n' "$priority $kind $name$budget"
    case $kind:$name in
    program:*)
        case $programs in *" $pid "*) ;; *) programs="$programs$pid " ;; esac
        threads="$threads $pid/$tid/$8/${10}"
        [ "${38}" -le "$top" ] || top=${38} top_name=$name
        ;;
    kernel:irq/[0-9]*-*)
        number=${name#irq/}
        irq_threads="$irq_threads ${number%%-*}:${38}"
        ;;
    esac
done
section rt_scheduling
# Whether a thread may become a real-time one is asked of the kernel by trying: rights, limits and control groups decide.
# Who gives the right depends on what the login runs in.
engine=
[ -e /.dockerenv ] && engine=' in docker'
[ -e /run/.containerenv ] && engine=' in podman'
if command -v chrt >/dev/null; then
    if message=$(chrt -f 1 sh -c : 2>&1); then echo granted; else echo "refused$engine: $message"; fi
fi
# Programs that lack the real-time thread that they want: where they run, and the highest priority that they may have.
for pid in $wanting; do
    case $programs in *" $pid "*) continue ;; esac
    name='' allowed=unknown place='in a session'
    read -r name <"/proc/$pid/comm" || continue
    while read -r word second third soft _; do
        [ "$word $second $third" = 'Max realtime priority' ] && allowed=$soft
    done <"/proc/$pid/limits"
    while IFS= read -r group; do
        case $group in
        *docker*) place='in docker' ;;
        *libpod*) place='in podman' ;;
        *.service*) place='in a service' ;;
        esac
    done <"/proc/$pid/cgroup"
    printf '%s\n' "program $place: process $pid may have priority $allowed, $name"
done 2>/dev/null
section memory
# proc(5): what a program locks as a whole is counted in whole mappings, which are larger than what of them is resident.
for pid in $programs; do
    locked='' resident=''
    while read -r key number _; do
        case $key in VmLck:) locked=$number ;; VmRSS:) resident=$number ;; esac
    done <"/proc/$pid/status"
    read -r name <"/proc/$pid/comm" || continue
    [ -n "$locked" ] && [ -n "$resident" ] || continue
    word=locked
    [ "$locked" -ge $((resident / 2)) ] || word=unlocked
    printf '%s\n' "$word: $locked of $resident kB, process $pid, $name"
done 2>/dev/null
cards=
for folder in /sys/class/net/*; do
    [ -e "$folder/device" ] || continue
    card=${folder##*/} state=
    read -r state <"$folder/operstate"
    # A name may hold what a shell would split, take for a pattern, or ethtool for an option.
    case $state:$card in down:* | *:-* | *:*[!0-9A-Za-z_.@-]*) ;; *) cards="$cards $card" ;; esac
done 2>/dev/null
section moderation
PATH=$PATH:/usr/sbin:/sbin  # ethtool is there, not every login looks there
for card in $cards; do
    command -v ethtool >/dev/null || { echo 'unseen: the target lacks ethtool'; break; }
    ethtool -c "$card" 2>/dev/null | {
        adaptive='' us=''
        while read -r key value rest; do
            case $key$value in
            AdaptiveRX:) adaptive=${rest%% *} ;;
            rx-usecs:*) us=$value ;;
            esac
        done
        # A driver without these settings answers with n/a, or not at all.
        case $adaptive$us in *on* | *[0-9]*) printf '%s\n' "rx-usecs ${us:-unknown}, adaptive ${adaptive:-unknown}: $card" ;; esac
    }
done
section network_threads
# An interrupt is a card's where the card's bus says so, or the name of its handler.
is_of_card() {
    [ -d "/sys/class/net/$2/device/msi_irqs/$1" ] && return 0
    for handler in "/proc/irq/$1"/*/; do
        handler=${handler#"/proc/irq/$1/"}
        case $handler in "$2"[-/]* | "$3"[-/]*) return 0 ;; esac
    done
    return 1
}
for card in $cards; do
    device=$(cd -P "/sys/class/net/$card/device" && echo "${PWD##*/}") 2>/dev/null
    for thread in $irq_threads; do
        [ "${thread#*:}" -lt "$top" ] && is_of_card "${thread%:*}" "$card" "$device" || continue
        printf '%s\n' "priority ${thread#*:}, below $top: interrupt ${thread%:*} of $card, waited for by $top_name?"
    done
done
section gpu
# PCI class 03 is a display; another bus has no class. Connectors of a card are named after it, with a dash.
for folder in /sys/bus/pci/devices/* /sys/class/drm/card[0-9]*; do
    class=0x03
    case $folder in
    */drm/*-*) continue ;;
    */drm/*) folder=$folder/device; [ -e "$folder/class" ] && continue ;;
    *) read -r class <"$folder/class" || continue ;;
    esac
    control='' state=unknown
    case $class in 0x03*) read -r control <"$folder/power/control" ;; esac
    [ -n "$control" ] || continue
    read -r state <"$folder/power/runtime_status"
    printf '%s\n' "$control: ${folder#/sys/} is $state"
done 2>/dev/null
section dual_kernel
[ -d /proc/xenomai ] && { read -r version </proc/xenomai/version; echo "Xenomai ${version:-}"; } 2>/dev/null
for folder in /sys/class/evl /sys/devices/virtual/evl; do
    [ -d $folder ] && { echo EVL; break; }
done
[ -d /proc/rtai ] && echo RTAI

# What is counted for a second: page faults, system management interrupts, and what the siblings of isolated CPUs do.
management_interrupts() {
    # Intel's MSR 0x34 (SDM volume 4), whose device is read at that offset, eight bytes at a time.
    { dd bs=52 skip=1 count=0 && dd bs=8 count=1; } 2>/dev/null </dev/cpu/0/msr | od -A n -t u4 -N 4
} 2>/dev/null
# The siblings that are not isolated themselves, and the ticks of 1/100 s that a CPU has run, and has idled.
siblings=
for cpu in $isolated; do
    [ -r "$cpus/cpu$cpu/topology/thread_siblings_list" ] || continue
    read -r list <"$cpus/cpu$cpu/topology/thread_siblings_list"
    for other in $(numbers "$list"); do
        [ "$other" -eq "$cpu" ] || siblings="$siblings $other:$cpu"
    done
done
ticks() {
    while read -r name user nice system idle wait irq softirq steal _; do
        case $name in
        "cpu$1") echo "$((user + nice + system + irq + softirq + ${steal:-0}))/$((idle + wait))"; return ;;
        intr) return ;;
        esac
    done </proc/stat
}
# The faults of a thread: its 8th and 10th field, again.
faults() {
    line=
    while IFS= read -r part; do line="$line$part"; done <"/proc/$1/task/$2/stat" || return 1
    # shellcheck disable=SC2086 # the fields are to be split
    set -- ${line##*) }
    [ $# -ge 39 ] && minor=$8 major=${10}
} 2>/dev/null
before=
for pair in $siblings; do before="$before $pair:$(ticks "${pair%:*}")"; done
vendor=
while read -r key _ value; do
    case $key in vendor_id) vendor=$value; break ;; esac
done 2>/dev/null </proc/cpuinfo
smis=
[ "$vendor" = GenuineIntel ] && smis=$(management_interrupts)
waited=
if [ -n "$threads$siblings$smis" ] && command -v sleep >/dev/null; then sleep 1 && waited=yes; fi
section faults
for thread in ${waited:+$threads}; do
    rest=${thread#*/}
    pid=${thread%%/*} tid=${rest%%/*} rest=${rest#*/}
    faults "$pid" "$tid" || continue
    minor=$((minor - ${rest%/*})) major=$((major - ${rest#*/}))
    [ $minor -gt 0 ] || [ $major -gt 0 ] || continue
    name=
    read -r name <"/proc/$pid/task/$tid/comm"
    printf '%s\n' "$major major and $minor minor page faults: thread $tid of process $pid, $name"
done 2>/dev/null
[ -n "$threads" ] && [ -z "$waited" ] && echo 'unseen: the target lacks sleep'
section siblings
for entry in ${waited:+$before}; do
    pair=${entry%:*} then=${entry##*:}
    now=$(ticks "${pair%:*}")
    run=$((${now%/*} - ${then%/*})) idle=$((${now#*/} - ${then#*/}))
    [ $((run + idle)) -gt 0 ] || continue
    echo "busy $((100 * run / (run + idle))) %: CPU ${pair%:*}, sibling of the isolated CPU ${pair#*:}"
done 2>/dev/null
[ -n "$siblings" ] && [ -z "$waited" ] && echo 'unseen: the target lacks sleep'
section management_interrupts
case $vendor:$smis in
*:*[0-9]*)
    now=$(management_interrupts)
    echo "$((now - smis)) in a second, $((now)) since the start"
    ;;
GenuineIntel:) echo 'unseen: root and the module msr are needed; what they cost, hwlatdetect measures' ;;
AuthenticAMD:) echo 'unseen: this processor has no counter; what they cost, hwlatdetect measures' ;;
esac
exit 0
