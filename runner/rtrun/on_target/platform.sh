#!/bin/sh
# Print what may betray a virtual machine: one line "source: value" for each fact. targets/inspection/platform_signs.yml judges them.
show() { while IFS= read -r value || [ -n "$value" ]; do printf '%s\n' "$1: $value"; done; }
{
    if grep -qwm1 '^flags.*hypervisor' /proc/cpuinfo; then echo "cpuinfo flag: hypervisor"; fi
    sed -n 's/^\(vendor_id\|model name\|Hardware\)[[:blank:]]*: */cpuinfo \1: /p' /proc/cpuinfo | sort -u
    [ -d /sys/class/dmi/id ] && cd /sys/class/dmi/id &&
        echo "dmi: $(cat sys_vendor) / $(cat product_name) / $(cat board_vendor) / $(cat bios_vendor)"
    for name in model compatible; do
        [ -r /proc/device-tree/$name ] && tr '\0' ' ' </proc/device-tree/$name | show "device-tree $name"
    done
    [ -r /proc/device-tree/hypervisor/compatible ] &&
        tr '\0' ' ' </proc/device-tree/hypervisor/compatible | show "device-tree hypervisor"
    for node in /proc/device-tree/fw-cfg*; do [ -e "$node" ] && echo "device-tree node: ${node##*/}"; done
    [ -r /sys/hypervisor/type ] && show hypervisor </sys/hypervisor/type
    show clocksource </sys/devices/system/clocksource/clocksource0/available_clocksource
    for clock in /sys/class/ptp/ptp*/clock_name; do [ -r "$clock" ] && show ptp <"$clock"; done
    for driver in /sys/bus/platform/drivers/virtio-mmio/*/virtio[0-9]*; do
        [ -e "$driver" ] && { echo "platform device: virtio-mmio"; break; }
    done
    command -v systemd-detect-virt >/dev/null && systemd-detect-virt --vm | show detect-virt
} 2>/dev/null
exit 0
