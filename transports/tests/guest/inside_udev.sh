#!/bin/sh
# Runs in the guest: udev with the rule of `j2a setup udev`, and a gadget that is plugged in.
# Prints who may open the board, where its name leads to, and what j2a finds by it.
set -eu
mkdir -p /run/udev/rules.d
j2a setup udev --print >/run/udev/rules.d/70-j2a.rules
/lib/systemd/systemd-udevd --daemon --resolve-names=early
j2a serve --listen 'gadget:?serial=udev-1' >/run/serve.log 2>&1 &
server=$!
until [ -e /dev/j2a/udev-1 ]; do
    kill -0 $server || { cat /run/serve.log; exit 1; }
    sleep 0.1
done
stat -L -c '%a %G' /dev/j2a/udev-1
ls -l /dev/j2a
j2a info usb:///dev/j2a/udev-1
j2a list
kill $server
