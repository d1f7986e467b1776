#!/usr/bin/env bash
# exhaustive.sh: what make test leaves out because it takes hours, step by step; `make exhaustive`
# runs it, and steps.sh says how. Every tool has to be there: nothing is skipped.
. "$(dirname "$0")/steps.sh"
export J2A_REQUIRE_AVR=1

# The deframer in Python, from its corpus on; what is new stays in build.
fuzz_descriptors() {
    mkdir -p build/fuzz-descriptors
    python j2a/tests/fuzz/fuzz.py descriptors -max_total_time=1800 -max_len=512 -print_final_stats=1 \
        -artifact_prefix=build/fuzz-descriptors- build/fuzz-descriptors j2a/tests/fuzz/corpus-descriptors
}
fuzz_deframer() {
    mkdir -p build/fuzz-deframer
    python j2a/tests/fuzz/fuzz.py -max_total_time=1800 -max_len=1024 -print_final_stats=1 \
        -artifact_prefix=build/fuzz-deframer- build/fuzz-deframer j2a/tests/fuzz/corpus
}

step programs "the programs that the suite runs against" python tools/conformance.py --build
step conformance "the suite, every case of it, against every testee and every host of ours" \
    python tools/conformance.py
step trace "each requirement, from clause to last result of every testee, as the summary says" \
    python -m tools.trace --check
step pytest "tests on more links, seeds and defects, and every job in a guest" \
    python -m pytest -n 3 --dist loadfile --no-loadscope-reorder -m 'exhaustive or guest'
step hypothesis "the tests that make up their examples, with eight times as many" \
    python -m pytest -n 3 --hypothesis-profile=many -m 'hypothesis and not exhaustive'
step interpreters "the tests of the library and of the transports on every Python of this machine" \
    python tools/interpreters.py --all
step soak "calls over links that stall, lose and damage bytes: no wrong answer" \
    python -m j2a.tests.library.soak --calls 1000000 --seed 1
step noise "noise is not taken for a device" python -m j2a.tests.library.noise --seeds 1000
step floods "floods: memory use, and how late calls end" python -m j2a.tests.library.floods
step samples "samples of 64 boards and of a LIDAR all come, and soon over a pseudo terminal" \
    python -m j2a.tests.benchmarks.samples
step suspended "a suspended program gets the replies that arrived" \
    python -m j2a.tests.library.suspended
step examples "the programs of the documentation print the same 30 times" \
    python docs/tests/repeat.py --times 30
step mutants "each mutant against every case" python conformance/mutants/kill.py --all-cases
step dimensions "each mutant that breaks a rule only for some lengths, fields, positions or values" \
    python conformance/mutants/kill.py --dimensions
for target in core device library; do
    step "random-$target" "random changes of the sources are noticed: $target" \
        python conformance/mutants/random_mutants.py --target "$target" --count 300
done
step fuzz "the C core under libFuzzer" \
    python -m firmware.verify.fuzz.fuzz --seconds 1800 --inputs build
step fuzz-small "the C core with room for 32 bytes under libFuzzer" \
    python -m firmware.verify.fuzz.fuzz --seconds 1800 --inputs build --small
for device in nothing clock stamps; do
    step "fuzz-transducers-$device" "the C core with transducers and $device besides under libFuzzer" \
        python -m firmware.verify.fuzz.fuzz --seconds 1800 --inputs build --transducers "$device"
done
step fuzz-deframer "the Python deframer under atheris" fuzz_deframer
step fuzz-descriptors "what reads descriptors and samples under atheris" fuzz_descriptors
end_steps
