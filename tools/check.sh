#!/usr/bin/env bash
# check.sh: everything that has to hold, step by step; `make test` runs it, and steps.sh says how.
# Most tests wait for something, and so do the suite and the mutants: they run side by side. pytest is
# shown last, so that its closing line ends a good run.
. "$(dirname "$0")/steps.sh"
if [ "${CI:-}" = true ]; then
    # Tests that need a compiler, a simulator or an emulator fail without it instead of being skipped.
    export J2A_REQUIRE_AVR=1
fi

# In a fresh clone each of the workers would rewrite and compile all tests; one does it before.
# The benchmarks only prove that they run. conftest.py says which files come first.
tests() {
    python -m pytest --collect-only -qq >/dev/null
    python -m pytest -n 4 --dist loadfile --no-loadscope-reorder --benchmark-disable \
        -m "not exhaustive" --durations=40 --durations-min=10
}

step generate "generated files are up to date" python -m j2a_spec.generate --check
step ruff "lint" ruff check --quiet .
step format "layout of the Python files" ruff format --check --quiet .
if command -v npm >/dev/null || [[ -n "${J2A_REQUIRE_AVR:-}" ]]; then
    step emulator "packages of the chip emulators" sh tools/npm.sh firmware/verify/emulators/rp2040
    step page "what the live page needs" sh tools/page.sh
else
    printf '\n==> emulator, page: SKIPPED, there is no npm\n'
fi
# The tests need some of the programs, too, and two must not build the same at once.
step programs "the programs that the suite runs against" python tools/conformance.py --build --sample
begin pytest "tests" tests
begin conformance \
    "the suite against every host of ours and every testee, some of them without the sweeps" \
    python tools/conformance.py --sample
step mypy "types of the packages" mypy
step mypy-tools "types of the tools, of the hosts and of the extensions of the documentation" bash -c \
    'mypy tools/*.py docs/conf.py docs/_ext/*.py && mypy conformance/hosts/*.py firmware/ports/*/*.py'
step imports "arrows between the packages" lint-imports --no-cache --no-logo
step mutants "each mutant is killed by a case of the rule that it breaks, or nothing changed since it was" \
    python conformance/mutants/kill.py --changed
step generated-mutants "a sample of the generated mutants is killed: dimensions, and mechanical changes" bash -c \
    'python conformance/mutants/kill.py --dimensions --sample 1 &&
    python conformance/mutants/random_mutants.py --target core --count 3'
step dist "wheel and sdist hold the packages, the same in a second build" python tools/check_dist.py
step speed "encode and decode in Python, for information" python -m j2a.tests.benchmarks.ratios
step interpreters "the tests of the library on the oldest and the newest Python of this machine" \
    python tools/interpreters.py
show conformance
# All cases of this very firmware are done in the step conformance, as avr-1m.
step demo "what make demo shows, with the cases of one level" bash -c \
    'python tools/demo.py --level core >build/demo.log 2>&1 || { cat build/demo.log; exit 1; }; tail -4 build/demo.log'
# Both read what conformance found.
step trace "each requirement, from clause to last result, as the summary says" \
    python -m tools.trace --check
step docs "documentation, warnings are errors" \
    python -m sphinx -E -W --keep-going -q -b html docs docs/_build/html
if ((${#failed[@]})); then
    printf '\n==> failed so far: %s\n' "${failed[*]}"
fi
show pytest

end_steps
