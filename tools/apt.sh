#!/bin/sh
# apt.sh PACKAGE...: installs packages with apt-get, as root or through a sudo that asks nothing.
# The package lists are only fetched when they are missing or too old to install from.
# Exit status 1: not installed, and the reason has been printed.
set -eu

if ! command -v apt-get >/dev/null; then
    echo "apt.sh: no apt-get on this machine; install by hand: $*" >&2
    exit 1
fi
if [ "$(id -u)" -eq 0 ]; then
    as_root=env
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root="sudo -n env"
else
    echo "apt.sh: not root, and no sudo without a password; run: sudo apt-get install $*" >&2
    exit 1
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
apt() {
    $as_root DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 \
        -o Dpkg::Use-Pty=0 "$@" >"$log" 2>&1 </dev/null
}
install() { apt install --yes --no-install-recommends "$@"; }

echo "installing with apt-get: $*"
if ! install "$@"; then
    # A failed update is not the end: one source of several may be out of reach.
    apt update || true
    if ! install "$@"; then
        cat "$log" >&2
        echo "apt.sh: apt-get could not install: $*" >&2
        exit 1
    fi
fi
