"""`usb://` and the client of J2A on simulated boards with the firmware of avr-usb, no kernel."""

import threading

import j2a_transports
import pytest
import usb.core
from j2a_sim import AvrSim, SimBackend
from j2a_transports import LinkLost, usb_boards

import j2a

pytestmark = pytest.mark.avr


@pytest.fixture
def boards(build_firmware):
    """Two boards that differ in their serial numbers, their simulators and their backend."""
    elfs = [
        build_firmware("demo", port="avr-usb", MCU="atmega32u4", SERIAL=serial)
        for serial in ("LEFT", "RIGHT")
    ]
    with AvrSim(elfs[0], "atmega32u4") as left, AvrSim(elfs[1], "atmega32u4") as right:
        yield SimBackend([left, right]), left, right


def connect(backend, serial):
    device = usb.core.find(backend=backend, serial_number=serial)
    return j2a.Client(j2a_transports.open_usb_device(device), timeout=60)


@pytest.mark.requirement("USB-002")
def test_what_is_found(boards):
    backend, *_ = boards
    found = usb_boards(backend)
    assert [board.serial for board in found] == ["LEFT", "RIGHT"]
    assert [(board.bus, board.address, board.port_path) for board in found] == [
        (1, 1, "1-1"),
        (1, 2, "1-2"),
    ]
    assert all(board.speed == 12 and board.sync and board.problem is None for board in found)


@pytest.mark.requirement("USB-014", "USB-009")
def test_two_clients_at_once(boards):
    """Payloads around the packet size, so that frames end with an empty packet too."""
    backend, *_ = boards
    failures = []

    def work(serial):
        try:
            with connect(backend, serial) as client:
                for size in (0, 1, *range(50, 70), 128, 255):
                    payload = bytes(range(size))
                    assert client.echo(payload) == payload
                assert client.call("add", bytes([1, 0, 2, 0])) is not None
        except Exception as error:
            failures.append((serial, error))

    threads = [threading.Thread(target=work, args=[serial]) for serial in ("LEFT", "RIGHT")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert not failures


@pytest.mark.requirement("USB-013")
def test_unplugged_in_mid_call_and_plugged_again(boards):
    backend, left, _ = boards
    with connect(backend, "LEFT") as client, connect(backend, "RIGHT") as other:
        pulled = threading.Timer(0.3, backend.unplug, [left])
        pulled.start()
        with pytest.raises(j2a.LinkLost):
            client.call("delay", (5000).to_bytes(2, "little"), timeout=60)
        pulled.join()
        assert other.echo(b"still there") == b"still there"
    backend.plug(left)
    assert [board.address for board in usb_boards(backend)] == [2, 3]
    with connect(backend, "LEFT") as client:
        assert client.echo(b"again") == b"again"


def test_a_board_that_hangs_does_not_delay_the_other(boards):
    backend, *_ = boards
    with connect(backend, "LEFT") as slow, connect(backend, "RIGHT") as fast:
        answers = []
        waiting = threading.Thread(
            target=lambda: answers.append(
                slow.call("delay", (1000).to_bytes(2, "little"), timeout=60)
            )
        )
        waiting.start()
        for i in range(50):
            assert fast.echo(bytes([i])) == bytes([i])
        assert not answers
        waiting.join(120)
        assert answers


def test_a_chip_that_is_reset_is_a_lost_link(boards):
    """Its pull-up goes for a moment, so the host sees it leave."""
    backend, left, _ = boards
    device = usb.core.find(backend=backend, serial_number="LEFT")
    with j2a_transports.open_usb_device(device) as link:
        left.reset()
        with pytest.raises(LinkLost):
            while True:
                link.read(1.0)
