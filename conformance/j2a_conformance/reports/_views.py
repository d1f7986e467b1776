"""A result as a page shows it.

What flows in: a `Result`. What flows out: `CaseView`, the texts of its requirements, and its
evidence as lines of pieces, fields and bytes. Rules: of a case that is right only the last lines
are shown and long payloads are shortened; of any other case everything is.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from j2a_spec import requirements

from j2a_conformance._model import Evidence, Result, Verdict

from ._annotate import Annotated, Field, annotate

__all__ = ["CaseView", "case_view"]

_LINES_OF_A_PASS: Final = 24
_SYMBOLS_OF_A_PASS: Final = 48
_TAIL: Final = 4
_LABELS: Final = {
    "sent": "\N{RIGHTWARDS ARROW} sent",
    "received": "\N{LEFTWARDS ARROW} received",
    "sif": "\N{LEFTWARDS ARROW} SIF",
    "expected": "expected",
    "note": "note",
}
_CSS: Final = {
    "start": "s",
    "seq": "q",
    "opcode": "o",
    "length": "l",
    "payload": "p",
    "checksum": "c",
    "": "x",
}
_GOOD: Final = "checksum right"


@dataclass(frozen=True, slots=True)
class PartView:
    """A field: its class in the style sheet, and runs of bytes.

    A run is what it is ("", "pair", "differs" or "gap") and its bytes in hex.
    """

    css: str
    runs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class PieceView:
    """A frame or what else was on the wire; `bad` when it came and is not a whole frame."""

    parts: tuple[PartView, ...]
    meaning: str
    bad: bool


@dataclass(frozen=True, slots=True)
class LineView:
    """One entry of the evidence."""

    kind: str
    label: str
    at_ms: float
    text: str
    pieces: tuple[PieceView, ...]


@dataclass(frozen=True, slots=True)
class CaseView:
    """A result with what its page needs.

    Attributes:
        result: the result.
        id: anchor of the case.
        rules: id and text of each requirement.
        lines: the evidence that is shown.
        left_out: number of entries of evidence before these.
        words: what a filter looks into, in small letters.
        linked: the page has an anchor for each requirement.
    """

    result: Result
    id: str
    rules: tuple[tuple[str, str], ...]
    lines: tuple[LineView, ...]
    left_out: int
    words: str
    linked: bool


def case_view(result: Result, prefix: str = "", linked: bool = True) -> CaseView:
    """Return how a page shows a result; `prefix` keeps the anchors of several runs apart."""
    texts = requirements.load()
    rules = tuple((name, texts[name].text if name in texts else "") for name in result.requirements)
    brief = result.verdict in (Verdict.OK, Verdict.INFORMATIONAL)
    evidence = result.evidence[-_LINES_OF_A_PASS:] if brief else result.evidence
    return CaseView(
        result=result,
        id=f"{prefix}case-{result.case}",
        rules=rules,
        lines=tuple(_lines(evidence, _SYMBOLS_OF_A_PASS if brief else None)),
        left_out=result.left_out + len(result.evidence) - len(evidence),
        words=" ".join(
            (result.case, result.level, result.description, *result.requirements)
        ).lower(),
        linked=linked,
    )


def _lines(evidence: tuple[Evidence, ...], at_most: int | None) -> Iterator[LineView]:
    received: list[Annotated] = []
    for entry in evidence:
        pieces = annotate(entry.data)
        if entry.kind in ("sent", "received"):
            received = pieces if entry.kind == "received" else []
        compared = received if entry.kind == "expected" else []
        yield LineView(
            kind=entry.kind,
            label=_LABELS[entry.kind],
            at_ms=entry.at_ms,
            text=entry.text,
            pieces=tuple(
                _piece(
                    piece, compared[index] if index < len(compared) else None, at_most, entry.kind
                )
                for index, piece in enumerate(pieces)
            ),
        )


def _piece(
    piece: Annotated, received: Annotated | None, at_most: int | None, kind: str
) -> PieceView:
    others = {part.name: part for part in received.parts} if received else None
    parts = tuple(
        _part(part, others.get(part.name, Field("", ())) if others else None, at_most)
        for part in piece.parts
    )
    return PieceView(parts, piece.meaning, kind != "sent" and not piece.meaning.endswith(_GOOD))


def _part(part: Field, received: Field | None, at_most: int | None) -> PartView:
    """Return a field; bytes that differ from those in `received` are marked."""
    symbols = [
        (symbol, received is None or received.symbols[index : index + 1] == (symbol,))
        for index, symbol in enumerate(part.symbols)
    ]
    if at_most is None or len(symbols) <= at_most:
        return PartView(_CSS[part.name], tuple(_runs(symbols)))
    head, tail = symbols[: at_most - _TAIL], symbols[-_TAIL:]
    gap = ("gap", f"\N{HORIZONTAL ELLIPSIS} {len(symbols) - at_most} more \N{HORIZONTAL ELLIPSIS}")
    return PartView(_CSS[part.name], (*_runs(head), gap, *_runs(tail)))


def _runs(symbols: Iterable[tuple[bytes, bool]]) -> Iterator[tuple[str, str]]:
    """Yield what bytes are and their hex; pairs one by one, so that a line can end between them."""
    for kind, group in groupby(symbols, key=_kind):
        texts = [symbol.hex(" ") for symbol, _ in group]
        yield from ((kind, text) for text in (texts if kind == "pair" else [" ".join(texts)]))


def _kind(symbol: tuple[bytes, bool]) -> str:
    wire, same = symbol
    if not same:
        return "differs"
    return "pair" if len(wire) > 1 else ""
