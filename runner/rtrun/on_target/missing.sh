#!/bin/sh
# Print which of the needs this target lacks, one a line.
#   missing.sh NEED...      NEED is the name of a tool, governor=NAME, irq_cpu=CPUS, rt_priority=NUMBER or
#                         "option=PROGRAM FLAG VERSION": PROGRAM takes FLAG, from VERSION on
for need; do
    case $need in
    governor=*)
        grep -qsw -e "${need#*=}" /sys/devices/system/cpu/cpu0/cpufreq/scaling_available_governors ||
            echo "the cpufreq governor ${need#*=}"
        setting=/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor
        [ -w $setting ] || [ ! -e $setting ] || echo "the right to set the cpufreq governor (root)"
        ;;
    irq_cpu=*)
        set -- /proc/irq/[0-9]*/smp_affinity_list
        [ -w "$1" ] || echo "interrupts that can be moved (/proc/irq/*/smp_affinity_list, by root)"
        ;;
    rt_priority=*)
        chrt -f "${need#*=}" true 2>/dev/null ||
            echo "the right to real-time priority ${need#*=} (root, or rtprio in /etc/security/limits.conf)"
        ;;
    option=*)
        program=${need#option=} flag=${need#* }
        program=${program%% *} version=${flag#* }
        flag=${flag%% *}
        "$program" --help 2>&1 | grep -q -e "$flag" ||
            echo "the option $flag of $program ($version and later)"
        ;;
    *) command -v "$need" >/dev/null || echo "$need" ;;
    esac
done
exit 0
