#!/usr/bin/env python
"""Runs the Python deframer under atheris, or what reads descriptors and samples.

What flows in: the corpus folders as libFuzzer takes them, and its options; a corpus folder is made
if it is missing. What flows out: what libFuzzer prints; exit status 0 when nothing was found.
Rules: what is instrumented is the code of the library that is fuzzed, not the oracle.

    python j2a/tests/fuzz/fuzz.py -max_total_time=300 -max_len=1024 j2a/tests/fuzz/corpus
    python j2a/tests/fuzz/fuzz.py descriptors -max_total_time=300 j2a/tests/fuzz/corpus-descriptors
    python j2a/tests/fuzz/fuzz.py -merge=1 NEW j2a/tests/fuzz/corpus
"""

import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parent))
if sys.argv[1:2] == ["descriptors"]:
    del sys.argv[1]
    with atheris.instrument_imports(include=["j2a.types"]):
        import j2a.types.samples as fuzzed
    from descriptors import check_descriptors as check
else:
    with atheris.instrument_imports(include=["j2a.protocol.deframer", "j2a.protocol.codec"]):
        import j2a.protocol.deframer as fuzzed
    from target import check_deframer as check


def main() -> None:
    """Fuzz; see the module."""
    print(f"fuzzing {fuzzed.__file__}", flush=True)
    atheris.Setup(sys.argv, check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
