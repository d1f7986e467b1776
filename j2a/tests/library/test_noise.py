"""What is no device is not taken for one, and what is a device is."""

import asyncio
import sys
import threading
from random import Random

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import MAX_PAYLOAD, SOF, SOS

import j2a
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.io.engine_base import take_stale_input
from j2a.protocol.session import Session

from .noise import KINDS, RATES, Noise, outcome_of
from .support import PATIENCE_S, linked
from .test_limits import Host

SIF = oracle.encode(oracle.Frame(SOS, 0, 0x20, b""))
OWN_SEQ = oracle.encode(oracle.Frame(SOF, 0, 0, b"a2jGetMapping\0"))


@pytest.mark.parametrize("rate", RATES[:2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_noise_is_no_device(kind, rate, seed):
    assert outcome_of(seed, kind, rate) in ("CallTimeout", "ProtocolError")


def test_the_echo_of_a_link_is_no_device():
    noise = Noise(Random(0), None, 0)
    noise.call = lambda _what, opcode, payload, _limit_s: Reply(opcode, payload)
    with pytest.raises(j2a.ProtocolError, match="echo"):
        noise.connect()


def test_a_line_that_echoes_beside_a_device_is_named():
    """The echo of each request answers it, and the reply of the device comes behind."""
    noise = Noise(Random(0), None, 0)

    def call(_what, opcode, payload, _limit_s):
        noise._session._counts["stray_replies"] += 1
        return Reply(opcode, payload)

    noise.call = call
    with pytest.raises(j2a.ProtocolError, match="does the link echo what is sent"):
        noise.connect()


@pytest.mark.parametrize(
    ("noise", "bit_rate", "told"),
    [
        (b"", 9600, r"within 5 s and no byte came; .* speed and parity are the same"),
        (
            b"hello\n",
            0,
            r"within 5 s; \d+ bytes came, of which no frame.*: is its speed right, and",
        ),
        (b"hello\n", 9600, r"\d+ bytes came, .* could be made: is 9600 the right baud rate, and"),
        (SIF, 9600, r"within 5 s, although \d+ valid frames came; see that the board can receive"),
        (OWN_SEQ, 9600, r"within 5 s, although \d+ replies came with a seq that no request had"),
    ],
    ids=["silence", "noise", "noise at a baud rate", "SIFs", "a seq of its own"],
)
def test_what_came_in_place_of_an_answer_is_told(noise, bit_rate, told):
    client = Noise(Random(0), lambda _random, _size: noise, 0)
    with pytest.raises(j2a.CallTimeout, match=told):
        client.do(client._connect(5.0, bit_rate))


@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
@pytest.mark.parametrize(
    "connect", [j2a.connect, lambda *a, **o: asyncio.run(j2a.aconnect(*a, **o))]
)
def test_both_clients_name_the_baud_rate_and_one_byte(connect):
    with j2a_transports.listen("pty:") as listener:
        has_ended = threading.Event()

        def babble():
            with listener.accept(PATIENCE_S) as far:
                far.write(b"?")
                assert has_ended.wait(PATIENCE_S)

        thread = threading.Thread(target=babble)
        thread.start()
        with pytest.raises(j2a.CallTimeout, match=r"1 byte came, .* is 57600 the right baud rate"):
            connect(f"{listener.url}?baud=57600", boot_time=0.5)
        has_ended.set()
        thread.join(PATIENCE_S)


def test_a_flood_that_was_there_before_ends():
    class Flood:
        def __init__(self):
            self.reads = 0

        def read(self, timeout_s):
            assert timeout_s == 0
            self.reads += 1
            if self.reads > 1000:
                raise AssertionError("without end")
            return bytes(4096)

    flood, session = Flood(), Session(first_seq=0)
    take_stale_input(flood, session)
    assert 10 <= flood.reads <= 1000
    assert session.counters.bytes_received == 4096 * flood.reads


class TestDevices:
    class Answering(DemoDevice):
        """Answers a2jGetMapping in its own way."""

        def __init__(self, *answers):
            super().__init__()
            self.answers = answers
            self.asked = 0

        def _execute(self, opcode, payload):
            if opcode:
                return super()._execute(opcode, payload)
            self.asked += 1
            return self.answers[min(self.asked, len(self.answers)) - 1]

    def connect(self, *answers):
        host = Host(self.Answering(*answers), 0.001)
        host.do(host._refresh(None), host._device_limits(host.now))
        return host

    @pytest.mark.parametrize(
        "answer",
        [
            (0xFF, b"a2jG"),  # of 2014, its map too long for one frame
            (0xFF, b""),
            (0xFF, b"a2jGetMapping\0" + bytes(MAX_PAYLOAD - 14)),
        ],
    )
    def test_one_without_a_usable_map_says_so_twice(self, answer):
        host = self.connect(answer)
        assert host._device.functions == {}
        assert host.device.asked == 2

    def test_a_map_is_asked_for_once(self):
        host = self.connect((0, b"a2jGetMapping\0a2jMany\0"))
        assert host.device.asked == 1

    def test_answers_that_change_are_no_proof(self):
        with pytest.raises(j2a.ProtocolError, match="no device"):
            self.connect(*((0xFF, bytes((n,))) for n in range(4)))

    def test_a_device_without_a_map_is_connected_to(self):
        class NoMap(DemoDevice):
            def _execute(self, opcode, payload):
                return (0xF0, b"\1\0") if opcode == 0 else super()._execute(opcode, payload)

        with linked(NoMap()) as client:
            assert client.functions == {}
            assert client.counters.frames_sent == 2
            assert client.call(4, b"x").payload == b"x"
