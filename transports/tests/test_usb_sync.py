"""SyncUSB from the host's side: bytes of packets and requests, and boards that fail."""

import errno
from types import SimpleNamespace

import pytest
from j2a_transports import LinkLost, OpenFailed, WriteTimeout
from j2a_transports._usb.sync import FrameSeen, SyncPort, frames_of


def interface():
    """Return what `SyncPort` uses of an interface of pyusb: a number, and endpoints."""

    class Described(list):
        pass

    found = Described([SimpleNamespace(bEndpointAddress=0x03)])
    found.bInterfaceNumber = 1
    return found


class Board:
    """What `SyncPort` uses of a pyusb device."""

    bus, address, port_numbers, speed = 1, 4, (2, 3), 2
    backend = None

    def __init__(self, reply=b"", error=None):
        self.reply, self.error = reply, error
        self.calls = []

    def ctrl_transfer(self, *words):
        self.calls.append(words)
        if self.error is not None:
            raise OSError(self.error, "as the test wants")
        return self.reply

    def write(self, endpoint, data, timeout):
        self.calls.append((endpoint, bytes(data)))
        if self.error is not None:
            raise OSError(self.error, "as the test wants")


@pytest.fixture
def port(monkeypatch):
    monkeypatch.setattr(
        "j2a_transports._usb.sync.strings_of_device", lambda _: ((None, None, "0001"), None)
    )
    return lambda *args: (board := Board(*args), SyncPort(board, interface()))


@pytest.mark.requirement("SYNC-002")
def test_a_packet_is_that_of_2014_byte_for_byte(port):
    board, one = port()
    one.send(1_000_000, 2047)
    assert board.calls == [(0x03, bytes.fromhex("40420F0000000000FF07"))]
    assert (one.name, one.bus, one.serial) == ("1-2.3", 1, "0001")


@pytest.mark.requirement("SYNC-008")
def test_the_request_for_the_frame(port):
    board, one = port(bytes.fromhex("EDFE FF07 E803"))
    assert one.frame(0xFEED) == FrameSeen(2047, 1000)
    [(kind, request, value, index, size, _)] = board.calls
    assert (kind, request, value, index, size) == (0xC1, 1, 0xFEED, 1, 6)


@pytest.mark.parametrize(
    "reply",
    ["", "EDFE FF07 E8", "EDFE FF07 E803 00", "ECFE FF07 E803", "EDFE FFFF E803", "EDFE 0008 0000"],
)
def test_what_is_no_answer_to_the_request_is_none(port, reply):
    _, one = port(bytes.fromhex(reply))
    assert one.frame(0xFEED) is None


@pytest.mark.parametrize("error", [errno.EPIPE, errno.ETIMEDOUT])
def test_a_board_that_does_not_know_the_request(port, error):
    _, one = port(b"", error)
    assert one.frame(1) is None


def test_a_board_that_is_gone_or_takes_nothing(port):
    for error, kind in ((errno.ENODEV, LinkLost), (errno.EIO, LinkLost)):
        _, one = port(b"", error)
        with pytest.raises(kind, match="gone"):
            one.frame(1)
        with pytest.raises(kind, match="gone"):
            one.send(1, 1)
    _, one = port(b"", errno.ETIMEDOUT)
    with pytest.raises(WriteTimeout, match="does not accept packets"):
        one.send(1, 1)


def test_an_interface_that_another_program_has(port, monkeypatch):
    def claim(_device, _number):
        raise OSError(errno.EBUSY, "busy")

    monkeypatch.setattr("usb.util.claim_interface", claim)
    monkeypatch.setattr("usb.util.dispose_resources", lambda _: None)
    _, one = port()
    with pytest.raises(OpenFailed, match="another program uses it"):
        one.open()
    one.close()


def test_boards_of_one_bus_have_the_same_frames_unless_they_are_far_away(tmp_path):
    for number, driver in ((1, "pci0000:00/xhci"), (2, "platform/vhci_hcd.0")):
        (tmp_path / driver / f"usb{number}").mkdir(parents=True)
        (tmp_path / f"usb{number}").symlink_to(tmp_path / driver / f"usb{number}")
    assert frames_of(1, "1-2", tmp_path) == frames_of(1, "1-3.1", tmp_path) == "usb bus 1"
    assert frames_of(2, "2-1", tmp_path) == "usb 2-1"
    assert frames_of(3, "3-1", tmp_path) == "usb bus 3", "where there is no sysfs"
