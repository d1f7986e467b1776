"""The sensors app in the simulator, and loads for it: what its tests and its budget drive it with.

In: a simulator with the program of apps/sensors. Out: requests, edges and voltages at its pins;
replies, samples and SIFs.
Rules: all times are simulated ones, so each run is the same; a wrong answer is an AssertionError.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

__all__ = [
    "ADC",
    "BACKWARD",
    "CHIPS",
    "DIST_IR",
    "FORWARD",
    "LAMP",
    "MISSES",
    "QUAD",
    "QUAD_AT",
    "SERVO",
    "Board",
    "Chip",
    "goes_on",
    "load",
    "values",
]

FORWARD = ((1, 0), (1, 1), (0, 1), (0, 0))  # A and B after each step
BACKWARD = ((0, 1), (1, 1), (1, 0), (0, 0))
QUAD, DIST_IR, ADC, MISSES, SERVO, QUAD_AT, LAMP = range(7)  # ids in transds.def
FORMS = {QUAD: "h", DIST_IR: "H", ADC: "H", MISSES: "H", SERVO: "b", QUAD_AT: "h", LAMP: "?"}
STORM_CYCLES = 205  # between two edges: less than the interrupt takes, so nothing else gets on


def values(transducer: int, sample: bytes) -> list[tuple[int, int]]:
    """The time in us and the raw value of each channel, of a sample or a sample SIF."""
    return list(struct.iter_unpack(f"<Q{FORMS[transducer]}", sample))


@dataclass(frozen=True, slots=True)
class Chip:
    """What differs between the chips.

    Attributes:
        uart: number of the USART that is the link.
        encoders, servos, lamp: the pins that they are wired to.
        analog: channels of the ADC; none where the chip has no ADC.
        quad, servo_a, servo_b, receive: numbers of interrupt vectors.
    """

    uart: str
    encoders: list[str]
    servos: list[str]
    lamp: str
    analog: tuple[int, ...]
    quad: int
    servo_a: int
    servo_b: int
    receive: int

    @property
    def sensors(self) -> tuple[int, ...]:
        """Those that the app has on this chip."""
        return (QUAD, DIST_IR, ADC, MISSES) if self.analog else (QUAD, MISSES)


CHIPS = {
    "atmega328p": Chip(
        "0", ["PD2", "PD3", "PD4", "PD5"], ["PB1", "PB2"], "PB5", (0, 1, 2, 3), 5, 11, 12, 18
    ),
    "atmega32u4": Chip(
        "1", ["PB0", "PB1", "PB2", "PB3"], ["PB5", "PB6"], "PC7", (7, 6, 5, 4), 9, 17, 18, 25
    ),
    "atmega32u2": Chip("1", ["PB0", "PB1", "PB2", "PB3"], ["PC6", "PC5"], "PD5", (), 9, 15, 16, 23),
}


class Board:
    """The sensors app with its encoders, servos, lamp and host.

    Args:
        sim: the program's path, or a simulator that has not run yet.
        mcu: the chip, one of CHIPS; with a simulator it is that one's.
        level: of all the encoders' wires at the start; None: nobody drives them.
    """

    def __init__(
        self, sim: AvrSim | Path | str, mcu: str = "atmega328p", level: int | None = 0
    ) -> None:
        self.sim = sim if isinstance(sim, AvrSim) else AvrSim(sim, mcu, uart=CHIPS[mcu].uart)
        self.chip = CHIPS[self.sim.mcu]
        self.pins = self.sim.pins
        if level is not None:
            for pin in self.chip.encoders:
                self.pins.drive(pin, level)
        self.pins.watch(*self.chip.servos, self.chip.lamp)
        self.sifs: list[Frame] = []
        self._start()
        self.names = self.call(0).payload[:-1].decode().split("\0")

    def reset(self) -> None:
        """Reset the chip; what was on the wire is gone."""
        self.sim.reset()
        self.sim.uart_read()
        self._start()

    def _start(self) -> None:
        self.sim.boot()
        self.sim.run(5000)
        self.seq = 0
        self.sifs.clear()
        self._received = b""

    def call(self, function: int | str, payload: bytes = b"", limit_s: float = 0.5) -> Frame:
        """One call; the SIFs that come meanwhile go to `sifs`."""
        opcode = function if isinstance(function, int) else self.names.index(function)
        self.seq = (self.seq + 1) % 256
        self.sim.uart_write(encode(Frame(c.SOF, self.seq, opcode, payload)))
        end = self.sim.cycle + self.sim.cycles(limit_s)
        while self.sim.cycle < end:
            self.sim.run_until_output(2000)
            for frame in self._frames():
                assert (frame.start, frame.seq) == (c.SOF, self.seq)
                return frame
        raise AssertionError(f"no answer to {function}: {self._received.hex()}")

    def ask(self, function: int | str, form: str = "", payload: bytes = b"") -> tuple[int, ...]:
        """The values in the reply to a call that succeeds."""
        reply = self.call(function, payload)
        assert reply.opcode == 0, reply
        return struct.unpack(f"<{form}", reply.payload)

    def transd(self, transducer: int, item: int, value: bytes = b"") -> Frame:
        """One call of a2jTransd: a read without a value, else a write."""
        return self.call(c.TRANSD, bytes((transducer, item)) + value)

    def enable(self, *sensors: int, on: bool = True) -> None:
        """Let sensors send sample SIFs, or stop them."""
        for sensor in sensors:
            assert self.transd(sensor, c.TRANSD_ENABLED, bytes((on,))).payload == bytes((on,))

    def send_each(self, ms: int, *sensors: int) -> None:
        """Let sensors send sample SIFs that are due so many milliseconds apart, or more."""
        for sensor in sensors:
            period = struct.pack("<I", 1000 * ms)
            assert self.transd(sensor, c.TRANSD_PERIOD, period).payload == period
        self.enable(*sensors)

    def quiet(self) -> None:
        """No sample SIFs."""
        self.enable(*self.chip.sensors, on=False)

    def sample(self, transducer: int) -> list[tuple[int, int]]:
        """The newest sample: time in us and raw value of each channel, zeros where none came."""
        reply = self.transd(transducer, c.TRANSD_SAMPLE)
        assert reply.opcode == 0, reply
        return values(transducer, reply.payload)

    def try_set(self, actuator: int, *raw: int, channel: int = 0) -> Frame:
        """The reply to a write of SET, at once, from a channel on."""
        form = f"<BQ{len(raw)}{FORMS[actuator]}"
        return self.transd(actuator, c.TRANSD_SET, struct.pack(form, channel, 0, *raw))

    def set(self, actuator: int, *raw: int, channel: int = 0) -> None:
        """Set channels of an actuator at once."""
        assert self.try_set(actuator, *raw, channel=channel).opcode == 0

    def encoder(self, channel: int) -> tuple[int, int]:
        """Count and illegal transitions."""
        return self.sample(QUAD)[channel][1], self.sample(MISSES)[channel][1]

    def run_to(self, cycle: int) -> None:
        """Run up to a cycle; SIFs may come."""
        self.sim.run(max(0, cycle - self.sim.cycle))
        assert not self._frames()

    def pause(self, seconds: float) -> None:
        """Run for a time; SIFs may come."""
        self.run_to(self.sim.cycle + self.sim.cycles(seconds))

    def talk_until(self, cycle: int) -> int:
        """Echoes of all lengths without a pause; returns how many, all of them answered right."""
        count = 0
        while self.sim.cycle < cycle:
            payload = bytes(range(count % 120))
            assert self.call(c.GET_ECHO, payload) == Frame(c.SOF, self.seq, c.ECHO, payload)
            count += 1
        return count

    def turn(
        self,
        channel: int,
        steps: int,
        start: int,
        distance: int,
        levels: tuple[tuple[int, int], ...] = FORWARD,
    ) -> int:
        """Schedule so many steps of an encoder, which stands at A = B = 0; returns the end."""
        wires = self.chip.encoders[2 * channel : 2 * channel + 2]
        now = [0, 0]
        for step in range(steps):
            for wire in (0, 1):
                if levels[step % 4][wire] != now[wire]:
                    now[wire] = levels[step % 4][wire]
                    self.pins.drive(wires[wire], now[wire], start + step * distance)
        return start + steps * distance

    def exercise(self, distance: int = 0, period_ms: int = 3, steps: int = 4000) -> None:
        """All interrupts at once, all functions, the longest frames: what makes the stack deepest.

        Args:
            distance: cycles between the steps of both encoders; 0: as few as there may be beside
                requests that are longer than a ring of 64 bytes, or fit into one of 128.
            period_ms: of the SIFs.
            steps: of each encoder, a multiple of 4; it lasts so long.
        """
        distance = distance or (617 if self.chip.analog else 1601)
        self.set(SERVO, 100, -100)
        self.send_each(period_ms, *self.chip.sensors)
        self.set(QUAD_AT, 0, 0)
        # Both encoders, at changing distances from the other interrupts.
        start = end = self.sim.cycle + 1000
        for channel in (0, 1):
            end = self.turn(channel, steps, start, distance)
        many = self.names.index(c.MANY)
        header = struct.pack("<BBI", self.names.index("a2jEchoMany"), c.FLAG_WRITE, 0)
        properties = struct.pack("<BBI", self.names.index("a2jGetProperties"), 0, 0)
        descriptors = struct.pack("<BBI", self.names.index(c.GET_TRANSDS), 0, 0)
        marker = bytes((c.SOF, c.SOS, c.ESC))
        count = 0
        while self.sim.cycle < end:
            for transducer in (*self.chip.sensors, SERVO, QUAD_AT, LAMP):
                self.sample(transducer)
            count += 1
            self.set(LAMP, count & 1)
            self.set(SERVO, count % 100, channel=1)
            for name in ("overruns", "a2jDebug"):
                self.call(name)
            assert self.call(many, header + bytes(60)).opcode == 0
            assert self.call(many, properties).opcode == 0
            assert self.call(many, descriptors).opcode == 0
            assert self.call(c.GET_ECHO, marker * 20).payload == marker * 20
        assert [self.encoder(channel) for channel in (0, 1)] == [(steps, 0), (steps, 0)]

    def storm(self, steps: int = 16000) -> None:
        """Edges that leave no time for anything, while requests come in that nobody answers.

        Afterwards the device answers again, and sends no SIFs.
        """
        self.send_each(1, *self.chip.sensors)
        self.set(SERVO, 0)
        start = end = self.sim.cycle + 1000
        for channel in (0, 1):
            end = self.turn(channel, steps, start, STORM_CYCLES)
        while self.sim.cycle < end + 100_000:
            self._send("overruns")
            self.sim.run(30_000)
        for sensor in self.chip.sensors:
            self._send(c.TRANSD, bytes((sensor, c.TRANSD_ENABLED, 0)))
            self.sim.run(50_000)
        while self.sim.run_until_output(self.sim.cycles(0.03)):  # longer than the byte timeout
            self.sim.uart_read()
        self._received = b""
        assert self.encoder(0) != (0, 0)
        assert self.call(c.GET_ECHO, b"alive").payload == b"alive"

    def _send(self, name: str, payload: bytes = b"") -> None:
        self.seq = (self.seq + 1) % 256
        self.sim.uart_write(encode(Frame(c.SOF, self.seq, self.names.index(name), payload)))

    def _frames(self) -> list[Frame]:
        self._received += self.sim.uart_read()
        if goes_on(self._received):
            return []
        events = decode(self._received)
        frames = [event for event in events if isinstance(event, Frame)]
        if len(frames) != len(events):
            return []
        self._received = b""
        self.sifs += [frame for frame in frames if frame.start == c.SOS]
        return [frame for frame in frames if frame.start == c.SOF]


def goes_on(received: bytes) -> bool:
    """Whether the last frame is shorter than its length says; escapes may make it longer still.

    Bytes come one by one, and to decode all of them with each takes longer than the simulation.
    """
    body = received[max(received.rfind(marker) for marker in c.MARKERS) + 1 :]
    at = length = 0
    for _ in range(c.HEADER):
        is_escape = body[at : at + 1] == bytes((c.ESC,))
        at += 1 + is_escape
        if at > len(body):
            return True
        length = body[at - 1] + is_escape
    return len(body) < at + length + 1


def load(sim: AvrSim) -> None:
    """All that makes the stack of apps/sensors deep, within a simulated second.

    Args:
        sim: with the program, for a chip in CHIPS, and its UART; it has not run yet.

    Raises:
        AssertionError: the device answers wrong, so it was not loaded.
    """
    board = Board(sim)
    for channel in board.chip.analog[:2]:
        sim.adc.set_volts(channel, 0.5)
    board.exercise()
    board.storm()
