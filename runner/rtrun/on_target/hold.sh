#!/bin/sh
# Set something of the kernel, see to it that it stays so, and put back what was there when told to end (SIGTERM).
#
#   hold.sh governor NAME      the frequency governor of every CPU
#   hold.sh irq CPUS           the CPUs that serve interrupts; those that the kernel does not let move stay
#
# Ends with status 1 and says why when it cannot be set, or somebody else changed it.
set -u
wanted=$2
case $1 in
governor) set -- /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor ;;
irq) set -- /proc/irq/[0-9]*/smp_affinity_list ;;
*) echo "hold.sh: governor or irq, not $1" >&2; exit 2 ;;
esac
saved=
for file; do
    before=$(cat "$file" 2>/dev/null) || continue
    [ "$before" = "$wanted" ] || echo "$wanted" 2>/dev/null >"$file" || continue
    saved="$saved$file $before
"
done 2>/dev/null
restore() {
    echo "$saved" | while read -r file before; do
        [ -z "$file" ] || [ "$before" = "$wanted" ] || echo "$before" >"$file"
    done
}
trap 'restore; exit 0' TERM
if [ -z "$saved" ]; then
    echo "nothing there can be set to $wanted" >&2
    exit 1
fi
while :; do
    # Two CPUs are 0,1 to one who writes and 0-1 to one who reads: compare with what the kernel made of it.
    now=$(echo "$saved" | while read -r file _; do [ -z "$file" ] || cat "$file"; done)
    if [ "$now" != "${held:=$now}" ]; then
        restore
        echo "somebody changed what was set to $wanted" >&2
        exit 1
    fi
    sleep 2 &
    wait $!
done
