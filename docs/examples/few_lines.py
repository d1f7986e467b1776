# ruff: noqa: D103 - so that the functions are short
"""Two functions and a stream, as a device in Python."""

import j2a

device = j2a.Device({"name": "few lines"})
lights = []


# fmt: off
@device.function
def add(a: j2a.i32, b: j2a.i32) -> j2a.i32: return a + b
@device.function
def led(on: bool) -> None: lights.append(on)
counter = device.describe_sif("counter", 32, "(count u32)")
# fmt: on
