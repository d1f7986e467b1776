"""`j2a temperature URL`, a command of another package; thermometer.py is such a board."""

import argparse

from j2a.cli import plugin

SUMMARY = "print the temperature of a board"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add those that all commands with a link have."""
    plugin.add_link_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Ask the board; returns the exit code."""
    with plugin.connect(args) as board:
        temperature = board.functions["temperature"]
        plugin.show(f"{temperature()} °C")
    return plugin.OK
