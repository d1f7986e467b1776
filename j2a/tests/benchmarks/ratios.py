"""Print how fast the pure-Python codec is, as ratios: `python -m j2a.tests.benchmarks.ratios`.

Process CPU time of interleaved rounds, of which the fastest counts: other work on the machine makes
rounds slower and never faster. Only the ratios can be compared between machines.
"""

import sys
import time

from .contenders import FRAMES, SIZES, Contender, contenders

ROUNDS = 15


def fastest(group: list[Contender], way: str, rounds: int = ROUNDS) -> dict[str, float]:
    """Return microseconds of CPU time per frame by contender, `way` being encode or decode."""
    best = {contender.name: float("inf") for contender in group}
    for _ in range(rounds):
        for contender in group:
            run = getattr(contender, way)
            start = time.process_time()
            done = run()
            took = time.process_time() - start
            if done != FRAMES:
                raise AssertionError(f"{contender.name}: {done} frames instead of {FRAMES}")
            best[contender.name] = min(best[contender.name], took / FRAMES * 1e6)
    return best


def main() -> int:
    """Print the table; returns the exit code."""
    print(f"{'':16}{'payload':>10}{'us/frame':>12}{'MB/s':>9}{'j2a is faster by':>19}")
    for way in ("encode", "decode"):
        for size in SIZES:
            best = fastest(list(contenders(size)), way)
            for name, took_us in best.items():
                ratio = "" if name == "j2a" else f"{took_us / best['j2a']:.1f}x"
                label = f"{way} {name}"
                print(f"{label:20}{size:4} B{took_us:12.2f}{size / took_us:9.1f}{ratio:>19}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
