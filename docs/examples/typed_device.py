"""A device whose functions have types. Takes the URL to listen at."""

import contextlib
import enum
import sys
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import j2a_transports

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} URL")

device = j2a.Device({"name": "weather station"})
gust = device.describe_sif("gust", 0x20, "(speed f32 m/s, direction u16 deg)")


class Mode(enum.IntEnum):
    """How often it measures."""

    off = 0
    slow = 1
    fast = 2


@dataclass
class Place:
    """Where it is."""

    latitude: Annotated[j2a.f64, "deg"]
    longitude: Annotated[j2a.f64, "deg"]


class Reading(NamedTuple):
    """What it measures."""

    temperature: Annotated[j2a.f32, "Cel"]
    raw: Annotated[list[j2a.i16], j2a.Length(3)]


@device.function(idempotent=True)
def add(a: j2a.i32, b: j2a.i32) -> j2a.i32:
    """Adds two numbers."""
    return a + b


@device.function(slow_ms=500)
def measure(mode: Mode, place: Place) -> Reading:
    """Measures at a place."""
    if mode is Mode.off:
        raise j2a.Fail(1)
    gust(12.5, direction=270)
    return Reading(21.5 + place.latitude, [1, -2, 3])


@device.function
def rename(name: Annotated[str, j2a.Length(16)]) -> None:
    """Gives the station another name."""


with j2a_transports.listen(sys.argv[1]) as listener:
    print("listening on", listener.url, flush=True)
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C
        device.serve_forever(listener)
