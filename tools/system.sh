#!/bin/sh
# system.sh demo|test: makes sure of the system packages in apt-packages.txt that the demo or the
# tests need. What is missing is installed where that is possible without a question. What stays
# missing is named; in CI (CI=true) that is a failure, elsewhere the rest goes on without it.
set -eu
cd "$(dirname "$0")/.."
purpose=${1:?"say what for: demo or test"}
case $purpose in
demo | test) ;;
*)
    echo "system.sh: $purpose: say what for: demo or test" >&2
    exit 2
    ;;
esac

present() {
    case $1 in
    /*)
        # Unquoted: the pattern is to expand, and to itself when no file fits it.
        for file in $1; do
            [ -e "$file" ] && return 0
        done
        return 1
        ;;
    *) command -v "$1" >/dev/null ;;
    esac
}

missing() {
    while read -r package needed_by probe; do
        case $package in '' | '#'*) continue ;; esac
        if [ "$needed_by" = demo ] || [ "$needed_by" = "$purpose" ]; then
            present "$probe" || printf '%s ' "$package"
        fi
    done <tools/apt-packages.txt
}

absent=$(missing)
[ -n "$absent" ] || exit 0
# shellcheck disable=SC2086  # a list of words
sh tools/apt.sh $absent || true
absent=$(missing)
[ -n "$absent" ] || exit 0
echo "system.sh: missing system packages: $absent" >&2
if [ "${CI:-}" = true ]; then
    exit 1
fi
echo "system.sh: going on without them; what needs them is left out" >&2
