"""The AVR at 1 Mbaud: requests as fast as `j2a.rxbuf` allows, SIFs in the other direction.

In: the demo in the simulator, in exact time, and a host that never lets the wire rest while it may
send. Out: every reply checked against the oracle, every SIF counted, no overrun; and the share of
the wire that both directions used. A control sends more than may be in flight, and is caught.
"""

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import CLOCK_ADJUST, PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

pytestmark = pytest.mark.avr

DEMO = ("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns")
NAMES = [*c.BUILTINS, "a2jGetInterface", *DEMO]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
ECHO = OPCODE[c.GET_ECHO]
SIF_PERIODIC = 0x20
BAUD = 1_000_000
SIF_MS = 3
MARKERS = (c.SOF, c.SOS, c.ESC)


@dataclass
class Seen:
    """What a run has shown.

    Attributes:
        replies: requests that were answered rightly.
        wrong: frames from the device that are neither the reply that is due nor a SIF.
        sifs: what the SIFs have counted.
        up, down: shares of the wire's rate, host to device and back, 0..1.
    """

    replies: int = 0
    wrong: list[object] = field(default_factory=list)
    sifs: list[int] = field(default_factory=list)
    up: float = 0.0
    down: float = 0.0


def random_payloads() -> Iterator[bytes]:
    """Of every length up to what fits, each byte a marker now and then."""
    rng = random.Random(1)
    while True:
        length = rng.randrange(0, 56)
        yield bytes(rng.choice((*MARKERS, *range(256))) for _ in range(length))


def escaped_payloads() -> Iterator[bytes]:
    """Nothing but bytes that are escaped."""
    rng = random.Random(2)
    while True:
        yield bytes(rng.choices(MARKERS, k=rng.randrange(1, 40)))


def short_payloads() -> Iterator[bytes]:
    """None at all: as many frames as possible."""
    while True:
        yield b""


def long_payloads() -> Iterator[bytes]:
    """The longest that may be in flight, one request at a time."""
    rng = random.Random(3)
    while True:
        yield bytes(rng.choices(range(0x80, 0xE0), k=119))


class Host:
    """Keeps requests in flight, and judges what comes back. All times are simulated ones."""

    def __init__(self, sim: AvrSim, payloads: Iterator[bytes], limit: int) -> None:
        self.sim, self.limit = sim, limit
        self.payloads = payloads
        self.next = self.request(0)
        self.due: deque[tuple[Frame, int]] = deque()
        self.in_flight = 0
        self.rest = b""
        self.seen = Seen()

    def request(self, seq: int) -> Frame:
        return Frame(c.SOF, seq, ECHO, next(self.payloads))

    def send(self) -> None:
        """Put every request on the wire that the device has room for."""
        while self.in_flight + len(data := encode(self.next)) <= self.limit:
            self.sim.uart_write(data)
            self.due.append((self.next, len(data)))
            self.in_flight += len(data)
            self.next = self.request((self.next.seq + 1) % 256)

    def receive(self) -> None:
        """Wait until the next reply may be whole, and take the frames that are."""
        due = len(encode(self.answer(self.due[0][0]))) if self.due else 1
        missing = max(1, due - len(self.rest))
        if self.sim.run_until_output(self.sim.cycles(0.001)):
            self.sim.run(int(self.sim.char_cycles * (missing - 1)))
        self.rest += self.sim.uart_read()
        if len(self.rest) < due and self.rest[:1] != bytes((c.SOS,)):
            return
        events = decode(self.rest)
        # The last one may be cut short: what it has so far stays until the rest of it has come.
        keep = b"" if not events or isinstance(events[-1], Frame) else self.tail()
        for event in events if not keep else events[:-1]:
            self.judge(event)
        self.rest = keep

    def tail(self) -> bytes:
        """From the last start of a frame on."""
        return self.rest[max(self.rest.rfind(bytes((start,))) for start in (c.SOF, c.SOS)) :]

    def judge(self, event: object) -> None:
        if isinstance(event, Frame) and (event.start, event.opcode) == (c.SOS, SIF_PERIODIC):
            self.seen.sifs.append(int.from_bytes(event.payload, "little"))
        elif self.due and event == self.answer(self.due[0][0]):
            self.in_flight -= self.due.popleft()[1]
            self.seen.replies += 1
        else:
            self.seen.wrong.append(event)

    @staticmethod
    def answer(request: Frame) -> Frame:
        return Frame(c.SOF, request.seq, c.ECHO, request.payload)

    def run(self, seconds: float) -> Seen:
        """Send and receive for so long, then take what is still due."""
        start = self.sim.counters
        first, end = self.sim.cycle, self.sim.cycle + self.sim.cycles(seconds)
        while self.sim.cycle < end and not self.seen.wrong:
            self.send()
            self.receive()
        characters = (self.sim.cycle - first) / self.sim.char_cycles
        self.seen.up = (self.sim.counters.bytes_in - start.bytes_in) / characters
        self.seen.down = (self.sim.counters.bytes_out - start.bytes_out) / characters
        return self.seen


def ask(sim: AvrSim, function: str, payload: bytes = b"") -> Frame:
    """One call while nothing else is in flight; SIFs are left out, none of them cut in two."""
    sim.uart_write(encode(Frame(c.SOF, 0xAA, OPCODE[function], payload)))
    got = b""
    end = sim.cycle + sim.cycles(0.1)
    while sim.cycle < end:
        sim.run(sim.cycles(0.001))
        got += sim.uart_read()
        events = decode(got)
        for event in events if events and isinstance(events[-1], Frame) else ():
            if isinstance(event, Frame) and (event.start, event.seq) == (c.SOF, 0xAA):
                return event
    raise AssertionError(f"{function} is not answered: {decode(got)}")


@pytest.fixture
def sim(request, monkeypatch, build):
    """The demo, by indirect parametrization also with a clock that is being slewed."""
    has_clock = getattr(request, "param", False)
    options = {"OPTIONS": "-DJ2A_WITH_SYNC=1"} if has_clock else {}
    with AvrSim(build(port="avr-serial", BAUD=str(BAUD), **options)) as sim:
        sim.boot()
        sim.run(sim.cycles(0.001))
        assert sim.baud == BAUD
        if has_clock:  # a2jClock stands before the functions of the demo
            monkeypatch.setitem(OPCODE, c.CLOCK, OPCODE[DEMO[0]])
            for name in DEMO:
                monkeypatch.setitem(OPCODE, name, OPCODE[name] + 1)
            for time in (1_700_000_000_000_000, 1_700_000_000_500_000):
                line = {"local": 0, "time": time, "rate": 70_000, "uncertainty": 9, "wander": 100}
                adjust = CLOCK_ADJUST.build({"mode": c.CLOCK_SLEW, **line})
                assert ask(sim, c.CLOCK, adjust).opcode == 0
        yield sim


def rxbuf(sim: AvrSim) -> int:
    """What the device announces."""
    reply = ask(sim, c.MANY, bytes((OPCODE[c.GET_PROPERTIES], 0, 0, 0, 0, 0)))
    values = {item.key: item.value for item in PROPERTIES.parse(reply.payload[6:])}
    return int(values["j2a.rxbuf"])


@pytest.mark.parametrize(
    ("payloads", "seconds", "share"),
    [
        (random_payloads, 2.0, 0.50),
        (escaped_payloads, 0.5, 0.50),
        (short_payloads, 0.25, 0.42),
        (long_payloads, 0.25, 0.46),
    ],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
@pytest.mark.parametrize("sim", [False, True], ids=["plain", "clock"], indirect=True)
def test_nothing_is_lost(sim, payloads, seconds, share):
    limit = rxbuf(sim)
    assert ask(sim, "sifPeriod", bytes((SIF_MS, 0))) == Frame(c.SOF, 0xAA, 0)
    host = Host(sim, payloads(), limit)
    seen = host.run(seconds)
    assert seen.wrong == []
    share *= 0.8 if c.CLOCK in OPCODE else 1  # the clock takes its time, too
    assert min(seen.up, seen.down) > share, (seen.up, seen.down)
    host.limit = 0  # the last replies
    host.run(0.02)
    assert (seen.wrong, len(host.due)) == ([], 0)
    assert sim.counters.overruns == 0
    assert ask(sim, "overruns").payload == bytes(2)
    # Each SIF came, in order, in its time.
    assert seen.sifs == list(range(len(seen.sifs)))
    assert len(seen.sifs) == pytest.approx((seconds + 0.02) * 1000 / SIF_MS, abs=2)


def test_more_in_flight_than_announced_is_caught(sim):
    """The control: the same load without the limit loses bytes, and every check above sees it."""
    assert ask(sim, "sifPeriod", bytes((SIF_MS, 0))) == Frame(c.SOF, 0xAA, 0)
    host = Host(sim, random_payloads(), 4 * rxbuf(sim))
    seen = host.run(0.5)
    (wrong,) = seen.wrong[:1]
    assert isinstance(wrong, Frame)
    assert (wrong.opcode, wrong.payload) == (c.ERR_FRAMING, bytes((c.SITE_LOST, 0)))
    sim.run(sim.cycles(0.1))
    assert int.from_bytes(ask(sim, "overruns").payload, "little") > 0
