"""Golden vectors: JSON files that the generator writes; `schema.json` describes them.

What flows out: the parsed files. The same files serve implementations in any language.
"""

import json
from functools import cache
from importlib.resources import files
from typing import Any, Literal

__all__ = ["KINDS", "Kind", "load", "schema"]

Kind = Literal[
    "frame", "stream", "payload", "scenario", "interface", "value", "transducers", "sample", "clock"
]
KINDS: tuple[Kind, ...] = (
    "frame", "stream", "payload", "scenario", "interface", "value", "transducers", "sample",
    "clock",
)  # fmt: skip


def load(kind: Kind) -> list[dict[str, Any]]:
    """Return the tests of one file; `schema.json` tells what each holds."""
    tests: list[dict[str, Any]] = _read(f"{kind}.json")["tests"]
    return tests


def schema() -> dict[str, Any]:
    """Return the JSON schema of the vector files."""
    return _read("schema.json")


@cache
def _read(name: str) -> dict[str, Any]:
    parsed: dict[str, Any] = json.loads(files(__name__).joinpath(name).read_text("utf-8"))
    return parsed
