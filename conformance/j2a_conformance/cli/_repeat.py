"""The same run again and again: are the verdicts the same?

What flows in: runs, as they end. What flows out: a line for each, and an exit code. Rules: a case
whose verdict differs between runs is a fault of the device or of the suite, whatever the verdicts;
a series that ends early says so, and tells what it saw.
"""

from collections import Counter
from collections.abc import Callable

from j2a_spec.plural import counted

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
    seen: dict[str, Counter[Verdict]] = {}
    last: Run | None = None  # all of them, with their evidence, would fill the memory
    done = whole = 0
    stopped = ""
    show(f"{'run':>5}{'seconds':>9}" + "".join(f"{v.value:>17}" for v in Verdict), flush=True)
    while done < times and not stopped:
        try:
            run = once()
        except (HarnessError, KeyboardInterrupt) as error:
            if last is None:
                raise
            stopped = str(error) or STOPPED_BY_USER
            break
        last, stopped = run, run.stopped
        done, whole = done + 1, whole + (not stopped)
        for result in run.results:
            seen.setdefault(result.case, Counter())[result.verdict] += 1
        counts = Counter(result.verdict for result in run.results)
        cells = "".join(f"{counts[v] or '-':>17}" for v in Verdict)
        show(f"{done:5}{run.duration_s:9.1f}{cells}", flush=True)
    show()
    assert last is not None
    differ = {case: verdicts for case, verdicts in seen.items() if len(verdicts) > 1}
    for case, verdicts in differ.items():
        words = ", ".join(
            f"{verdict.value} {counted(count, 'time')}" for verdict, count in verdicts.items()
        )
        show(f"NOT THE SAME in all runs: {case}: {words}")
    if stopped:
        show(f"Ended after {whole} of {counted(times, 'run')}: {stopped}.")
    elif not differ:
        show(f"The verdicts of {times} runs are the same, case by case.")
    if stopped == STOPPED_BY_USER:
        return last, INTERRUPTED
    code = FAILED if differ else status(last)
    return last, HARNESS if stopped and code != FAILED else code
