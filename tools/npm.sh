#!/bin/sh
# npm.sh FOLDER...: installs the packages that the package-lock.json of each folder pins, by their hashes, into
# FOLDER/node_modules, which git ignores. Does nothing where that was done before. npm asks its own
# configuration for the registry. Exit status 1: not installed, and the reason has been printed.
set -eu
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || { echo "npm.sh: say what for: a folder with a package-lock.json" >&2; exit 1; }

for folder; do
    lock=$folder/package-lock.json
    # A copy of the lock that was installed last.
    installed=$folder/node_modules/.installed
    cmp -s "$lock" "$installed" && continue
    if [ ! -f "$lock" ]; then
        echo "npm.sh: there is no $lock" >&2
        exit 1
    fi
    if ! command -v npm >/dev/null; then
        echo "npm.sh: npm is missing; install the packages nodejs (18 or later) and npm" >&2
        exit 1
    fi
    echo "installing the packages of $lock with npm"
    rm -f "$installed"
    # No package runs a program of its own while it is installed.
    npm ci --prefix "$folder" --ignore-scripts --no-audit --no-fund --loglevel=error >&2 || exit 1
    cp "$lock" "$installed"
done
