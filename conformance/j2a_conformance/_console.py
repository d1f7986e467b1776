"""The report for people at a terminal.

What flows in: a `Run`, or its results one by one. What flows out: text lines without colour.
"""

from collections.abc import Iterator
from typing import get_args

from j2a_spec import requirements
from j2a_spec.requirements import Level

from ._annotate import annotate
from ._model import Evidence, Result, Run, Verdict

__all__ = ["evidence_lines", "line", "report"]

_EVIDENCE_SHOWN = 12
_ARROWS = {"sent": "->", "received": "<-", "sif": "<~", "expected": "expected", "note": "note"}


def line(result: Result) -> str:
    """Return one line for a result."""
    again = f" ({result.attempts} attempts)" if result.attempts > 1 else ""
    reason = f": {result.reason}" if result.reason else ""
    return f"{result.verdict.value:13} {result.case}  {result.duration_s:.2f} s{again}{reason}"


def report(run: Run) -> str:
    """Return the whole report: what the device claims, each failure, the table, the judgement."""
    return "\n".join((*_claims(run), *_failures(run), *_others(run), *_table(run), *_end(run)))


def _claims(run: Run) -> Iterator[str]:
    yield f"J2A conformance of {run.url}, {run.started}"
    if run.claims is None:
        return
    names = ", ".join(name or "(not used)" for name in run.claims.functions)
    mapped = "mapping" if run.claims.mapped else "no mapping; found by trying"
    yield f"functions ({mapped}): {names}"
    for key, value in run.claims.properties.items():
        yield f"property {key} = {value}"
    yield f"shortest round trip {run.claims.rtt_s * 1e3:.2f} ms"
    yield ""


def _failures(run: Run) -> Iterator[str]:
    texts = requirements.load()
    for result in run.with_verdict(Verdict.FAILED):
        yield f"FAILED {result.case} ({result.level})"
        yield f"  does      {result.description}"
        yield f"  expects   {result.expectation}"
        yield f"  but       {result.reason}"
        for name in result.requirements:
            yield f"  {name}  {texts[name].text}"
        yield from evidence_lines(result)
        yield ""


def evidence_lines(result: Result, at_most: int = _EVIDENCE_SHOWN) -> Iterator[str]:
    """Return the last `at_most` entries of evidence, bytes annotated."""
    shown = result.evidence[-at_most:]
    if left_out := result.left_out + len(result.evidence) - len(shown):
        yield f"  ({left_out} earlier lines left out)"
    for entry in shown:
        yield from _entry(entry)


def _entry(entry: Evidence) -> Iterator[str]:
    prefix = f"  {entry.at_ms:9.2f} ms {_ARROWS[entry.kind]} "
    if entry.text:
        yield prefix + entry.text
    for piece in annotate(entry.data) if entry.data else ():
        yield f"{prefix}{' | '.join(piece.fields)}   {piece.meaning}"
        prefix = " " * len(prefix)


def _others(run: Run) -> Iterator[str]:
    """Return what was neither right nor wrong; many cases can have the same reason."""
    for verdict in (Verdict.UNIMPLEMENTED, Verdict.INFORMATIONAL):
        reasons: dict[str, list[str]] = {}
        for result in run.with_verdict(verdict):
            reasons.setdefault(result.reason, []).append(result.case)
        for reason, cases in reasons.items():
            yield f"{verdict.value}: {', '.join(cases)}: {reason}"


def _table(run: Run) -> Iterator[str]:
    verdicts = list(Verdict)
    yield ""
    yield f"{'level':12}" + "".join(f"{verdict.value:>15}" for verdict in verdicts)
    for level in get_args(Level):
        results = [r for r in run.results if r.level == level]
        counts = [sum(r.verdict is verdict for r in results) for verdict in verdicts]
        if results:
            yield f"{level:12}" + "".join(f"{count or '-':>15}" for count in counts)
    counts = [len(run.with_verdict(verdict)) for verdict in verdicts]
    yield f"{'all':12}" + "".join(f"{count or '-':>15}" for count in counts)


def _end(run: Run) -> Iterator[str]:
    yield ""
    if run.stopped:
        yield f"The run ended early: {run.stopped}."
    judgement = "conformant" if run.conformant else "NOT conformant"
    part = " in what was run" if run.stopped and run.conformant else ""
    unseen = ", ".join(result.case for result in run.with_verdict(Verdict.INFORMATIONAL))
    but = f"; not seen on this link: {unseen}" if unseen else ""
    yield f"The device is {judgement}{part}{but}; {run.duration_s:.1f} s."
