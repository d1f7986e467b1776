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
# Without bytecode each of the thousands of Python programs that the steps start compiles its modules anew.
unset PYTHONDONTWRITEBYTECODE

mkdir -p build/steps
times=build/step-times
: >"$times"
failed=()
declare -A beside=() titles=() # of what `begin` started: the process group, and what to call it

chosen() { [[ -z "${CHECK:-}" || ",$CHECK," == *",$1,"* ]]; }

# timed NAME COMMAND...: runs the command and notes its time by the clock, and that of the processors,
# which says more on a machine that does other things, too.
timed() {
    local name=$1 status=0 LC_NUMERIC=C TIMEFORMAT="$1 %R %U %S"
    shift
    # In a shell of its own, or what ends in the background meanwhile would be counted, too.
    (time "$@" 2>&3 3>&-) 3>&2 2>>"$times" || status=$?
    return "$status"
}

said_time() {
    awk -v name="$1" '$1 == name { s = $2; cpu = $3 + $4 }
        END { printf "==> %s: %.0f s, %.0f s of the processors\n", name, s, cpu }' "$times"
}

# ended NAME STATUS: says the time of a step, and notes whether it failed.
ended() {
    said_time "$1"
    if (($2)); then
        failed+=("$1")
        printf '==> %s FAILED with status %d\n' "$1" "$2"
    fi
}

step() {
    local name=$1 title=$2 status=0
    shift 2
    chosen "$name" || return
    printf '\n==> %s: %s\n' "$name" "$title"
    # What it says goes where it went, errors apart, and into a file, too.
    : >"build/steps/$name.log"
    {
        timed "$name" "$@" </dev/null 2>&1 >&4 4>&- | tee -a "build/steps/$name.log" >&2
    } 4>&1 | tee -a "build/steps/$name.log" || status=$?
    ended "$name" "$status"
}

# begin NAME TITLE COMMAND...: a step beside those that follow; `show NAME` shows it and waits for it.
# It has a process group of its own: the shell lets no other process in the background have Ctrl-C,
# nor the programs that it starts.
begin() {
    local name=$1
    chosen "$name" || return
    titles[$name]=$2
    shift 2
    set -m
    timed "$name" "$@" </dev/null >"build/steps/$name.log" 2>&1 &
    beside[$name]=$!
    set +m
}
trap '((${#beside[@]} == 0)) || kill -INT -- "${beside[@]/#/-}"' EXIT

show() {
    local name=$1 status=0
    [[ -n "${beside[$name]:-}" ]] || return 0
    printf '\n==> %s: %s\n' "$name" "${titles[$name]}"
    tail -n +1 -f --pid="${beside[$name]}" "build/steps/$name.log"
    wait "${beside[$name]}" || status=$?
    unset "beside[$name]"
    ended "$name" "$status"
}

end_steps() {
    local row='%-18s %8.0f %8.0f\n'
    printf '\n==> seconds of each step by the clock and of the processors, the most expensive first\n'
    awk '{ print $3 + $4, $2, $1 }' "$times" | sort -rn | awk -v row="$row" '{ printf row, $3, $2, $1 }'
    awk -v row="$row" -v s="$SECONDS" '{ cpu += $3 + $4 } END { printf row, "all", s, cpu }' "$times"
    if ((${#failed[@]})); then
        local name
        for name in "${failed[@]}"; do # again: who reads only the end must see why
            printf '\n==> %s FAILED, the last that it said:\n' "$name"
            tail -n 20 "build/steps/$name.log"
        done
        printf '\n==> FAILED steps: %s\n' "${failed[*]}"
        exit 1
    fi
}
