#!/bin/sh
# Print the state of the target, one section for each fact, headed "== name". A section is empty where there is no such
# fact.
section() { echo "== $1"; }
state() {
section boot_id;            cat /proc/sys/kernel/random/boot_id 2>/dev/null
section kernel_release;     uname -r
section kernel_version;     uname -v
section machine;            uname -m
section host;               uname -n
section uptime;             cat /proc/uptime 2>/dev/null
section cmdline;            cat /proc/cmdline 2>/dev/null
section cpus_online;        cat /sys/devices/system/cpu/online 2>/dev/null
section realtime;           cat /sys/kernel/realtime 2>/dev/null
section clocksource;        cat /sys/devices/system/clocksource/clocksource0/current_clocksource 2>/dev/null
section clockevent;         cat /sys/devices/system/clockevents/clockevent0/current_device 2>/dev/null
section governor;           cat /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor 2>/dev/null
section frequency_khz;      cat /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_cur_freq 2>/dev/null
section temperature_mc;     cat /sys/class/thermal/thermal_zone[0-9]*/temp 2>/dev/null
section sched_rt_runtime_us; cat /proc/sys/kernel/sched_rt_runtime_us 2>/dev/null
section load;               cat /proc/loadavg 2>/dev/null
section memory;             head -n 3 /proc/meminfo 2>/dev/null
section os_release;         cat /etc/os-release 2>/dev/null
section cpuinfo;            cat /proc/cpuinfo 2>/dev/null
# Real-time threads (field 40, rt_priority, is not 0, or 41, policy, is 6, SCHED_DEADLINE), then how many threads there are of
# any kind. A line end in a name becomes "\n"; a zombie has its policy still, and never runs again.
section threads;            cat /proc/[0-9]*/task/[0-9]*/stat 2>/dev/null |
                                sed -nE -e ':whole' -e '/\) [A-Za-z]( -?[0-9]+){38,}$/!{' -e '$!{' -e 'N' -e 's/\n/\\n/' -e 'b whole' \
                                    -e '}' -e '}' -e '/\) [^ZXx]( -?[0-9]+){36} ([1-9]|0 6 )/p' -e '$='
}
# In one piece: over SSH each write of a command is a packet, and there would be a hundred.
printf '%s\n' "$(state)"
