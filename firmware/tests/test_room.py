"""A device with less room than 255 bytes says so, however its tables are made (J2A-LIMIT-006)."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from j2a import connect

ROOT = Path(__file__).parent.parent.parent
LISTS = """
#include "j2a_lists.h"

static uint8_t nothing(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    *length = 0;
    return 0;
}

J2A_FUNCTIONS(J2A_CALL(nothing, nothing));
J2A_PROPERTIES(J2A_PROPERTY("name", "lists"));

void j2a_app_task(void) {
}
"""
ROUTES = ["demo", "builtins", "docs/examples/first", "firmware/tests/listings", "lists"]


@pytest.mark.parametrize("room", [128, 255])
@pytest.mark.parametrize("route", ROUTES)
def test_the_room_is_announced(
    build: Callable[..., Path], tmp_path: Path, route: str, room: int
) -> None:
    settings = {"ROOM": str(room)}
    if route == "lists":
        (tmp_path / "app.c").write_text(LISTS, "utf-8")
        settings |= {"APP_DIR": str(tmp_path), "CFLAGS": f"-I{ROOT / 'firmware/library'}"}
    elif "/" in route:
        settings |= {"APP_DIR": str(ROOT / route)}
    app = Path(route).name
    with connect(f"exec:{build(app, **settings)}") as board:
        assert board.properties.get("j2a.room") == (None if room == 255 else str(room))
        assert board.properties["j2a.spec"] == "1.1"
        assert board.room == room


def test_a_room_that_is_no_decimal_number_stops_the_build(
    make: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    goal = tmp_path / "demo.obj/j2a_table.o"  # no more of it is compiled than shows the error
    result = make(goal, OUT=tmp_path, OPTIONS="-DJ2A_ROOM=0x80")
    assert result.returncode != 0
    assert "j2a_room_is_not_decimal" in result.stderr


@pytest.mark.parametrize("parts", ["", "-DJ2A_WITH_SYNC=1"])
def test_a_table_of_the_thesis_needs_room_for_the_map(
    make: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path, parts: str
) -> None:
    """Without the map no host finds the properties, whose first chunk could be too long as well."""
    settings = {"APP_DIR": str(ROOT / "firmware/tests/listings"), "ROOM": "45", "OPTIONS": parts}
    result = make(tmp_path / "listings.obj/app.o", APP="listings", OUT=tmp_path, **settings)
    assert result.returncode != 0
    assert "j2a_names_longer_than_a_payload" in result.stderr
