"""Figures that are printed on the first pages are those that were measured."""

import json
import math
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SNAPSHOT = json.loads((ROOT / "firmware/verify/budget/snapshot.json").read_text("utf-8"))
FULL, MINIMAL = SNAPSHOT["avr-serial/full"], SNAPSHOT["avr-serial/minimal"]
USB = SNAPSHOT["avr-usb/full-32u2"]
SMALL = SNAPSHOT["avr-serial/minimal-room-32"]
CYCLES = [SNAPSHOT["avr-serial/cycles"], SNAPSHOT["avr-serial/cycles-room-32"]]
PAGES = ("README.md", "docs/index.md", "firmware/README.md", "CHANGELOG.md")


def text(page: str) -> str:
    return " ".join((ROOT / page).read_text("utf-8").split())


@pytest.mark.parametrize("page", PAGES)
def test_the_full_build(page: str) -> None:
    found = re.findall(r"(\d+) bytes of flash and (\d+) bytes of RAM", text(page))
    assert (str(FULL["flash"]), str(FULL["ram"])) in found


def test_the_full_build_with_usb() -> None:
    found = re.findall(r"(\d+) bytes of flash and (\d+) bytes of static RAM", text("README.md"))
    assert found == [(str(USB["flash"]), str(USB["ram"]))]


@pytest.mark.parametrize("page", ["firmware/README.md", "CHANGELOG.md"])
def test_the_minimal_build(page: str) -> None:
    assert re.search(rf"\b{MINIMAL['flash']} bytes", text(page))


def test_the_small_room_and_the_cycles() -> None:
    page = text("firmware/README.md")
    assert f"{SMALL['ram']} bytes of RAM will do, or {SMALL['total']} with" in page
    parser = max(build[name] for build in CYCLES for name in ("rx_plain", "rx_escaped"))
    in_all = max(build["received"] for build in CYCLES)
    dearest = [max(build[name] for build in CYCLES) for name in ("rx_dearest", "received_dearest")]
    printed = [
        re.search(r"on average at most (\d+) cycles in the parser and (\d+) in all", page),
        re.search(r"the dearest one (\d+) and (\d+)", page),
    ]
    for match, figures in zip(printed, ([parser, in_all], dearest), strict=True):
        assert match
        assert [int(number) for number in match.groups()] == [math.ceil(it) for it in figures]
