"""Serves simulated boards over USB/IP until it is told to end: `j2a sim usb`.

In: ELF files, and lines such as `unplug 1-1` on standard input. Out: what a user has to know to
attach the boards, and the figures of the run.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, TextIO

from j2a_sim._avr import AvrSim, chip_serial
from j2a_sim._errors import SimError
from j2a_sim._runner import stopped_by_signals
from j2a_sim._usbip import protocol
from j2a_sim._usbip.server import UsbipServer

LINE_MAX: Final = 4096


def parse_address(text: str) -> tuple[str, int]:
    """HOST:PORT, the port from 0 to 65535 (0: any that is free)."""
    host, colon, port = text.rpartition(":")
    if not colon:
        host, port = text, str(protocol.TCP_PORT)
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 0xFFFF:
        raise ValueError
    return host, int(port)


def summary(busid: str, sim: AvrSim, wall_s: float) -> str:
    """One line with the exact figures of a board's run, as `name=value` words."""
    c = sim.usb.counters
    return (
        f"figures of the run: busid={busid} cycles={sim.cycle} simulated_s={sim.time_s:.6f} "
        f"wall_s={wall_s:.3f} "
        f"bytes_in={c.bytes_in} bytes_out={c.bytes_out} transactions={c.transactions} "
        f"naks={c.naks} sofs={c.sofs} wrong_toggles={c.wrong_toggles} "
        f"stack_bytes={sim.stack_bytes}"
    )


def _tell(file: TextIO, line: str) -> None:
    """Write a line at once; print() writes its end apart, behind what another thread writes."""
    file.write(f"{line}\n")
    file.flush()


class _Commands:
    """Reads `plug BUSID` and `unplug BUSID` from a file, as far as it can be read."""

    def __init__(self, server: UsbipServer, fileno: int, err: TextIO) -> None:
        self._server, self._fileno, self._err = server, fileno, err
        self._line = b""

    def __call__(self) -> bool:
        """Do what has been asked for; returns False at the end of the file."""
        data = os.read(self._fileno, LINE_MAX)
        *lines, rest = (self._line + data).split(b"\n")
        self._line = rest[-LINE_MAX:]
        for line in lines:
            self._do(line.decode("utf-8", "replace").split())
        return bool(data)

    def _do(self, words: list[str]) -> None:
        actions = {"plug": self._server.plug, "unplug": self._server.unplug}
        try:
            if len(words) != 2 or words[0] not in actions:
                raise SimError(f"{' '.join(words)!r} is neither plug BUSID nor unplug BUSID")
            actions[words[0]](words[1])
        except SimError as error:
            _tell(self._err, f"j2a sim: {error}")
        else:
            _tell(self._err, f"{words[1]}: {words[0]}ged")


def run_usbip(
    elfs: Sequence[Path | str],
    address: tuple[str, int] = ("127.0.0.1", protocol.TCP_PORT),
    speed: float = 1.0,
    *,
    mcu: str = "atmega32u4",
    frequency_hz: int = 16_000_000,
    stop: threading.Event | None = None,
    commands: int | None = None,
    out: TextIO | None = None,
    err: TextIO | None = None,
) -> int | None:
    """Serve firmware in simulated AVRs over USB/IP until a signal or `stop` ends it.

    Prints `exporting BUSID at HOST:PORT` to `out` for each board when it can be attached, and the
    figures of the run to `err` at the end.

    Args:
        elfs: the firmware of each board; the chips have the serial numbers chip_serial(1), (2), ...
        address: host and port to listen on; port 0: any that is free.
        speed: see UsbipServer.
        mcu: as simavr names it.
        frequency_hz: the clock.
        stop: ends the run when set.
        commands: file descriptor from which lines `unplug BUSID` and `plug BUSID` are taken.
        out: standard output when None.
        err: standard error when None.

    Returns:
        The number of the signal that ended it, such as signal.SIGINT; None when there was none.

    Raises:
        SimError: see AvrSim and UsbipServer; FirmwareStopped when a firmware crashed.
        j2a_transports.OpenFailed: the address cannot be listened on.
    """
    stop = stop or threading.Event()
    out, err = out or sys.stdout, err or sys.stderr
    began_s = time.monotonic()

    def say(text: str) -> None:
        _tell(err, text)

    with ExitStack() as stack:
        sims = [
            stack.enter_context(AvrSim(elf, mcu, frequency_hz, serial=chip_serial(number)))
            for number, elf in enumerate(elfs, 1)
        ]
        signals = stack.enter_context(stopped_by_signals(stop))
        server = UsbipServer(sims, *address, speed=speed, say=say)
        stack.callback(server.close)
        place = f"[{address[0]}]" if ":" in address[0] else address[0]
        for busid in server.busids:
            print(f"exporting {busid} at {place}:{server.port}", file=out)
        print(_how_to_attach(server.busids[0], address[0], server.port), file=out, flush=True)
        try:
            if commands is None:
                server.serve(stop)
            else:
                server.serve(stop, commands, _Commands(server, commands, err))
        finally:
            for busid, sim in zip(server.busids, sims, strict=True):
                say(summary(busid, sim, time.monotonic() - began_s))
        return signals[0] if signals else None


def _how_to_attach(busid: str, host: str, port: int) -> str:
    """The commands that make a board appear in a Linux kernel."""
    tool = "usbip" if port == protocol.TCP_PORT else f"usbip --tcp-port {port}"
    return (
        "attach it on a Linux machine that reaches this address:\n"
        f"  sudo modprobe vhci-hcd; sudo {tool} attach -r {host} -b {busid}\n"
        f"and let go of it (PORT is what usbip port shows):\n"
        "  sudo usbip detach -p PORT"
    )
