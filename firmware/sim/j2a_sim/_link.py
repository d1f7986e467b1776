"""A transport into the UART of simulated firmware, in this process: `sim:fw.elf`.

In: bytes for the firmware. Out: what it answers. Time and waiting are those of `_timed_link`.
A `sim:` URL with `link=usb` goes over the chip's USB instead: see `_usb.link`.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final
from urllib.parse import unquote

from j2a_transports import BadUrl, OpenFailed, Option, Scheme, Transport, Url, Usage
from j2a_transports.options import text

from j2a_sim._avr import AvrSim
from j2a_sim._errors import SimError
from j2a_sim._options import frequency, rate, speed
from j2a_sim._timed_link import PATIENCE_S, SLICE_S, TimedLink
from j2a_sim._usb.link import UsbLink

# A gap on the wire that ends what one read returns, in characters.
GAP_CHARS: Final = 2
MOST_BYTES: Final = 64


class SimLink(TimedLink):
    """The UART of a simulated AVR as a transport.

    A read returns what has arrived up to a gap of two characters on the wire, at most some 64
    bytes.

    Args:
        sim: the simulator; it is booted here (see AvrSim.boot) unless it already listens.
        url: for messages.
        patience_s: after so many simulated seconds without a byte in either direction, time goes
            on no faster than real time, so that a reader that waits for nothing costs little;
            None: never.
        speed: 0: as fast as possible; otherwise simulated seconds per second at most, for hosts
            that measure by the wall clock.

    Attributes:
        sim: the simulator, for cycles, spans, counters and memory.

    Raises:
        SimError: the firmware does not turn its receiver on within a second.
    """

    def _set_up(self) -> None:
        if not self.sim.receiver_on:
            self.sim.boot()
        self.byte_time_s = self.sim.char_cycles / self.sim.frequency_hz

    def _send(self, data: bytes) -> None:
        self.sim.uart_write(data)

    @property
    def _readable(self) -> bool:
        return self.sim.readable > 0

    def _run_until_readable(self, cycles: int) -> None:
        self.sim.run_until_output(cycles, wakeable=True)

    def _run(self, cycles: int) -> None:
        self.sim.run(cycles, wakeable=True)

    def _collect(self) -> bytes:
        data = self.sim.uart_read()
        gap = int(GAP_CHARS * self.sim.char_cycles)
        # As many bytes at once as may be, for each call of C costs; where time is paced, only what
        # comes within a slice however slowly.
        at_once = max(1, self.sim.cycles(SLICE_S) // gap) if self._is_paced else MOST_BYTES
        is_quiet = False
        while not is_quiet and (room := MOST_BYTES - len(data)) > 0:
            most = min(room, at_once)
            self._pass(partial(self.sim.run_while_output, most=most), gap)
            more = self.sim.uart_read()
            is_quiet = len(more) < most and not self.sim.is_woken
            data += more
        return data


def _seconds(text: str) -> float | None:
    """a number of seconds above 0, or none."""
    return None if text.lower() == "none" else rate(text)


def _wire(text: str) -> str:
    """uart or usb."""
    if text not in {"uart", "usb"}:
        raise ValueError
    return text


_MCUS: Final = {"uart": "atmega328p", "usb": "atmega32u4"}
_OPEN: Final = Usage(
    "sim:ELF",
    "firmware in an AVR simulator, in simulated time",
    ("sim:demo.elf", "sim:demo.elf?mcu=atmega32u4&link=usb"),
    (
        Option(
            "mcu", text, f"the chip; {_MCUS['uart']}, with link=usb {_MCUS['usb']}, if not given"
        ),
        Option("freq", frequency, "clock of the chip", "16000000"),
        Option("link", _wire, "which part of the chip the bytes go through", "uart"),
        Option("uart", text, "number of the UART, else the first that the chip has"),
        Option(
            "baud", rate, "bit rate of the host's end of the UART, else the firmware's", "", "bit/s"
        ),
        Option(
            "patience",
            _seconds,
            "simulated time without a byte after which time goes on no faster than real time",
            f"{PATIENCE_S:g}",
        ),
        Option("speed", speed, "the most simulated seconds per second", "0"),
    ),
)
SCHEME: Final = Scheme(
    name="sim",
    open=_OPEN,
    system="simavr's library, a C compiler",
    starts_device=True,
    is_simulated=True,
)


def check_url(url: Url) -> tuple[str, dict[str, Any]]:
    """Return path and options of `sim:path/to/firmware.elf`; raises BadUrl."""
    path, parts = url.split_query()
    options: dict[str, Any] = url.options(parts, _OPEN)
    if not path:
        raise BadUrl(f"{url.text}: name the firmware, such as sim:demo.elf")
    for name in ("uart", "baud"):
        if options["link"] == "usb" and name in options:
            raise BadUrl(f"{url.text}: {name} is an option of a UART, and link=usb uses none")
    return unquote(path), options


def open_url(url: Url) -> Transport:
    """Open `sim:path/to/firmware.elf?mcu=atmega328p&freq=16000000&uart=0`.

    Returns:
        A SimLink or UsbLink with a simulator of its own.

    Raises:
        BadUrl: the path is missing, or an option is unknown or wrong.
        OpenFailed: the simulator cannot run this firmware, or the firmware does not come up; the
            message says what to do.
    """
    path, options = check_url(url)
    wire = options["link"]
    kind = UsbLink if wire == "usb" else SimLink
    try:
        sim = AvrSim(
            path,
            options.get("mcu", _MCUS[wire]),
            options["freq"],
            options.get("uart"),
            options.get("baud"),
        )
        try:
            return kind(sim, url.text, patience_s=options["patience"], speed=options["speed"])
        except BaseException:
            sim.close()  # one with USB would wait for the garbage collector
            raise
    except SimError as error:
        raise OpenFailed(f"{url.text}: {error}") from error
