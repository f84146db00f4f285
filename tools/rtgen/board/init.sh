#!/bin/busybox sh
# The first program of the initial RAM disk: load the drivers of the disk, mount it, start its init.
give_up() {
    echo "initrd: $1, powering off"
    busybox poweroff -f
}
export PATH=/bin
busybox mount -t devtmpfs devtmpfs /dev
busybox mount -t proc proc /proc
busybox mount -t sysfs sysfs /sys
while read -r module; do
    busybox insmod "/lib/$module" || echo "initrd: cannot load $module"
done < /lib/modules.list
root=$(busybox sed -n 's/.*\broot=\([^ ]*\).*/\1/p' /proc/cmdline)
tries=100
while :; do
    # A device, or UUID=... of a file system that may be on any disk.
    case $root in
        UUID=*) device=$(busybox findfs "$root" 2> /dev/null) ;;
        *) device=$root ;;
    esac
    [ ! -b "$device" ] || break
    tries=$((tries - 1))
    [ "$tries" -gt 0 ] || give_up "no disk $root"
    busybox sleep 0.2
done
busybox mount -t ext4 -o noatime "$device" /root || give_up "cannot mount $root"
for place in dev proc sys; do
    busybox mount --move "/$place" "/root/$place"
done
exec busybox switch_root /root /sbin/init
give_up "no /sbin/init on $root"
