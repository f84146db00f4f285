#!/bin/sh
# Print which of the needs this target lacks, one a line.
#   missing.sh NEED...      NEED is the name of a tool, governor=NAME or irq_cpu=CPUS
for need; do
    case $need in
    governor=*)
        grep -qsw -e "${need#*=}" /sys/devices/system/cpu/cpu0/cpufreq/scaling_available_governors ||
            echo "the cpufreq governor ${need#*=}"
        ;;
    irq_cpu=*)
        set -- /proc/irq/[0-9]*/smp_affinity_list
        [ -w "$1" ] || echo "interrupts that can be moved (/proc/irq/*/smp_affinity_list)"
        ;;
    *) command -v "$need" >/dev/null || echo "$need" ;;
    esac
done
exit 0
