"""The AVR firmware in the cycle-exact simulator: sizes, cycles, the serial port, exact timing."""

import random
from pathlib import Path

import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.grammar import PROPERTIES
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.budget.sensor_load import goes_on

pytestmark = pytest.mark.avr

DEMO = ("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns")
NAMES = [*c.BUILTINS, "a2jGetInterface", *DEMO]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
ECHO = OPCODE[c.GET_ECHO]
RXBUF = 128


class Board:
    """Demo firmware in the simulator; all times are simulated ones."""

    def __init__(self, elf, frequency_hz=16_000_000):
        self.sim = AvrSim(elf, frequency_hz=frequency_hz)
        self.sim.boot()
        self.pause(1)  # the first byte after the reset

    def pause(self, ms):
        self.sim.run(self.sim.cycles(ms / 1000))

    def send(self, data):
        """Put bytes on the wire and wait until the last one has arrived."""
        self.sim.uart_write(data)
        self.sim.run(int(self.sim.char_cycles * len(data)))

    def listen(self, ms):
        """Everything that comes within some time."""
        self.pause(ms)
        return decode(self.sim.uart_read())

    def ask(self, data, count, limit_ms=2000):
        """Send, and wait for so many whole frames."""
        self.sim.uart_write(data)
        got = b""
        end = self.sim.cycle + self.sim.cycles(limit_ms / 1000)
        while True:
            events = [] if goes_on(got) else decode(got)
            if len(events) >= count and isinstance(events[count - 1], Frame):
                return events
            assert self.sim.cycle < end, decode(got)
            self.sim.run_until_output(self.sim.cycles(0.001))
            got += self.sim.uart_read()

    def call(self, function, payload=b"", seq=1):
        """One call; returns the reply."""
        (reply,) = self.ask(encode(Frame(c.SOF, seq, OPCODE[function], payload)), 1)
        assert (reply.start, reply.seq) == (c.SOF, seq)
        return reply


@pytest.fixture(scope="module")
def elf(build):
    return build(port="avr-serial")


@pytest.fixture
def board(elf):
    board = Board(elf)
    yield board
    board.sim.close()


@pytest.mark.parametrize(("baud", "step"), [(115200, 17), (1000000, 1)])
def test_echo(build, baud, step):
    board = Board(build(port="avr-serial", **({} if baud == 115200 else {"BAUD": str(baud)})))
    assert board.sim.baud == pytest.approx(baud, rel=0.022)
    rng = random.Random(baud)
    for length in range(0, 256, step):
        payload = bytes(rng.choices((c.SOF, c.SOS, c.ESC, 0x11, 0x7C, 0xEC, 0xFF), k=length))
        assert board.call(c.GET_ECHO, payload, length) == Frame(c.SOF, length, c.ECHO, payload)
    assert board.sim.counters.overruns == 0
    board.sim.close()


def test_largest_frames_back_to_back_at_1_mbaud(build):
    """2 kB without a pause, answered by errors of 6 bytes: the receiving side keeps up."""
    board = Board(build(port="avr-serial", BAUD="1000000"))
    frame = encode(Frame(c.SOF, c.SOF, c.SOF, bytes((c.SOF,) * 255)))
    assert len(frame) == c.MAX_WIRE
    broken = frame[:-2]  # each is ended by the next one's start
    events = board.ask(broken * 4 + encode(Frame(c.SOF, 9, ECHO, b"end")), 5)
    assert [event.opcode for event in events] == [c.ERR_FRAMING] * 4 + [c.ECHO]
    assert {event.payload for event in events[:4]} == {bytes((c.SITE_MARKER, 0))}
    assert board.call("overruns").payload == bytes(2)
    board.sim.close()


def test_properties(board):
    reply = board.call(c.MANY, bytes((OPCODE[c.GET_PROPERTIES], 0, 0, 0, 0, 0)))
    values = {item.key: item.value for item in PROPERTIES.parse(reply.payload[6:])}
    assert values["j2a.rxbuf"] == str(RXBUF)
    assert values["port"] == "avr-serial"
    assert values["j2a.spec"] == c.SPEC_VERSION


def test_receive_buffer_holds_what_it_announces(board):
    """While a function runs, RXBUF bytes of requests arrive, and all are answered."""
    slow = encode(Frame(c.SOF, 0, OPCODE["delay"], b"\x32\0"))
    requests = [Frame(c.SOF, seq, ECHO, b"0123456") for seq in range(20, 30)]
    requests.append(Frame(c.SOF, 30, ECHO, b"012"))
    data = b"".join(map(encode, requests))
    assert len(data) == RXBUF
    events = board.ask(slow + data, 12)
    assert events[0] == Frame(c.SOF, 0, 0)
    assert events[1:] == [
        Frame(c.SOF, request.seq, c.ECHO, request.payload) for request in requests
    ]
    assert board.call("overruns").payload == bytes(2)


def test_overrun_is_counted_and_never_answered_wrongly(board, error):
    slow = encode(Frame(c.SOF, 0, OPCODE["delay"], b"\x32\0"))
    requests = [Frame(c.SOF, seq, ECHO, b"0123456") for seq in range(20, 50)]
    events = board.ask(slow + b"".join(map(encode, requests)), 12)
    events += board.listen(100)
    held = RXBUF // len(encode(requests[0]))
    assert events == [
        Frame(c.SOF, 0, 0),
        *[Frame(c.SOF, request.seq, c.ECHO, request.payload) for request in requests[:held]],
        error(requests[held].seq, c.ERR_FRAMING, c.SITE_LOST),
    ]
    assert board.call("overruns").payload == b"\1\0"
    assert board.call(c.GET_ECHO, b"fine") == Frame(c.SOF, 1, c.ECHO, b"fine")


def test_overrun_of_the_usart_itself(build, error):
    """Bytes that come while interrupts are off are lost in the chip, not in the ring."""
    folder = Path(__file__).parent / "cycles"
    elf = build("cycles", "avr-serial", APP_DIR=str(folder), BAUD="1000000")
    with AvrSim(elf) as sim:
        sim.boot()
        # That app works on two echoes of its own, with interrupts off, before it listens.
        frame = encode(Frame(c.SOF, 0x33, 3, bytes(60)))
        sim.uart_write(frame[:8])
        sim.run(6000)
        sim.uart_write(frame[8:])
        sim.run(sim.cycles(0.5))
        assert 30 < sim.counters.overruns < len(frame) - 8
        events = decode(sim.uart_read())
    assert [event.opcode for event in events[:2]] == [c.ECHO] * 2
    assert events[2:] == [error(0x33, c.ERR_FRAMING, c.SITE_LOST)]


@pytest.mark.parametrize("seed", range(3))
def test_overruns_anywhere(build, seed):
    """With a ring of 20 bytes and far too much to do, each answer is right or an error."""
    board = Board(build(port="avr-serial", BAUD="1000000", RXBUF="20"))
    rng = random.Random(seed)
    sent = {}
    data = b""
    for seq in range(250):
        payload = bytes((seq,)) + rng.randbytes(rng.randrange(12))
        sent[seq] = payload
        data += encode(Frame(c.SOF, seq, ECHO, payload))
    board.sim.uart_write(data)
    events = board.listen(1000 * board.sim.char_cycles * len(data) / 16e6 + 50)
    echoed = [event for event in events if event.opcode == c.ECHO]
    assert 10 < len(echoed) < 250
    for event in events:
        if event.opcode == c.ECHO:
            assert event.payload == sent[event.seq]
        else:
            assert (event.opcode, event.payload) == (c.ERR_FRAMING, bytes((c.SITE_LOST, 0)))
    assert int.from_bytes(board.call("overruns").payload, "little") > 0
    board.sim.close()


@pytest.mark.parametrize("cut", range(1, 8))
def test_pause_inside_a_frame(board, error, cut):
    """9 ms are accepted; after 20 ms the frame is given up, and what follows is skipped."""
    frame = encode(Frame(c.SOF, 7, ECHO, b"abc"))
    board.send(frame[:cut])
    # send() ends with the last stop bit; one more character until the next byte is there.
    board.pause(9 - board.sim.char_cycles / 16000)
    board.send(frame[cut:])
    assert board.listen(5) == [Frame(c.SOF, 7, c.ECHO, b"abc")]
    board.send(frame[:cut])
    given_up = [] if cut == 1 else [error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT)]
    assert board.listen(20) == given_up
    board.send(frame[cut:])
    assert board.listen(5) == []


def test_pause_after_a_long_run_of_bytes(build):
    """Noise keeps the main loop busy for milliseconds; the pause counts from the last byte on."""
    board = Board(build(port="avr-serial", BAUD="1000000"))
    frame = encode(Frame(c.SOF, 7, ECHO, bytes(200)))
    for noise in range(0, 400, 25):
        board.send(bytes(noise) + frame[:190])
        board.pause(8.9)
        board.send(frame[190:])
        assert board.listen(5) == [Frame(c.SOF, 7, c.ECHO, bytes(200))]
    board.sim.close()


def test_bytes_that_waited_are_not_timed_out(board):
    """Half a frame comes while a function runs, the other half 8 ms after it has ended."""
    frame = encode(Frame(c.SOF, 7, ECHO, b"abc"))
    board.send(encode(Frame(c.SOF, 1, OPCODE["delay"], b"\x28\0")) + frame[:4])
    assert board.listen(41) == [Frame(c.SOF, 1, 0)]
    board.pause(6)
    board.send(frame[4:])
    assert board.listen(5) == [Frame(c.SOF, 7, c.ECHO, b"abc")]


def test_main_loop_that_is_kept_waiting(build, error):
    """A SIF sent with interrupts off ends; a pause is seen by a loop that turns each 32.768 ms."""
    elf = build("blocking", "avr-serial", APP_DIR=str(Path(__file__).parent / "blocking"))
    board = Board(elf)
    frame = encode(Frame(c.SOF, 7, ECHO, b"abc"))
    assert board.listen(40) == [Frame(c.SOS, 0, 1, bytes(100))]
    board.send(frame[:4])
    assert board.listen(3 * 33) == [error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT)]
    board.sim.close()


def test_pause_while_sifs_are_sent(board, error):
    """SIFs that follow each other faster than the byte timeout do not put it off."""
    board.call("sifPeriod", b"\x05\0")
    board.send(encode(Frame(c.SOF, 7, ECHO, b"abc"))[:4])
    events = board.listen(20)
    assert error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT) in events
    assert len(events) > 3


def test_clock_has_no_steps(board):
    """Asked at odd moments over several wraps of the timer (262 ms), it follows the cycles."""
    rng = random.Random(1)
    offsets = []
    for _ in range(120):
        board.sim.run(rng.randrange(100, 70000))
        time_us = int.from_bytes(board.call("getTime").payload, "little")
        offsets.append(board.sim.cycle / 16 - time_us)
    # From the reading to the end of the reply passes the same time, but for up to 9 escapes and
    # for the millisecond in which ask() looks.
    character_us = board.sim.char_cycles / 16
    assert max(offsets) - min(offsets) < 9 * character_us + 1000
    assert board.sim.time_s > 0.3


# The slowest, one that is no multiple of a baud rate, and the fastest.
@pytest.mark.parametrize(
    "frequency_hz",
    [
        *(1843200, 4433619, 20000000),
        *(pytest.param(hz, marks=pytest.mark.exhaustive) for hz in (3686400, 7372800, 14745600)),
    ],
)
def test_clock_of_other_crystals(build, error, frequency_hz):
    """Right within 0.1 %, also where the clock is no whole number of MHz, and so are pauses."""
    baud = frequency_hz // 64
    board = Board(build(port="avr-serial", FREQ=frequency_hz, BAUD=baud), frequency_hz)
    assert board.sim.baud == pytest.approx(baud, rel=0.001)

    def read_us():
        asked_s = board.sim.time_s
        time_us = int.from_bytes(board.call("getTime").payload, "little")
        return 1e6 * (asked_s + board.sim.time_s) / 2, time_us

    before_us, first_us = read_us()
    board.pause(9000)
    after_us, last_us = read_us()
    assert last_us - first_us == pytest.approx(after_us - before_us, rel=0.001)
    frame = encode(Frame(c.SOF, 7, ECHO, b"abc"))
    for pause_ms, answer in (
        (9, Frame(c.SOF, 7, c.ECHO, b"abc")),
        (19, error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT)),
    ):
        board.send(frame[:5])
        board.pause(pause_ms - 1000 * board.sim.char_cycles / frequency_hz)
        board.send(frame[5:])
        assert board.listen(5) == [answer]
    board.sim.close()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"FREQ": "999999"}, "F_CPU (make FREQ=) must be 1000000 or more"),
        ({"FREQ": "8000000"}, "such as F_CPU / 16, / 32 or / 64"),
        ({"RXBUF": "256"}, '"J2A_RXBUF must be 1..255"'),
        ({"TXBUF": "1"}, '"this port has no transmit buffer, so J2A_TXBUF must be 0"'),
        ({"MCU": "atmega8"}, "this chip has no USART of the newer kind, or no timer 1"),
        ({"MCU": "attiny85"}, "this chip has no USART of the newer kind, or no timer 1"),
    ],
    ids=str,
)
def test_refuses(make, tmp_path, settings, message):
    goal = f"{tmp_path}/builtins.obj/port.o"  # no more of it is compiled than shows the error
    result = make(goal, PORT="avr-serial", APP="builtins", OUT=tmp_path, **settings)
    assert result.returncode != 0
    assert message in result.stderr


def test_clock_around_the_wraps(build):
    """Some of the 2400 wraps fall into the few cycles in which the clock is read."""
    elf = build("clock", "avr-serial", APP_DIR=str(Path(__file__).parent / "clock"))
    with AvrSim(elf) as sim:
        sim.run(sim.cycles(10))
        assert [span.mark for span in sim.spans()] == [2] * 610
        # The app began with registers as a boot loader leaves them; characters have 8 bits again.
        assert decode(sim.uart_read()) == [Frame(c.SOS, n % 256, 2) for n in range(610)]


def test_periodic_sifs_keep_their_rate(board):
    assert board.call("sifPeriod", b"\x0a\0") == Frame(c.SOF, 1, 0)
    sifs = board.listen(505)
    assert sifs == [Frame(c.SOS, n, 0x20, n.to_bytes(4, "little")) for n in range(50)]
    assert board.call("sifPeriod", b"\0\0").opcode == 0
    assert board.listen(50) == []


def test_periodic_sifs_leave_out_what_was_missed(board):
    """After 205 ms in a function one SIF is late, and the others keep their distance."""
    board.call("sifPeriod", b"\x0a\0")
    *_, reply = board.ask(encode(Frame(c.SOF, 2, OPCODE["delay"], b"\xcd\0")), 1)
    assert reply == Frame(c.SOF, 2, 0)
    sifs = board.listen(55)
    assert [sif.payload[0] for sif in sifs] == list(range(6))


def test_store_holds_256_bytes(board):
    def store(flags, offset, data=b""):
        header = bytes((OPCODE["store"], flags)) + offset.to_bytes(4, "little")
        return board.call(c.MANY, header + data).payload

    data = bytes(range(256))
    assert store(c.FLAG_WRITE, 0, data[:249])[0] == 0
    assert store(c.FLAG_WRITE, 249, data[249:] + b"x")[0] == c.RET_FAILED
    assert store(c.FLAG_WRITE | c.FLAG_LAST, 249, data[249:])[0] == 0
    assert store(0, 0)[6:] + store(0, 249)[6:] == data
    assert store(0, 256) == bytes((0, c.FLAG_LAST)) + (256).to_bytes(4, "little")


def test_stack_fits(board):
    board.call("getTime")
    board.call("ret", b"\x12")
    board.ask(encode(Frame(c.SOF, 1, OPCODE["sif"], b"\1abc")), 2)
    board.call(c.MANY, bytes((OPCODE["store"], c.FLAG_WRITE, 0, 0, 0, 0)) + bytes(249))
    free = 2048 - (board.sim.program.ram_end - 0x100)
    assert board.sim.stack_bytes < 160 < free
