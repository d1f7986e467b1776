"""An experiment as text and as JSON.

What flows in: an `Experiment`. What flows out: text. Rules: no judgement is added; shares come
with their 95 % interval.
"""

import json
from statistics import median
from typing import Any

from j2a_spec.plural import counted

from ._experiment import Experiment, Wrong
from ._row import Row
from ._theory import CONFIDENCE, Share

__all__ = ["as_json", "report", "wrong_lines"]

_CODES = (0xF0, 0xF2, 0xF3, 0xF4)
_TRAFFIC = (
    "kind rate/byte frames faults right F0 F2 F3 F4 wrong lost frames/fault ms/fault "
    "recovery[ms]:median 95% max"
)
_MISSED = "kind direction damaged undetected share 95%-interval theory theory-interval agrees"


def report(experiment: Experiment) -> str:
    """Return the console report."""
    setup = experiment.setup
    lines = [
        f"faults: {experiment.url}, {setup.payload} payload bytes, seed {setup.seed}, "
        f"damaged: {' and '.join(setup.sides)}",
        "",
        *_table([_TRAFFIC.split(), *(_traffic(row) for row in experiment.rows)]),
    ]
    missed = [cells for row in experiment.rows for cells in _missed(row)]
    if missed:
        lines += ["", "Damaged frames that the checksum let through:", ""]
        lines += _table([_MISSED.split(), *missed])
    unjudged = sum(row.unjudged for row in experiment.rows)
    strays = sum(row.strays for row in experiment.rows)
    if unjudged or strays:
        frames = sum(row.frames for row in experiment.rows)
        not_judged = f"{unjudged} of {counted(frames, 'exchange')} not judged"
        lines += ["", f"{not_judged}, {counted(strays, 'wrong answer')} not seen again"]
    lines += ["", *experiment.complaints, *experiment.gaps]
    if experiment.wrong is not None:
        lines += wrong_lines(experiment.wrong)
    return "\n".join([*lines, _outcome(experiment)])


def _outcome(experiment: Experiment) -> str:
    if experiment.failed:
        return "FAILED"
    if experiment.interrupted:
        return "INTERRUPTED: not all kinds were tested"
    return "NOT TESTED" if experiment.gaps else "passed"


def wrong_lines(wrong: Wrong) -> list[str]:
    """Return what was wrong, and the bytes that show it."""
    if not wrong.stream:
        return [f"the device is wrong: {wrong.reason}"]
    shown = " (pause) ".join(segment.hex(" ") for segment in wrong.stream)
    size = sum(map(len, wrong.stream))
    return [
        f"the device is wrong: {wrong.reason}",
        f"shortest bytes that show it ({size} of {wrong.before}): {shown}",
    ]


def _table(rows: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if number == 0 else cell.rjust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _traffic(row: Row) -> list[str]:
    counts = [row.frames, row.faults, row.right, *(row.errors[code] for code in _CODES)]
    times = _recovery(row)
    return [
        row.kind,
        f"{row.rate:g}",
        *map(str, (*counts, row.wrong, row.lost)),
        f"{row.frames_per_fault:.2f}",
        f"{row.ms_per_fault:.2f}",
        *(f"{value:.1f}" if times else "-" for value in times or (0.0, 0.0, 0.0)),
    ]


def _recovery(row: Row) -> tuple[float, float, float] | None:
    """Return median, 95 % and maximum of the times to recover, in ms; None where there are none."""
    times = sorted(row.recovery_ms)
    if not times:
        return None
    return median(times), times[(len(times) * 95 - 1) // 100], times[-1]


def _missed(row: Row) -> list[list[str]]:
    return [
        [
            row.kind,
            side,
            str(share.of),
            str(share.missed),
            f"{share.value:.2%}",
            _interval(share),
            f"{row.theory[side].value:.2%}",
            _interval(row.theory[side]),
            "yes" if share.agrees(row.theory[side]) else "NO",
        ]
        for side, share in row.shares.items()
        if share.of
    ]


def _interval(share: Share) -> str:
    low, high = share.interval()
    return f"{low:.2%}..{high:.2%}"


def as_json(experiment: Experiment) -> str:
    """Return the JSON report."""
    setup, wrong = experiment.setup, experiment.wrong
    claims = experiment.claims
    data: dict[str, Any] = {
        "kind": "j2a-faults",
        "url": experiment.url,
        "seed": setup.seed,
        "payload_bytes": setup.payload,
        "damaged": list(setup.sides),
        "properties": claims.properties,
        "confidence": CONFIDENCE,
        "passed": experiment.passed,
        "complaints": experiment.complaints,
        "not_tested": experiment.gaps,
        "interrupted": experiment.interrupted,
        "wrong": wrong
        and {
            "reason": wrong.reason,
            "segments": [segment.hex() for segment in wrong.stream],
            "bytes_before": wrong.before,
        },
        "rows": [_row(row) for row in experiment.rows],
    }
    return json.dumps(data, indent=2) + "\n"


def _row(row: Row) -> dict[str, Any]:
    times = _recovery(row)
    return {
        "kind": row.kind,
        "rate_per_byte": row.rate,
        "frames": row.frames,
        "faults": row.faults,
        "right": row.right,
        "errors": {f"0x{code:02X}": row.errors[code] for code in _CODES},
        "wrong": row.wrong,
        "lost": row.lost,
        "frames_lost_per_fault": row.frames_per_fault,
        "ms_lost_per_fault": row.ms_per_fault,
        "clean_ms": row.clean_ms,
        "elapsed_ms": row.elapsed_ms,
        "recovery_ms": times and dict(zip(("median", "p95", "max"), times, strict=True)),
        "recoveries": len(row.recovery_ms),
        "undetected": {
            side: {"measured": _share(share), "theory": _share(row.theory[side])}
            for side, share in row.shares.items()
        },
        "exchanges_with_faults": row.hit,
        "not_judged_with_faults": row.hit_unjudged,
        "not_judged": row.unjudged,
        "not_seen_again": row.strays,
    }


def _share(share: Share) -> dict[str, Any]:
    low, high = share.interval()
    return {"damaged": share.of, "undetected": share.missed, "low": low, "high": high}
