"""The Python device with the transducers of firmware/apps/transducers, for the conformance suite.

What flows in: calls of the suite; `stimulus` says what the sensors measure. What flows out: a
device that does what that firmware does.
"""

import atexit
import struct
from pathlib import Path
from tempfile import TemporaryDirectory

from j2a.demo import DemoDevice
from j2a.errors import Fail
from j2a.io.functions import ManyReply, ManyRequest
from j2a.io.transds_file import load_transds

# As firmware for the posix port.
_OPTIONS = {"TRANSDUCERS_NUMBERS": "1"}
_FILE = Path(__file__).parents[2] / "firmware/apps/transducers/transds.def"
_SENSORS = {
    0: ("plain", 2, "<h"),
    1: ("queued", 3, "<H"),
    2: ("tuned", 2, "<i"),
    3: ("imu", 1, "<9h"),
    4: ("level", 1, "<f"),
    5: ("slow", 1, "<B"),
    20: ("count32", 2, "<I"),
    21: ("count64", 1, "<Q"),
    22: ("place64", 2, "<q"),
    23: ("exact", 2, "<d"),
    24: ("small", 2, "<b"),
    25: ("flag", 2, "<?"),
    26: ("state", 2, "<B"),
    27: ("turn", 1, "<h"),
    28: ("event", 1, "<I"),
    40: ("place16", 2, "<h"),
    41: ("count8", 2, "<B"),
    254: ("wide", 12, "<H"),
}


def clocked() -> DemoDevice:
    """Return the device with a clock whose crystal is off by 40 ppm."""
    return device(clock=40)


def fast() -> DemoDevice:
    """Return the device with a clock that runs four times too fast, so that its cases wait less."""
    return device(clock=3_000_040)


def device(clock: float | None = None) -> DemoDevice:
    """Return the device.

    Args:
        clock: as of `j2a.Device`.
    """
    folder = TemporaryDirectory(prefix="j2a-settings-")
    atexit.register(folder.cleanup)
    made = DemoDevice(
        transducers=load_transds(_FILE, _OPTIONS),
        settings=Path(folder.name) / "settings.json",
        clock=clock,
    )
    count = 0
    is_set = False

    @made.function
    def stimulus(payload: bytes) -> None:
        """Have a sensor report values: an id, then values, each with its channel before."""
        if not payload or payload[0] not in _SENSORS:
            raise Fail(0xFF)
        name, channels, form = _SENSORS[payload[0]]
        size = 1 + struct.calcsize(form)
        for at in range(1, len(payload) - size + 1, size):
            numbers = struct.unpack_from(form, payload, at + 1)
            value = numbers[0] if len(numbers) == 1 else [numbers[n : n + 3] for n in (0, 3, 6)]
            if payload[at] < channels:  # firmware drops what is of no channel
                made.sense(name, payload[at], value, raw=True)
        if (len(payload) - 1) % size:
            raise Fail(0xFF)

    @made.many("retMany", doc="")
    def ret_many(request: ManyRequest) -> ManyReply:
        """Return the lowest byte of the offset, or fail with it, whatever else it is told."""
        code = request.offset & 0xFF
        if request.is_write and 0 < code < 0xF0:
            raise Fail(code)
        return ManyReply(code)

    made.function(
        "echoNote",
        signature="(first u8, note text[5]) (first u8, note text)",
        idempotent=True,
        doc="Returns the text.",
    )(lambda first, note: (first, note))
    made.function(
        "echoBlob",
        signature="(blob bytes[16]) (blob bytes)",
        idempotent=True,
        doc="Returns the bytes.",
    )(lambda blob: (blob,))

    @made.on_trigger("imu")
    def measure() -> None:
        nonlocal count
        count += 1
        made.sense("imu", 0, [(count, 0, 0), (0, 0, 0), (0, 0, 0)], raw=True)

    @made.on_trigger("flag")
    def turn() -> None:
        nonlocal is_set
        is_set = not is_set
        made.sense("flag", 0, is_set)
        made.sense("flag", 1, not is_set)

    return made
