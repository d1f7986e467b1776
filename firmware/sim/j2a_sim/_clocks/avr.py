"""Boards in simavr: the real firmware, cycle by cycle.

In: truth, bytes of the host with true times. Out: bytes of the board with true times, readings.
Rules: a board's cycles are what its crystal counts, so true times become cycles and cycles true
times by the oscillator alone; starts of frames come at the cycles that belong to their true times.
Readings are of the memory that the firmware's clock is made of, and disturb nothing.
"""

from __future__ import annotations

import struct
from collections import deque
from pathlib import Path
from typing import Final

import numpy as np
from j2a_spec import constants as c
from numpy.random import Generator

from j2a_sim._avr import AvrSim, chip_serial
from j2a_sim._clocks.delays import BAUD
from j2a_sim._clocks.frames import BoardFrames
from j2a_sim._clocks.memory import ClockMemory
from j2a_sim._clocks.native import REPLY_S, make
from j2a_sim._clocks.report import UNKNOWN, Readings
from j2a_sim._clocks.truth import Floats, Oscillator
from j2a_sim._errors import SimError
from j2a_sim._usb.descriptors import Described, parse_configuration
from j2a_sim._usb.link import find_endpoints

__all__ = ["AvrBoard", "build_firmware"]

FREQUENCY_HZ: Final = 16_000_000
CHIPS: Final = {"usb": ("avr-usb", "atmega32u4"), "serial": ("avr-serial", "atmega328p")}
QUIET_S: Final = 0.0005
IN_BYTES: Final = 512
WAITING: Final = 2
KEPT: Final = 64
LATEST_START_S: Final = 0.2


def build_firmware(link: str) -> Path:
    """Build the firmware of a board with the clock."""
    port, mcu = CHIPS[link]
    folder = make(mcu, f"PORT={port}", f"MCU={mcu}", "APP=builtins", "OPTIONS=-DJ2A_WITH_SYNC=1")
    return folder / "builtins.elf"


def _sync_interface(configuration: Described) -> int:
    """Return the number of the interface SyncUSB."""
    for interface in configuration.parts:
        if interface.fields.bInterfaceSubClass == c.SYNCUSB_SUBCLASS:
            return int(interface.fields.bInterfaceNumber)
    raise SimError("the firmware has no interface SyncUSB")


class AvrBoard:
    """One board; see NativeBoard for what it is given.

    Attributes:
        sim: the simulator.
        readings: what the clock showed.
        memory: of the clock.
        frames: as given.
        ends: cycles at which transfers and bytes from the board ended, with how many bytes came.
        out_address: the endpoint to the board.
    """

    def __init__(
        self,
        firmware: Path,
        *,
        rng: Generator,
        oscillator: Oscillator,
        frames: BoardFrames | None,
        link: str,
        times_s: Floats,
        number: int = 1,
    ) -> None:
        mcu = CHIPS[link][1]
        baud = BAUD if link == "serial" else None
        serial = chip_serial(number)
        self.sim = AvrSim(firmware, mcu, FREQUENCY_HZ, host_baud=baud, serial=serial)
        self._oscillator, self._is_usb = oscillator, link == "usb"
        self.frames = frames
        self._began_s = float(oscillator.elapsed_s(rng.uniform(0, LATEST_START_S)))
        self._cycles = self._cycle_of(times_s)
        self._next = 0
        count = len(times_s)
        self.readings = Readings(
            np.zeros(count, np.uint64),
            np.zeros(count, np.uint8),
            np.zeros(count, np.uint8),
            np.full(count, UNKNOWN, np.uint32),
        )
        self.backwards = 0
        self.ends: deque[tuple[int, int]] = deque(maxlen=KEPT)
        self.out_address = 0
        self.memory = ClockMemory(self.sim)
        if frames is not None:
            self._plan(frames)
            self._plug_in()
        else:
            self.sim.boot()

    # ------------------------------------------------------------------ time

    def _cycle_of(self, true_s: Floats | float) -> Floats:
        counted = np.asarray(self._oscillator.elapsed_s(true_s))
        return np.asarray((counted - self._began_s) * FREQUENCY_HZ)

    def true_s(self, cycle: float) -> float:
        """The true time of a cycle."""
        return float(self._oscillator.true_s(cycle / FREQUENCY_HZ + self._began_s))

    def _plan(self, frames: BoardFrames) -> None:
        cycles = self._cycle_of(frames.starts_s)
        coming = cycles > self.sim.cycle
        self.sim.usb.plan_frames(
            cycles[coming].tolist(), frames.numbers[coming].tolist(), frames.lost[coming].tolist()
        )

    # ------------------------------------------------------------------ the link

    def _plug_in(self) -> None:
        bus = self.sim.usb
        found = bus.enumerate()
        self._in, self._out = find_endpoints(parse_configuration(found.configuration))
        self.out_address = self._out.address
        self._sync_interface = _sync_interface(parse_configuration(found.configuration))
        self._waiting: set[int] = set()
        for _ in range(WAITING):
            self._listen()

    def _listen(self) -> None:
        bus = self.sim.usb
        self._waiting.add(bus.submit_in(self._in.address, IN_BYTES, packet=self._in.packet))

    def call(self, at_s: float, frame: bytes) -> tuple[bytes, float] | None:
        """Send a frame to the board, and wait for what comes back; see NativeBoard.call()."""
        self.run(at_s)
        if self._is_usb:
            self.sim.usb.submit_out(self._out.address, frame, packet=self._out.packet)
        else:
            self.sim.uart_write(frame)
        end = int(self._cycle_of(at_s + REPLY_S))
        data, came = b"", 0
        while self.sim.cycle < end:
            quiet = self.sim.cycle + int(QUIET_S * FREQUENCY_HZ)
            self._advance(min(quiet, end), True)
            more, cycle = self.take()
            if more:
                data, came = data + more, cycle
            elif data:
                break
        return (data, self.true_s(came)) if data else None

    def frame_seen(self, at_s: float) -> tuple[int, int, float]:
        """Ask the board by SyncUSB in which frame a request comes; see NativeBoard.frame_seen()."""
        self.run(at_s)
        setup = struct.pack(
            "<BBHHH", c.SYNCUSB_REQUEST_TYPE, c.SYNCUSB_SEEN, 0, self._sync_interface,
            c.SYNCUSB_SEEN_SIZE,
        )  # fmt: skip
        answer, cycle = self._finish(self.sim.usb.submit_control(setup), at_s + REPLY_S)
        _, frame, age_us = struct.unpack("<HHH", answer)
        return frame, age_us, self.true_s(cycle)

    def packet(self, at_s: float, packet: bytes) -> float:
        """Send a packet to SyncUSB; see NativeBoard.packet()."""
        self.run(at_s)
        sent = self.sim.usb.submit_out(c.SYNCUSB_OUT, packet)
        return self.true_s(self._finish(sent, at_s + REPLY_S)[1])

    def _finish(self, transfer: int, end_s: float) -> tuple[bytes, int]:
        """Run until a transfer has ended; returns what came, and the cycle of its end."""
        end = int(self._cycle_of(end_s))
        while self.sim.cycle < end:
            self._advance(end, True)
            for done in self.sim.usb.completed():
                self.ends.append((done.cycle, len(done.data)))
                if done.id == transfer and done.status == "ok":
                    return bytes(done.data), done.cycle
                if done.id in self._waiting:
                    self._waiting.discard(done.id)
                    self._listen()
        raise SimError("a board does not answer at SyncUSB")

    def take(self) -> tuple[bytes, int]:
        """Take what the board has sent; returns it, and the cycle at which the last of it came."""
        if not self._is_usb:
            got = self.sim.uart_read_stamped()
            self.ends.extend((byte.cycle, 1) for byte in got)
            return bytes(byte.value for byte in got), got[-1].cycle if got else 0
        data, cycle = b"", 0
        for done in self.sim.usb.completed():
            self.ends.append((done.cycle, len(done.data)))
            if done.id not in self._waiting:
                continue
            self._waiting.discard(done.id)
            self._listen()
            if done.data:
                data, cycle = data + done.data, done.cycle
        return data, cycle

    def run(self, until_s: float) -> None:
        """Let true time pass, and read the clock when it is time to."""
        self._advance(float(self._cycle_of(until_s)), False)

    def _advance(self, cycle: float, stop: bool) -> None:
        """Run up to a cycle, or until something has come, with all readings on the way."""
        sim = self.sim
        while sim.cycle < cycle:
            is_due = self._next < len(self._cycles)
            reading = float(self._cycles[self._next]) if is_due else np.inf
            left = int(min(cycle, reading)) - sim.cycle
            if left > 0:
                if not stop:
                    sim.run(left)
                elif (self._is_usb and sim.run_until_usb(left)) or (
                    not self._is_usb and sim.run_until_output(left)
                ):
                    return
            elif is_due and reading <= cycle:
                self._read(reading)
            else:
                return

    def _read(self, cycle: float) -> None:
        at, shown = self._next, self.readings
        self._next += 1
        clock, state, epoch, uncertainty = self.memory.read(cycle)
        shown.clock_us[at], shown.state[at] = clock, state
        shown.epoch[at], shown.uncertainty_us[at] = epoch, uncertainty
        if at and shown.epoch[at - 1] == epoch and shown.clock_us[at - 1] > clock:
            self.backwards += 1

    def restart(self, off_s: float, on_s: float) -> None:
        """Lose the power at a true time, and get it back at another."""
        self.run(off_s)
        if self._is_usb:
            self.sim.usb.unplug()
        self.sim.run(max(0, int(float(self._cycle_of(on_s))) - self.sim.cycle))
        while self._next < len(self._cycles) and self._cycles[self._next] <= self.sim.cycle:
            self._next += 1
        self.sim.reset()
        self.memory.start()
        if self._is_usb:
            self.sim.usb.completed()
            self._plug_in()
        else:
            self.sim.boot()
