"""`j2a ros export`: the messages of a board as a package that colcon or catkin builds.

In: a transds.def or a board. Out: a folder.
Rules: the types are those that the bridge publishes; a folder that holds anything else is left
alone.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from j2a_spec.plural import counted

from j2a.cli.plugin import (
    OK,
    CommandFailed,
    UsageError,
    add_condition_arguments,
    add_link_arguments,
    read_source,
    show,
    write_files,
)
from j2a.types.ros import PACKAGE, ros1_package, ros2_package

SUMMARY: Final = "packages of ROS for the messages of boards"
NOTES: Final = """\
examples:
  j2a ros export serial:///dev/ttyACM0 ~/ws/src/j2a_msgs          (then: colcon build)
  j2a ros export transds.def ~/catkin_ws/src/j2a_msgs --ros1      (then: catkin_make)

Subscribers of standard messages need none of this; neither do tools that read the layout off the
network, such as PlotJuggler. rostopic echo shows standard messages without it, and needs the
package for the messages of the board."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sub-command."""
    kinds = parser.add_subparsers(dest="ros_kind", required=True, metavar="KIND")
    export = kinds.add_parser(
        "export",
        help="write a package with a message for each transducer",
        description="Write a package with a message for each transducer.",
    )
    add_link_arguments(
        export, metavar="SOURCE", about="the URL of a device, or a transds.def of its firmware"
    )
    export.add_argument("folder", type=Path, metavar="DIR", help=f"of the package, named {PACKAGE}")
    group = export.add_mutually_exclusive_group()
    group.add_argument("--ros1", action="store_true", help="a package of ROS 1")
    group.add_argument("--ros2", action="store_true", help="a package of ROS 2 (the default)")
    add_condition_arguments(export, "transds.def")


def run(args: argparse.Namespace) -> int:
    """Write the package; returns the exit code."""
    check_folder(args.folder)
    descriptors, source = read_source(args)
    if not descriptors.transducers:
        raise CommandFailed(f"{source} lists no transducers", 1)
    files = (ros1_package if args.ros1 else ros2_package)(descriptors)
    if args.ros1:
        from j2a_bridge.sinks.ros1_node import CONFIGURE  # noqa: PLC0415 - not needed for --help

        files["srv/Configure.srv"] = CONFIGURE
    outdated = [
        path
        for pattern in ("msg/*.msg", "srv/*.srv")
        for path in args.folder.glob(pattern)
        if str(path.relative_to(args.folder)) not in files
    ]
    write_files({args.folder / name: text for name, text in files.items()})
    for path in outdated:
        path.unlink()
    kinds = sum(name.endswith(".msg") for name in files)
    show(f"wrote {args.folder}: package {PACKAGE} with {counted(kinds, 'message')}")
    return OK


def check_folder(folder: Path) -> None:
    """Refuse a folder that is there and is no package of messages.

    Raises:
        UsageError: it holds something else.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder")
    try:
        text = (folder / "package.xml").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        text = ""
    if any(folder.iterdir()) and f"<name>{PACKAGE}</name>" not in text:
        raise UsageError(f"{folder} holds something else than a package {PACKAGE}: choose another")


__all__ = ["add_arguments", "check_folder", "run"]
