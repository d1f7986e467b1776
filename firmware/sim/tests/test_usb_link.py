"""The transport over the chip's USB, in simulated time."""

import contextlib
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_sim import SimError, UsbLink
from j2a_sim._link import open_url
from j2a_sim._usb.descriptors import parse_configuration, parse_device
from j2a_sim._usb.link import find_endpoints
from j2a_sim._usb_bus.bus import UsbBus
from j2a_transports import BadUrl, LinkClosed, LinkLost, OpenFailed, Url

pytestmark = pytest.mark.avr

# Vendor requests of firmware/usb_board.c.
HALT, HOLD, DETACH, STOP, KEEP, BURST = range(1, 7)


@pytest.fixture
def link(usb_board):
    return UsbLink(usb_board())


def ask(link, request, value=0):
    link.sim.usb.control(0x40, request, value)


def read_all(link, count, timeout_s=1.0):
    data = b""
    while len(data) < count:
        more = link.read(timeout_s)
        assert more, f"{len(data)} of {count} bytes came"
        data += more
    return data


@pytest.mark.requirement("USB-007", "USB-014", "USB-009")
@pytest.mark.parametrize("size", [1, 63, 64, 65, 127, 128, 511, 512, 513, 4096])
def test_echo(link, size):
    """The board ends an echo as the host ended the write, with an empty packet too."""
    data = bytes(i * 7 & 0xFF for i in range(size))
    for _ in range(3):
        link.write(memoryview(data))
        assert read_all(link, size) == data
    assert link.read(0.01) == b""
    assert link.sim.usb.counters.wrong_toggles == 0


@pytest.mark.requirement("USB-012")
def test_halts_are_cleared_before_anything_else(usb_board, monkeypatch):
    requests = []
    control = UsbBus.control

    def noted(bus, *request):
        requests.append(request[:4])
        return control(bus, *request)

    monkeypatch.setattr(UsbBus, "control", noted)
    link = UsbLink(usb_board())
    assert requests[-2:] == [(0x02, 1, 0, 0x81), (0x02, 1, 0, 0x02)]
    assert link.sim.usb.counters.bytes_out == 0


def test_an_empty_write_is_nothing(link):
    link.write(b"")
    link.write(b"x")
    assert link.read(1.0) == b"x"


def test_what_does_not_end_short_is_not_heard(link):
    ask(link, BURST, 64)
    assert link.read(0.1) == b""
    ask(link, BURST, 10)
    assert link.read(0.1) == bytes(range(63, -1, -1)) + bytes(range(9, -1, -1))


def test_timeouts_are_simulated(link):
    began = link.clock()
    assert link.read(2.5) == b""
    assert 2.5 <= link.clock() - began < 2.501
    link.write(b"x")
    assert link.read(0) == b""
    assert link.read(0.01) == b"x"


def test_sleep_keeps_what_arrives_and_goes_on_listening(link):
    for _ in range(10):
        link.write(bytes(600))
    link.sleep(0.1)
    began = link.clock()
    assert read_all(link, 6000) == bytes(6000)
    assert link.clock() == began


def test_the_same_calls_give_the_same_cycles(usb_board):
    def record():
        link = UsbLink(usb_board())
        cycles = []
        for i in range(1, 150, 7):
            link.write(bytes(i))
            read_all(link, i)
            cycles.append(link.sim.cycle)
        return cycles

    assert record() == record()


def test_a_write_from_another_thread_ends_a_read(usb_board):
    link = UsbLink(usb_board(), patience_s=0.001)
    got = []
    reader = threading.Thread(target=lambda: got.append(link.read(None)))
    reader.start()
    link.write(b"hello")
    reader.join(60)
    assert got == [b"hello"]


def test_close_ends_a_read(link):
    threading.Timer(0.1, link.close).start()
    with pytest.raises(LinkClosed):
        link.read(None)
    with pytest.raises(LinkClosed):
        link.write(b"x")


@pytest.mark.requirement("USB-013")
def test_unplugged_in_a_read(link):
    link.write(b"before")
    link.sleep(0.1)
    threading.Timer(0.1, link.sim.usb.unplug).start()
    assert link.read(None) == b"before"
    with pytest.raises(LinkLost):
        link.read(None)
    for call in (lambda: link.read(0), lambda: link.write(b"x"), lambda: link.sleep(1)):
        with pytest.raises(LinkLost):
            call()


@pytest.mark.parametrize(
    ("request_", "value", "says"),
    [
        (HALT, 0x81, "stalled endpoint 0x81"),
        (DETACH, 0, "unplugged"),
        (STOP, 0, "the firmware stopped: sleep with interrupts off"),
    ],
)
def test_what_ends_the_link(link, request_, value, says):
    if request_ == STOP:
        with pytest.raises(SimError):
            ask(link, request_, value)
            link.sim.run(1000)
    else:
        ask(link, request_, value)
    with pytest.raises(LinkLost, match=says):
        link.read(1.0)


def test_a_halted_endpoint_ends_a_write(link):
    ask(link, HALT, 0x02)
    link.write(b"x")
    with pytest.raises(LinkLost, match="stalled endpoint 0x02"):
        link.read(1.0)


def test_held_bytes_are_not_lost(link):
    """A board that does not read for a while refuses, and the host repeats."""
    ask(link, HOLD, 1)
    data = bytes(range(200))
    link.write(data)
    link.write(data)
    assert link.read(0.05) == b""
    ask(link, HOLD, 0)
    assert read_all(link, 400) == data * 2


def test_open_by_url(firmware):
    elf = firmware("usb_board", "atmega32u4")
    with open_url(Url.parse(f"sim:{elf}?link=usb&freq=16e6&patience=none&speed=0")) as link:
        assert isinstance(link, UsbLink)
        assert link.sim.mcu == "atmega32u4"
        link.write(b"by url")
        assert read_all(link, 6) == b"by url"


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("baud=9600", "baud is an option of a UART"),
        ("uart=1", "uart is an option of a UART"),
        ("link=spi", "takes uart or usb"),
    ],
)
def test_a_wrong_option_is_a_bad_url(firmware, option, says):
    elf = firmware("usb_board", "atmega32u4")
    separator = "" if option.startswith("link") else "link=usb&"
    with pytest.raises(BadUrl, match=says):
        open_url(Url.parse(f"sim:{elf}?{separator}{option}"))


def test_a_firmware_that_cannot_be_reached_is_open_failed(firmware):
    with pytest.raises(OpenFailed, match="class FF, subclass 12"):
        open_url(Url.parse(f"sim:{firmware('usb_board', 'atmega32u4', CLASS=0xFE)}?link=usb"))
    with pytest.raises(OpenFailed, match=r"elf on an atmega32u4 at 16000000 Hz .*DETACH in UDCON"):
        open_url(Url.parse(f"sim:{firmware('usb_board', 'atmega32u4', DETACHED=1)}?link=usb"))
    with pytest.raises(OpenFailed, match="atmega328p has no USB"):
        open_url(Url.parse(f"sim:{firmware('echo')}?link=usb&mcu=atmega328p"))


def test_the_message_tells_what_usb_lacks(firmware):
    board = firmware("usb_board", "atmega32u4")
    with pytest.raises(OpenFailed, match=r"at 8000000 Hz did not attach .*the PLL .*crystal"):
        open_url(Url.parse(f"sim:{board}?link=usb&freq=8000000"))
    with pytest.raises(OpenFailed, match="never switched USB on"):
        open_url(Url.parse(f"sim:{firmware('poke', 'atmega32u4')}?link=usb"))
    with pytest.raises(OpenFailed, match=r"UART receiver .*link=usb"):
        open_url(Url.parse(f"sim:{board}?mcu=atmega32u4"))
    with pytest.raises(OpenFailed, match=r"UART receiver on in 1.0 s$"):
        open_url(Url.parse(f"sim:{firmware('poke', 'atmega32u4')}?mcu=atmega32u4"))


HEAD = bytes([9, 2, 0, 0, 1, 1, 0, 0x80, 50])
BOARD = bytes([9, 4, 0, 0, 2, 0xFF, 0x12, 0xEF, 0])
OTHER = bytes([9, 4, 1, 0, 1, 0xFF, 0x34, 0x01, 0])
CLASS_SPECIFIC = bytes([4, 0x24, 1, 2])
TO_HOST = bytes([7, 5, 0x84, 2, 32, 0, 0])
TO_BOARD = bytes([7, 5, 0x05, 2, 64, 0, 0])


@pytest.mark.requirement("USB-002", "USB-003")
def test_endpoints_are_what_the_descriptors_say():
    found = parse_configuration(
        HEAD + OTHER + TO_BOARD + BOARD + CLASS_SPECIFIC + TO_HOST + TO_BOARD
    )
    assert find_endpoints(found) == ((0x84, 32, True), (0x05, 64, True))
    assert found.parts[1].extra == CLASS_SPECIFIC
    interrupt = (
        HEAD + BOARD + TO_HOST[:3] + b"\3" + TO_HOST[4:] + TO_BOARD[:3] + b"\3" + TO_BOARD[4:]
    )
    assert find_endpoints(parse_configuration(interrupt)) == ((0x84, 32, False), (0x05, 64, False))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (BOARD, "begins with a descriptor of type 4"),
        (HEAD[:-1], "damaged at byte 0"),
        (HEAD + b"\0\4", "damaged at byte 9"),
        (HEAD + TO_HOST, "before the first interface"),
        (HEAD + b"\5\4\0\0\2", "at byte 9 of a configuration is too short"),
        (HEAD + OTHER + TO_BOARD, "class FF, subclass 12"),
        (HEAD + BOARD + TO_HOST, "lacks a bulk endpoint"),
    ],
)
def test_damaged_descriptors(data, says):
    with pytest.raises(SimError, match=says):
        find_endpoints(parse_configuration(data))


@given(st.lists(st.sampled_from([HEAD, BOARD, OTHER, TO_HOST, TO_BOARD]) | st.binary(max_size=9)))
def test_whatever_a_device_says_of_itself(parts):
    with contextlib.suppress(SimError):
        find_endpoints(parse_configuration(b"".join(parts)))


def test_no_device_descriptor():
    with pytest.raises(SimError, match="8 bytes are no device descriptor"):
        parse_device(bytes(8))
