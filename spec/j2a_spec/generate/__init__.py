"""The generator: writes every file that repeats a fact of this package, or checks it.

What flows in: constants, grammars, requirements and the cases in `frames.py`, `streams.py`,
`payloads.py` and `scenarios.py`. What flows out: a mapping from path to text. Rules: outputs are a
function of this package alone, so two runs on two machines give the same bytes; each generated
file says so in its first lines.
"""

from pathlib import Path

from j2a_spec.generate import c_files, spec_text, vector_files

__all__ = ["outputs", "stale"]

_TABLES = ("spec/LINKS.md", "docs/library.md")
_OPTIONS = "firmware/core/j2a_options.h"
_BUILTINS = "firmware/core/j2a_table.h"
_SCHEMA = "conformance/j2a_conformance/reports/report.schema.json"


def outputs(root: Path) -> dict[Path, str]:
    """Return the text of every generated file below the repository's `root`."""
    tests = vector_files.tests()
    return {
        **{root / path: text for path, text in vector_files.outputs(tests).items()},
        root / "firmware/core/j2a_const.h": c_files.constants(),
        root / "firmware/core/j2a_vectors.h": c_files.vectors(tests["frame"], tests["stream"]),
        root / _OPTIONS: c_files.options((root / _OPTIONS).read_text("utf-8")),
        root / _BUILTINS: c_files.builtins((root / _BUILTINS).read_text("utf-8")),
        root / "spec/SPEC.md": spec_text.fill((root / "spec/SPEC.md").read_text("utf-8")),
        **{
            root / path: spec_text.fill_tables((root / path).read_text("utf-8")) for path in _TABLES
        },
        root / _SCHEMA: spec_text.fill_levels((root / _SCHEMA).read_text("utf-8")),
    }


def stale(root: Path) -> dict[Path, str]:
    """Return, with the text that is due, the generated files below `root` that differ from it."""
    return {
        path: text
        for path, text in outputs(root).items()
        if not path.exists() or path.read_text("utf-8") != text
    }
