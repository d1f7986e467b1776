#!/bin/sh
# Runs in the guest: systemd, in namespaces of its own, and the unit of `j2a setup syncd`. Prints what systemd says of the
# service while it runs and at its end, and what the daemon answers.
set -eu
unit=j2a-syncd.service
cp -a /etc /run/etc
mount --bind /run/etc /etc
rm -rf /etc/systemd/system/*.wants
mount -t cgroup2 none /sys/fs/cgroup
mkdir -p /run/systemd/system /etc/systemd/system/$unit.d
# Nothing else is started.
printf '[Unit]\nDescription=Nothing\n' >/run/systemd/system/nothing.target
# The Python of this machine may be in the home of root, through which the user of the service cannot go. The right to
# do so begins behind the first program.
cat >/etc/systemd/system/$unit.d/reach.conf <<END
[Service]
ExecStart=
ExecStart=/usr/bin/env $(command -v j2a) syncd
CapabilityBoundingSet=CAP_DAC_READ_SEARCH
AmbientCapabilities=CAP_DAC_READ_SEARCH
Restart=no
END
container=guest unshare --fork --pid --mount --mount-proc \
    /lib/systemd/systemd --system --unit=nothing.target --log-target=kmsg --show-status=no &
until [ -S /run/systemd/private ]; do sleep 0.5; done
pid=$(pgrep -o -f '^/lib/systemd/systemd --system')
inside() { nsenter --target "$pid" --pid --mount --root env "PATH=$PATH" "$@"; }

inside j2a setup syncd
inside systemctl start $unit || { inside systemctl status $unit; exit 1; }
inside systemctl show -p ActiveState,SubState,User,DynamicUser $unit
# Type=exec: it has begun, but may need a moment until it answers.
until inside j2a sync status >/run/status 2>&1; do
    inside systemctl is-active --quiet $unit || { inside systemctl status $unit; exit 1; }
    sleep 0.5
done
sed 's/^/status: /' /run/status
inside j2a syncd && echo 'notified: a second one'
inside systemctl stop $unit
inside systemctl show -p Result,ExecMainStatus $unit
[ -e /run/j2a ] || echo 'gone: the folder of the socket'
