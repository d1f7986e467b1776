"""Two boards at once on the simulated USB, told apart by their serial numbers.

In: the demo with two serial numbers, the transport `usb://` on pyusb's backend of the simulator.
Out: each call reaches its board; a board that stalls, in three ways, delays no call to the other.
What was first is judged by what has ended and what has not, never by a clock.
"""

import errno
import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import usb.core
import usb.util
from j2a_sim import AvrSim, SimBackend
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode
from j2a_transports import usb_boards

import j2a

pytestmark = pytest.mark.avr

MCU = "atmega32u4"
SERIALS = ("left-1", "right2")
WAIT_S = 60
CALLS = 200
SET_FEATURE, ENDPOINT_HALT, ENDPOINT = 3, 0, 0x02


class Bus:
    """Both boards, plugged in."""

    def __init__(self, sims):
        self.sims = dict(zip(SERIALS, sims, strict=True))
        self.backend = SimBackend(list(sims))

    def connect(self, serial):
        return j2a.connect(f"usb://{serial}", timeout=WAIT_S)

    def device(self, serial):
        """The board for pyusb itself."""
        return usb.core.find(
            backend=self.backend, custom_match=lambda found: found.serial_number == serial
        )

    def taken(self, serial):
        """Bytes that the board has taken."""
        return self.sims[serial].usb.counters.bytes_out


@pytest.fixture
def bus(build, monkeypatch):
    sims = [AvrSim(build(port="avr-usb", MCU=MCU, SERIAL=serial), MCU) for serial in SERIALS]
    made = Bus(sims)
    monkeypatch.setattr("j2a_transports._usb.link.libusb", lambda *_: made.backend)
    yield made
    for sim in sims:
        sim.close()


@pytest.fixture
def pool():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def echoes(board, count=CALLS):
    """So many calls, each with a payload of its own."""
    for number in range(count):
        payload = number.to_bytes(2, "little") * (number % 128)
        assert board.echo(payload[:255]) == payload[:255]


@pytest.mark.requirement("USB-004")
def test_each_by_its_serial_number(bus):
    assert [board.serial for board in usb_boards(bus.backend)] == list(SERIALS)
    with bus.connect(SERIALS[0]) as left, bus.connect(SERIALS[1]) as right:
        for board, own, other in ((left, *SERIALS), (right, *reversed(SERIALS))):
            before = bus.taken(own), bus.taken(other)
            assert board.echo(b"x" * 100) == b"x" * 100
            assert bus.taken(own) > before[0]
            assert bus.taken(other) == before[1]


def test_both_at_once(bus, pool):
    with bus.connect(SERIALS[0]) as left, bus.connect(SERIALS[1]) as right:
        for done in [pool.submit(echoes, board) for board in (left, right)]:
            done.result(WAIT_S)


def test_a_function_that_does_not_return(bus, pool):
    """The one board computes for more than a minute, and is pulled out when the other is done."""
    with bus.connect(SERIALS[0]) as left, bus.connect(SERIALS[1]) as right:
        echoes(left, 3)
        stuck = pool.submit(left.call, "delay", b"\xff\xff", math.inf)
        echoes(right)
        assert not stuck.done()
        bus.backend.unplug(bus.sims[SERIALS[0]])
        with pytest.raises(j2a.LinkLost):
            stuck.result(WAIT_S)
        echoes(right, 10)


@pytest.mark.requirement("USB-012")
def test_a_halted_endpoint(bus):
    """It refuses at once what is sent to it, until a host opens the board and clears the halt."""
    with bus.connect(SERIALS[1]) as right:
        device = bus.device(SERIALS[0])
        device.ctrl_transfer(ENDPOINT, SET_FEATURE, ENDPOINT_HALT, c.USB_OUT)
        for _ in range(3):
            with pytest.raises(usb.core.USBError) as caught:
                device.write(c.USB_OUT, b"refused")
            assert caught.value.errno == errno.EPIPE
            echoes(right, 50)
        usb.util.dispose_resources(device)
        with bus.connect(SERIALS[0]) as left:
            echoes(left, 10)
            echoes(right, 10)


def test_a_host_that_does_not_read(bus, pool):
    """The one board is full of replies, so what it is sent waits; later all of it is answered."""
    echo = [name for name in c.BUILTINS if name != c.GET_MAPPING].index(c.GET_ECHO) + 1
    payloads = [bytes((seq,)) * 100 for seq in range(100)]
    requests = [encode(Frame(c.SOF, seq, echo, data)) for seq, data in enumerate(payloads)]
    left = bus.device(SERIALS[0])
    with bus.connect(SERIALS[1]) as right:
        writing = pool.submit(left.write, c.USB_OUT, b"".join(requests), 0)
        echoes(right)
        assert not writing.done()
        got = b""
        expected = [Frame(c.SOF, seq, c.ECHO, data) for seq, data in enumerate(payloads)]
        while len(got) < len(b"".join(map(encode, expected))):
            got += bytes(left.read(c.USB_IN, 4096, 1000))
        assert decode(got) == expected
        assert writing.result(WAIT_S) == len(b"".join(requests))
        echoes(right, 10)
