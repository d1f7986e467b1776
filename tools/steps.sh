# shellcheck shell=bash
# steps.sh: named steps that print their time, for check.sh and exhaustive.sh, which source it. A step
# that fails does not keep the others from running, but `end_steps` then fails the whole.
# CHECK=name,name runs only these steps.
set -uo pipefail
cd "$(dirname "$0")/.."
PATH="$PWD/.venv/bin:$PATH"
export PATH
# What the user gave to make is not meant for the builds that happen in here.
unset MAKEFLAGS MAKEOVERRIDES MFLAGS MAKELEVEL PYTHON

mkdir -p build
failed=()

chosen() { [[ -z "${CHECK:-}" || ",$CHECK," == *",$1,"* ]]; }

step() {
    local name=$1 title=$2 status=0
    shift 2
    chosen "$name" || return
    printf '\n==> %s: %s\n' "$name" "$title"
    TIMEFORMAT="==> $name: %0R s, and %0U + %0S s of the processors"
    time "$@" </dev/null || status=$?
    if ((status)); then
        failed+=("$name")
        printf '==> %s FAILED with status %d\n' "$name" "$status"
    fi
}

end_steps() {
    if ((${#failed[@]})); then
        printf '\n==> FAILED steps: %s\n' "${failed[*]}"
        exit 1
    fi
}
