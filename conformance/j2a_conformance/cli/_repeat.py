"""The same run again and again: are the verdicts the same?

What flows in: runs, as they end. What flows out: a line for each, and an exit code. Rules: a case
whose verdict differs between runs is a fault of the device or of the suite, whatever the verdicts.
"""

from collections import Counter
from collections.abc import Callable

from j2a_conformance._model import Run, Verdict

from ._exit import FAILED, status

__all__ = ["repeat"]


def repeat(times: int, once: Callable[[], Run]) -> tuple[Run, int]:
    """Run `times` times; print a table; return the last run, and the exit code of all.

    A run that ends early is the last one.
    """
    seen: dict[str, Counter[Verdict]] = {}
    print(f"{'run':>5}{'seconds':>9}" + "".join(f"{v.value:>17}" for v in Verdict), flush=True)
    for number in range(1, times + 1):
        run = once()
        counts = Counter(result.verdict for result in run.results)
        cells = "".join(f"{counts[v] or '-':>17}" for v in Verdict)
        print(f"{number:5}{run.duration_s:9.1f}{cells}", flush=True)
        for result in run.results:
            seen.setdefault(result.case, Counter())[result.verdict] += 1
        if run.stopped:
            break
    print()
    differ = {case: verdicts for case, verdicts in seen.items() if len(verdicts) > 1}
    for case, verdicts in differ.items():
        words = ", ".join(f"{verdict.value} {count} times" for verdict, count in verdicts.items())
        print(f"NOT THE SAME in all runs: {case}: {words}")
    if not differ:
        print(f"The verdicts of {number} runs are the same, case by case.")
    return run, FAILED if differ else status(run)
