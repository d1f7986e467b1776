#!/bin/busybox sh
# The first process of the test guest: loads the modules, makes the host's files the root, runs the
# job in it and reports its exit code. What flows in, from the initramfs: /job, /modules, and the
# variables token and here of /settings. What flows out, on the port "job": all that the job prints,
# and the line "<token> exit <code>". Rules: only /run, /tmp and /dev/shm can be written.
B=/bin/busybox
. /settings
$B mount -t proc proc /proc
$B mount -t sysfs sysfs /sys
$B mount -t devtmpfs devtmpfs /dev
for module in $($B cat /modules/order); do
    $B insmod "/modules/$module.ko" || echo "init: cannot load $module"
done

# The device of a port appears a moment after its driver.
until set -- /dev/vport*p1 && [ -e "$1" ]; do $B usleep 10000; done
exec >"$1" 2>&1
end() { # exit code
    echo
    echo "$token exit $1"
    # The host ends the machine when it has read that line.
    $B sleep 60
    $B poweroff -f
}
cannot() { # what
    echo "init: cannot $1"
    end 125
}

$B mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=512000,cache=loose host /host ||
    cannot "mount the host's files"
# The repository may be below what the next lines hide.
$B mkdir -p /kept
$B mount -o bind "/host$here" /kept || cannot "find $here"
$B mount -t tmpfs tmpfs /host/run
$B mount -t tmpfs tmpfs /host/tmp
case $here in
/tmp/* | /run/*)
    $B mkdir -p "/host$here"
    $B mount -o bind /kept "/host$here" || cannot "mount $here"
    ;;
esac
$B mkdir -p /dev/shm /dev/pts
$B mount -t tmpfs tmpfs /dev/shm
$B mount -t devpts devpts /dev/pts
for folder in proc sys dev; do $B mount -o rbind /$folder /host/$folder; done
[ ! -d /sys/kernel/config ] || $B mount -t configfs configfs /host/sys/kernel/config
$B ip link set lo up
$B ip link set eth0 up
$B ip address add 10.0.2.15/24 dev eth0
$B ip route add default via 10.0.2.2
$B cp /job /host/run/job

$B chroot /host /bin/sh /run/job </dev/null
end $?
