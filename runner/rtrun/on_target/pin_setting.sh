#!/bin/sh
# Change a kernel setting, check every two seconds that nobody else changes it, and restore the old value on SIGTERM.
#
#   pin_setting.sh governor NAME      the frequency governor of every CPU
#   pin_setting.sh irq CPUS           the CPUs that serve interrupts; interrupts that the kernel does not let move keep theirs
#
# Ends with status 1 and a reason when the setting cannot be made or somebody else changes it.
set -u
wanted=$2
case $1 in
governor) set -- /sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor ;;
irq) set -- /proc/irq/[0-9]*/smp_affinity_list ;;
*) echo "pin_setting.sh: governor or irq, not $1" >&2; exit 2 ;;
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
    echo "no such setting of this target can be set to $wanted" >&2
    exit 1
fi
while :; do
    # The kernel may print a value in another form than it was written (0,1 as 0-1): compare with its own form.
    now=$(echo "$saved" | while read -r file _; do [ -z "$file" ] || cat "$file"; done)
    if [ "$now" != "${pinned:=$now}" ]; then
        restore
        echo "somebody changed what was set to $wanted" >&2
        exit 1
    fi
    sleep 2 &
    wait $!
done
