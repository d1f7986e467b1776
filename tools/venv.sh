#!/bin/sh
# venv.sh DIR: makes the virtual environment DIR with the packages that constraints.txt pins and the
# project itself, editable, by uv: that of this machine, else one that pip installs, else by pip
# alone. PYTHON= in the environment names the interpreter; without it, the first Python of at least
# 3.11 on the machine is taken.
set -eu
cd "$(dirname "$0")/.."
venv=${1:?"say where: a folder"}

recent() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }
bundled() { "$1" -c 'import venv, ensurepip' >/dev/null 2>&1; }

find_python() {
    for name in "${PYTHON:-python3}" ${PYTHON:+-} python3.14 python3.13 python3.12 python3.11 /usr/bin/python3; do
        # A PYTHON that was asked for is taken or refused, never replaced.
        [ "$name" = - ] && return 1
        recent "$name" && command -v "$name" && return 0
    done
    return 1
}

# Debian and Ubuntu keep ensurepip in a package of its own, named after the interpreter.
get_ensurepip() {
    version=$("$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    sh tools/apt.sh "python$version-venv" && bundled "$1"
}

if recent "$venv/bin/python"; then
    python=
else
    rm -rf "$venv"
    if ! python=$(find_python); then
        if [ -n "${PYTHON:-}" ]; then
            echo "venv.sh: PYTHON=$PYTHON is no Python of at least 3.11" >&2
            exit 1
        fi
        sh tools/apt.sh python3 python3-venv || true
        recent python3 || sh tools/apt.sh python3.11 python3.11-venv || true
        python=$(find_python) || {
            echo "venv.sh: no Python of at least 3.11 here; name one with PYTHON=" >&2
            exit 1
        }
    fi
    echo "making $venv with $python ($("$python" -V))"
fi

# uv takes a fifth of the time of pip.
with_uv() {
    uv="$1 pip install --quiet --no-cache --python $venv/bin/python"
    echo "installing the packages of constraints.txt with uv"
    $uv --require-hashes -r constraints.txt && $uv --no-deps --no-build-isolation -e .
}

# The uv of this machine.
with_uv_there() {
    command -v uv >/dev/null || return 1
    [ -d "$venv" ] || uv venv --quiet --python "$python" "$venv" || return 1
    with_uv uv
}

# Pip, and as soon as it has installed uv, that.
with_pip() {
    if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
        # Not there yet, or made by uv, which leaves pip out.
        python=${python:-$(find_python)}
        rm -rf "$venv"
        if ! bundled "$python" && ! get_ensurepip "$python"; then
            echo "venv.sh: $python has no ensurepip; install its venv package, or uv" >&2
            return 1
        fi
        "$python" -m venv "$venv" || return 1
    fi
    pip="$venv/bin/python -m pip --quiet --disable-pip-version-check --no-input install"
    only_uv=$(mktemp)
    awk '/^[^ ]/ { is_uv = /^uv==/ } is_uv' constraints.txt >"$only_uv"
    if $pip --require-hashes --no-deps -r "$only_uv" && with_uv "$venv/bin/uv"; then
        rm -f "$only_uv"
        return
    fi
    rm -f "$only_uv"
    echo "installing the packages of constraints.txt with pip"
    # constraints.txt is the whole closure. Resolving it again would only go wrong: pip before 23.3
    # takes the newest of a package that another asks for with an extra, instead of the one pinned.
    # What is imported is compiled then; most of what the packages bring never is.
    $pip --no-compile --require-hashes --no-deps -r constraints.txt && $pip --no-deps --no-build-isolation -e .
}

# uv may be there and yet not reach the packages, where only pip was told how to.
with_uv_there || with_pip
