"""The same run again and again: are the verdicts the same?

What flows in: runs, as they end. What flows out: a line for each, and an exit code. Rules: a case
whose verdict differs between runs is a fault of the device or of the suite, whatever the verdicts;
a series that ends early says so, and tells what it saw.
"""

from collections import Counter
from collections.abc import Callable

from j2a_conformance._model import STOPPED_BY_USER, HarnessError, Run, Verdict

from ._exit import FAILED, HARNESS, INTERRUPTED, status
from ._output import show

__all__ = ["repeat"]


def repeat(times: int, once: Callable[[], Run]) -> tuple[Run, int]:
    """Run `times` times; print a table; return the last run, and the exit code of all.

    A run that ends early is the last one.

    Raises:
        HarnessError: of the first run; later ones end the series.
    """
    runs: list[Run] = []
    stopped = ""
    show(f"{'run':>5}{'seconds':>9}" + "".join(f"{v.value:>17}" for v in Verdict), flush=True)
    while len(runs) < times and not stopped:
        try:
            run = once()
        except (HarnessError, KeyboardInterrupt) as error:
            if not runs:
                raise
            stopped = str(error) or STOPPED_BY_USER
            break
        runs.append(run)
        stopped = run.stopped
        counts = Counter(result.verdict for result in run.results)
        cells = "".join(f"{counts[v] or '-':>17}" for v in Verdict)
        show(f"{len(runs):5}{run.duration_s:9.1f}{cells}", flush=True)
    show()
    differ = _differ(runs)
    for case, verdicts in differ.items():
        words = ", ".join(f"{verdict.value} {count} times" for verdict, count in verdicts.items())
        show(f"NOT THE SAME in all runs: {case}: {words}")
    if stopped:
        whole = sum(not run.stopped for run in runs)
        show(f"Ended after {whole} of {times} runs: {stopped}.")
    elif not differ:
        show(f"The verdicts of {times} runs are the same, case by case.")
    if stopped == STOPPED_BY_USER:
        return runs[-1], INTERRUPTED
    code = FAILED if differ else status(runs[-1])
    return runs[-1], HARNESS if stopped and code != FAILED else code


def _differ(runs: list[Run]) -> dict[str, Counter[Verdict]]:
    seen: dict[str, Counter[Verdict]] = {}
    for run in runs:
        for result in run.results:
            seen.setdefault(result.case, Counter())[result.verdict] += 1
    return {case: verdicts for case, verdicts in seen.items() if len(verdicts) > 1}
