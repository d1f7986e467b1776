"""Streams as golden vectors: saved as the specification's own files are, and read again.

What flows in: a stream, or a file. What flows out: a file of the kind "stream", or where pauses
matter of the kind "scenario". Rules: the form is that of `j2a_spec/vectors/schema.json`, so that
a vector can be taken over into the specification, and its vectors can be played here.
"""

import json
from pathlib import Path
from typing import Any

from j2a_spec import constants as c
from j2a_spec.generate.vector_files import event
from j2a_spec.oracle import Event, Frame, FrameError, Incomplete, Skipped, decode

from j2a_conformance._model import HarnessError

from ._rules import Rules, Stream

__all__ = ["load", "save"]

_PAUSE_MS = 30
_IDS = {"checksum": "J2A-ERR-002", "marker": "J2A-ERR-003", "escape": "J2A-ERR-004"}


def save(path: Path, stream: Stream, comment: str, rules: Rules) -> None:
    """Write a stream as a file of one vector.

    Args:
        path: the file, which is replaced.
        stream: the bytes.
        comment: what is special about them.
        rules: the expected replies, which a scenario states.

    Raises:
        HarnessError: the file cannot be written.
    """
    kind = "stream" if len(stream) == 1 else "scenario"
    events = [e for segment in stream for e in decode(segment)]
    ids = sorted({_requirement(e) for e in events} or {"J2A-FRAME-006"})
    test: dict[str, Any] = {"id": f"{kind}-001", "comment": comment, "requirements": ids}
    if kind == "stream":
        test |= {"stream": stream[0].hex(), "events": [event(e) for e in events]}
    else:
        test |= {"needs": [], "steps": _steps(stream, rules)}
    notice = "Found by `j2a-conform faults`, which plays it again with --replay."
    head = {"notice": notice, "kind": kind, "spec": c.SPEC_VERSION, "count": 1, "tests": [test]}
    try:
        path.write_text(json.dumps(head, indent=2) + "\n", "utf-8")
    except OSError as error:
        raise HarnessError(f"the vector cannot be saved: {error}") from error


def _requirement(seen: Event) -> str:
    match seen:
        case FrameError(reason):
            return _IDS[reason]
        case Incomplete():
            return "J2A-TIME-002"
        case Skipped():
            return "J2A-FRAME-006"
        case Frame(c.SOF):
            return "J2A-DISP-001"
        case _:
            return "J2A-FRAME-008"


def _steps(stream: Stream, rules: Rules) -> list[dict[str, Any]]:
    steps: list[dict[str, Any]] = []
    for segment in stream:
        steps += [{"raw": segment.hex()}, {"pause_ms": _PAUSE_MS}]
        for due in rules.due((segment,)):
            # The schema has no open code: where any code will do, the reply is not stated.
            if due.code is not None:
                payload = due.payload if due.payload is None else due.payload.hex()
                steps.append({"expect": {"seq": due.seq, "code": due.code, "payload": payload}})
    return steps


def load(path: Path) -> dict[str, Stream]:
    """Read the streams of a vector file by the ids of their tests.

    Scenarios are read as far as they are made of raw bytes and pauses; others are left out.

    Raises:
        HarnessError: the file cannot be read, or holds no stream.
    """
    try:
        file = json.loads(path.read_text("utf-8"))
        streams: dict[str, Stream] = {}
        if file["kind"] == "stream":
            streams = {test["id"]: (bytes.fromhex(test["stream"]),) for test in file["tests"]}
        elif file["kind"] == "scenario":
            streams = {
                test["id"]: _segments(test["steps"])
                for test in file["tests"]
                if all({"raw", "pause_ms", "expect"} & set(step) for step in test["steps"])
            }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise HarnessError(f"{path} is not a vector file: {error}") from error
    if not streams:
        raise HarnessError(f"{path} holds no stream of bytes that could be played")
    return streams


def _segments(steps: list[dict[str, Any]]) -> Stream:
    segments = [b""]
    for step in steps:
        if "raw" in step:
            segments[-1] += bytes.fromhex(step["raw"])
        elif step.get("pause_ms", 0) > c.BYTE_TIMEOUT_MAX_MS:
            segments.append(b"")
    return tuple(segment for segment in segments if segment)
