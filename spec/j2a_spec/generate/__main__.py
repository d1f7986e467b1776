"""Command line of the generator: `python -m j2a_spec.generate [--check]`."""

import argparse
import sys
from pathlib import Path

import j2a_spec
from j2a_spec.generate import stale


def main() -> int:
    """Write the generated files, or with `--check` name those that are not current (exit 1)."""
    parser = argparse.ArgumentParser(prog="python -m j2a_spec.generate", description=main.__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    parser.add_argument(
        "--root",
        type=Path,
        default=Path(j2a_spec.__file__).parents[2],
        help="the repository (default: the one that this package is in)",
    )
    options = parser.parse_args()
    if not (options.root / "spec/SPEC.md").is_file():
        parser.error(f"{options.root} has no spec/SPEC.md; give the repository with --root")
    differing = stale(options.root)
    for path, text in differing.items():
        name = path.relative_to(options.root)
        if options.check:
            print(f"{name} is not current: run python -m j2a_spec.generate", file=sys.stderr)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
            print(f"wrote {name}")
    if options.check and not differing:
        print("generated files are current")
    return 1 if options.check and differing else 0


if __name__ == "__main__":
    sys.exit(main())
