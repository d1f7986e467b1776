"""The command line of the bench: `j2a sim clocks`.

In: arguments. Out: the report on standard output, a picture in a file.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from j2a.cli.plugin import Progress, UsageError, note, show, show_json
from j2a_sim._clocks.settings import ENGINES, LEAST_S, LINKS, LOADS, Settings

__all__ = ["add_clocks", "run_clocks"]

# Option, type, what it is called, what it is; the rest is in Settings.
_OPTIONS: Final[tuple[tuple[str, Any, str, str], ...]] = (
    ("boards", int, "N", "how many boards"),
    ("seconds", float, "S", f"how long, in simulated seconds, from {LEAST_S} on"),
    ("seed", int, "K", "names all that is random"),
    ("ppm", float, "P", "the most that a crystal is off"),
    ("lost-sof", float, "SHARE", "share of the starts of frames that a board does not see"),
    ("sof-jitter-ns", float, "NS", "the most that a start of frame is early or late"),
    ("period-s", float, "S", "between two rounds of the host"),
    ("step-at", float, "S", "set the host's clock then"),
    ("step-by", float, "S", "by so many seconds"),
    ("slew-at", float, "S", "let the host's clock run faster from then on for 60 s"),
    ("slew-ppm", float, "PPM", "by so much"),
    ("suspend-at", float, "S", "suspend the bus then"),
    ("suspend-for", float, "S", "so long"),
    ("unplug-at", float, "S", "unplug the first board then"),
    ("unplug-for", float, "S", "so long; it begins anew"),
    ("holdover-at", float, "S", "let the host fall silent from then on"),
    ("readings", int, "N", "of all clocks together"),
)


def add_clocks(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the sub-command `clocks`."""
    defaults = Settings()
    parser = kinds.add_parser(
        "clocks",
        help="how well the clocks of boards agree, in exact simulated time",
        description="Run boards with crystals that are off, and a host that disciplines their "
        "clocks; print by how much they are wrong. Needs a checkout of J2A, and numpy.",
    )
    for name, kind, metavar, text in _OPTIONS:
        default = getattr(defaults, name.replace("-", "_"))
        shown = "" if default is None else f" ({default:g})"
        parser.add_argument(
            f"--{name}", type=kind, metavar=metavar, default=default, help=text + shown
        )
    parser.add_argument("--link", choices=LINKS, default=defaults.link, help="(%(default)s)")
    parser.add_argument(
        "--engine", choices=ENGINES, help="avr: the real firmware in simavr; native: fast (by size)"
    )
    parser.add_argument(
        "--load", choices=LOADS, default=defaults.load, help="of the host (%(default)s)"
    )
    parser.add_argument("--no-wander", action="store_true", help="keep the temperature")
    parser.add_argument("--json", action="store_true", help="print one line of JSON")
    parser.add_argument("--svg", type=Path, metavar="FILE", help="write plots to a file")


def run_clocks(args: argparse.Namespace) -> None:
    """Do a run and print its report.

    Raises:
        SimError: a setting is wrong, or the firmware cannot be built.
        UsageError: numpy is missing, or the file for the picture cannot be written.
    """
    names = [name.replace("-", "_") for name, *_ in _OPTIONS]
    chosen = {name: getattr(args, name) for name in (*names, "link", "engine", "load")}
    settings = Settings(**chosen, wander=not args.no_wander)
    try:
        from j2a_sim._clocks.plot import picture  # noqa: PLC0415 - numpy is an extra
        from j2a_sim._clocks.run import run  # noqa: PLC0415
    except ModuleNotFoundError as error:
        if error.name != "numpy":
            raise
        raise UsageError(
            "`j2a sim clocks` needs numpy: pip install numpy (the extra j2a[arrays])"
        ) from None
    if args.svg is not None:
        _check_file(args.svg)  # a run may take an hour
    with Progress("sim clocks", in_seconds=True) as progress:
        report = run(settings, lambda done_s: progress(done_s, settings.seconds))
    if args.json:
        show_json(report.as_dict())
    else:
        for line in report.as_text().splitlines():
            show(line)
    if args.svg is not None:
        try:
            args.svg.write_text(picture(report), "utf-8")
        except OSError as error:
            raise UsageError(f"cannot write {args.svg}: {error.strerror}") from None
        note(f"wrote {args.svg}")


def _check_file(path: Path) -> None:
    """Find out whether a file can be written, and leave what is there.

    Raises:
        UsageError: it cannot.
    """
    was_there = path.exists()
    if was_there and not path.is_file() and not path.is_dir():
        return  # to open a pipe may wait for its reader
    try:
        path.open("ab").close()
        if not was_there:
            path.unlink()
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
