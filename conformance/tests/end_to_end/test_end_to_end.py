"""What the project promises, seen from a program that uses it: one client, every kind of device."""

import random
import struct
import threading

import j2a_transports
import pytest
from j2a_spec.oracle import Frame, encode

import j2a

PATTERNS = {
    "SOF": b"\x12" * 255,
    "SOS": b"\xed" * 255,
    "ESC": b"\x7d" * 255,
    "SOF - 1": b"\x11" * 255,
    "SOS - 1": b"\xec" * 255,
    "ESC - 1": b"\x7c" * 255,
    "counting": bytes(range(255)),
    "random": random.Random(1).randbytes(255),
}
SIZES = (0, 1, 248, 249, 250, 498, 499, 600, 65_536)
HUGE = 1_000_003
FUNCTIONS = [
    *("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns", "divide"),
    *("echoNumbers", "echoShapes", "echoWords", "echoFirst"),
]


# The AVR takes many times as long; of its echoes avr-1m shows each length, in the suite.
@pytest.mark.parametrize(
    "client",
    [
        "posix",
        pytest.param("avr-115200", marks=[pytest.mark.avr, pytest.mark.exhaustive]),
        pytest.param("avr-1000000", marks=[pytest.mark.avr, pytest.mark.exhaustive]),
        "python",
    ],
    indirect=True,
)
def test_all_echoes(client: j2a.Client) -> None:
    correct = sum(
        client.call("a2jEcho", pattern[:length]) == j2a.Reply(0xBA, pattern[:length])
        for pattern in PATTERNS.values()
        for length in range(256)
    )
    assert correct == len(PATTERNS) * 256 == 2048
    assert client.counters.checksum_errors == client.counters.framing_errors == 0


def test_every_device_offers_the_same(client: j2a.Client) -> None:
    assert list(client.functions)[-len(FUNCTIONS) :] == FUNCTIONS
    assert list(client.functions.values()) == list(range(len(client.functions)))
    assert client.properties["name"] == "J2A demo"
    assert client.properties["j2a.spec"] == "1.1"
    assert {"serial", "j2a.rxbuf"} <= set(client.properties)


def test_calls(client: j2a.Client) -> None:
    for first, second in ((40, 2), (-1, -2), (2**31 - 1, 1), (0x12ED, 0x7D12ED)):
        code, payload = client.call("add", struct.pack("<ii", first, second))
        wrapped = (first + second + 2**31) % 2**32 - 2**31
        assert (code, struct.unpack("<i", payload)[0]) == (0, wrapped)
    assert client.call("add", b"short").code == 0xFF
    times = [struct.unpack("<Q", client.call("getTime").payload)[0] for _ in range(3)]
    assert times == sorted(times)
    assert [client.call("ret", bytes((code,))).code for code in (0, 0xEF, 0xF3, 0xFF)] == [
        0,
        0xEF,
        0xFF,
        0xFF,
    ]
    assert "ret 0xEF" in client.read_debug()


@pytest.mark.parametrize("size", SIZES)
def test_echo_many(client: j2a.Client, size: int) -> None:
    data = random.Random(size).randbytes(size)
    seen: list[tuple[int, int | None]] = []
    echoed = client.echo_many(data, progress=lambda done, total: seen.append((done, total)))
    assert echoed == data
    assert seen[-1] == (size, size)


@pytest.mark.parametrize("client", ["posix", "python"], indirect=True)
@pytest.mark.parametrize("size", [*SIZES, HUGE])
def test_store(client: j2a.Client, size: int) -> None:
    data = random.Random(size).randbytes(size)
    assert client.write_many("store", data) == 0
    assert client.read_many("store") == data


@pytest.mark.avr
def test_store_on_the_avr(avr_url) -> None:
    with j2a.connect(avr_url(1_000_000), timeout=10) as client:
        data = random.Random(256).randbytes(256)
        client.write_many("store", data)
        assert client.read_many("store") == data
        with pytest.raises(j2a.FunctionFailed):
            client.write_many("store", data * 2)
        assert client.call("a2jEcho", b"still here").payload == b"still here"


def test_sifs_in_order_while_calls_go_on(client: j2a.Client) -> None:
    seen: list[int] = []
    done = threading.Event()

    def take(sif: j2a.Sif) -> None:
        seen.append(struct.unpack("<I", sif.payload)[0])
        client.call("a2jEcho", sif.payload)  # a handler may call
        if len(seen) == 10:
            done.set()

    client.on_sif(0x20, take)
    client.call("sifPeriod", struct.pack("<H", 5))
    echoes = 0
    while not done.wait(0):
        assert client.echo(b"between") == b"between"
        echoes += 1
    client.call("sifPeriod", struct.pack("<H", 0))
    assert seen[:10] == list(range(10))
    assert echoes > 0
    assert client.counters.sif_gaps == 0


def test_a_sif_asked_for_in_a_call(client: j2a.Client) -> None:
    arrived = threading.Event()
    seen: list[tuple[int, bytes]] = []

    def take(sif: j2a.Sif) -> None:
        seen.append((sif.opcode, sif.payload))
        if len(seen) == 5:
            arrived.set()

    client.on_sif(None, take)
    frames = [(opcode, bytes((opcode,)) * 3) for opcode in (0x12, 0x7D, 0xED, 0xF3, 0xFF)]
    for opcode, payload in frames:
        assert client.call("sif", bytes((opcode, *payload))).code == 0
    assert arrived.wait(60)
    assert seen == frames


@pytest.mark.parametrize("baud", [115_200, 1_000_000])
@pytest.mark.avr
def test_calls_in_flight_on_the_avr(avr_url, baud: int) -> None:
    """As many as the device's buffer holds: all are answered, none wrongly, nothing is lost."""
    with j2a.connect(avr_url(baud), timeout=30, window=16) as client:
        assert int(client.properties["j2a.rxbuf"]) >= 64
        answers: dict[int, bytes] = {}

        def run(number: int) -> None:
            for turn in range(40):
                payload = bytes((number, turn)) * 4
                answers[number << 8 | turn] = client.call("a2jEcho", payload).payload

        threads = [threading.Thread(target=run, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(answers) == 320
        assert all(answers[key] == bytes((key >> 8, key & 0xFF)) * 4 for key in answers)
        assert client.call("overruns").payload == b"\0\0"
        assert client.counters.timeouts == 0


def test_requests_without_waiting_on_posix(posix_url) -> None:
    """Raw bytes, far more than the buffer: a pipe holds them back, so each one is answered."""
    requests = b"".join(
        encode(Frame(0x12, n & 0xFF, 4, bytes((n & 0xFF,)) * 9)) for n in range(2000)
    )
    replies = b"".join(
        encode(Frame(0x12, n & 0xFF, 0xBA, bytes((n & 0xFF,)) * 9)) for n in range(2000)
    )
    with j2a_transports.open(posix_url) as link:
        writer = threading.Thread(target=link.write, args=(requests,))
        writer.start()
        received = b""
        while len(received) < len(replies) and (part := link.read(30)):
            received += part
        writer.join()
    assert received == replies
