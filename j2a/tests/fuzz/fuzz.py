#!/usr/bin/env python
"""Runs the Python deframer under atheris.

What flows in: the corpus folders as libFuzzer takes them, and its options; a corpus folder is made
if it is missing. What flows out: what libFuzzer prints; exit status 0 when nothing was found.
Rules: what is instrumented is the deframer and the codec that it uses, not the oracle.

    python j2a/tests/fuzz/fuzz.py -max_total_time=300 -max_len=1024 j2a/tests/fuzz/corpus
    python j2a/tests/fuzz/fuzz.py -merge=1 NEW j2a/tests/fuzz/corpus
"""

import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["j2a.protocol.deframer", "j2a.protocol.codec"]):
    import j2a.protocol.deframer

sys.path.insert(0, str(Path(__file__).parent))
import target


def main() -> None:
    """Fuzz; see the module."""
    print(f"fuzzing {j2a.protocol.deframer.__file__}", flush=True)
    atheris.Setup(sys.argv, target.check_deframer)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
