"""pyusb on simulated boards: its own API, the errors of libusb, several threads and boards."""

import contextlib
import errno
import sys
import threading
import time

import j2a_sim
import pytest
import usb.core
import usb.util
from j2a_sim import SimBackend, SimError

pytestmark = pytest.mark.avr

WAIT_S = 60
HALT, HOLD, DETACH, STOP, KEEP, BURST = range(1, 7)
UNTIL_DONE = 0


@pytest.fixture
def sim(usb_board):
    return usb_board()


@pytest.fixture
def backend(sim):
    return SimBackend(sim)


@pytest.fixture
def device(backend):
    return usb.core.find(backend=backend)


class Call:
    """A call in a thread: its result or error."""

    def __init__(self, function, *args):
        self.result = self.error = None

        def target():
            try:
                self.result = function(*args)
            except usb.core.USBError as error:
                self.error = error

        self.thread = threading.Thread(target=target)
        self.thread.start()

    def join(self):
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()
        return self


def fails(number, function, *args, **options):
    with pytest.raises(usb.core.USBError) as caught:
        function(*args, **options)
    assert caught.value.errno == number
    return caught.value


def test_what_the_device_is(device):
    assert (device.idVendor, device.idProduct, device.bcdDevice) == (0x6666, 0xCAFE, 0x1234)
    assert (device.bus, device.address, device.port_numbers) == (1, 1, (1,))
    assert device.speed == usb.util.SPEED_FULL
    assert (device.manufacturer, device.product, device.serial_number) == ("J2A", "Echo", "SNA")
    configuration = device.get_active_configuration()
    assert configuration.bConfigurationValue == 1
    assert configuration.wTotalLength == 48
    board, sync = configuration
    assert (board.bInterfaceClass, board.bInterfaceSubClass) == (0xFF, 0x12)
    assert [e.bEndpointAddress for e in board] == [0x81, 0x02]
    assert [e.wMaxPacketSize for e in board] == [64, 64]
    assert usb.util.get_string(device, sync.iInterface) == "SyncUSB"
    assert device.parent is None
    assert "Bulk" in str(device)
    assert "Interrupt" in str(device)


def test_found_by_what_it_is(backend):
    assert usb.core.find(backend=backend, idVendor=0x6666, serial_number="SNA")
    assert usb.core.find(backend=backend, idVendor=0x6667) is None


@pytest.mark.parametrize("size", [1, 63, 64, 65, 256])
def test_echo(device, size):
    data = bytes(range(256))[:size]
    for _ in range(3):
        assert device.write(0x02, data) == len(data)
        got = b""
        while len(got) < len(data):
            got += bytes(device.read(0x81, 64))
        assert got == data


def test_an_empty_packet_goes_and_comes(device):
    assert device.write(0x02, b"") == 0
    assert bytes(device.read(0x81, 64)) == b""


def test_a_read_ends_with_a_short_packet(device):
    device.write(0x02, bytes(70))
    assert bytes(device.read(0x81, 640)) == bytes(70)


def test_timeouts_are_those_of_libusb(device):
    error = fails(errno.ETIMEDOUT, device.read, 0x81, 64, 50)
    assert isinstance(error, usb.core.USBTimeoutError)
    assert error.backend_error_code == -7
    device.write(0x02, b"after")
    assert bytes(device.read(0x81, 64)) == b"after"


def test_what_came_before_a_timeout_is_returned(device, sim):
    device.ctrl_transfer(0x40, BURST, 128)
    assert len(device.read(0x81, 640, 50)) == 128
    device.ctrl_transfer(0x40, HOLD, 1)
    # Two banks take two packets.
    assert device.write(0x02, bytes(640), 50) == 128
    fails(errno.ETIMEDOUT, device.write, 0x02, bytes(640), 50)
    device.ctrl_transfer(0x40, HOLD, 0)
    assert [len(device.read(0x81, 64)) for _ in range(2)] == [64, 64]
    assert sim.usb.counters.wrong_toggles == 0


def test_no_byte_is_lost_to_a_timeout(device, sim):
    """Timeouts as short as they can be, so that many come while a packet is on the wire."""
    data = bytes(i * 5 & 0xFF for i in range(20_000))

    def write():
        at = 0
        while at < len(data):
            with contextlib.suppress(usb.core.USBTimeoutError):
                at += device.write(0x02, data[at : at + 1000], 1)
            time.sleep(0.003 * (at % 5 == 0))  # on any machine some reads wait in vain

    writing = Call(write)
    got, cut = b"", 0
    while len(got) < len(data):
        with contextlib.suppress(usb.core.USBTimeoutError):
            part = bytes(device.read(0x81, 640, 1))
            got += part
            cut += len(part) % 64 == 0 and len(part) < 640
    writing.join()
    assert got == data
    assert cut, "no read ended by its timeout"
    assert sim.usb.counters.wrong_toggles == 0


def test_a_timeout_takes_its_time(device):
    began_s = time.monotonic()
    fails(errno.ETIMEDOUT, device.read, 0x81, 64, 200)
    assert time.monotonic() - began_s > 0.15


def test_a_buffer_too_small_is_an_overflow(device):
    device.write(0x02, bytes(64))
    assert fails(errno.EOVERFLOW, device.read, 0x81, 10).backend_error_code == -8


def test_control_transfers(device):
    assert device.ctrl_transfer(0x40, KEEP, 0, 0, b"sixteen bytes...") == 16
    assert bytes(device.ctrl_transfer(0xC0, KEEP, 0, 0, 16)) == b"sixteen bytes..."
    assert bytes(device.ctrl_transfer(0xC0, KEEP, 0, 0, 64)) == b"sixteen bytes..."
    for _ in range(3):
        assert fails(errno.EPIPE, device.ctrl_transfer, 0xC0, 99, 0, 0, 8).backend_error_code == -9
    assert device.get_active_configuration().bConfigurationValue == 1


def test_interrupt_transfers(device, sim):
    assert device.write(0x03, b"0123456789") == 10
    device.ctrl_transfer(0xC0, KEEP, 0, 0, 1)  # until the board has taken it
    assert sim.read_memory("sync_length", 1) == b"\x0a"
    assert sim.read_memory("sync_packet", 10) == b"0123456789"


@pytest.mark.parametrize("endpoint", [0x81, 0x02])
def test_a_halt_and_its_end(device, sim, endpoint):
    """An odd number of packets before it, so that the data toggles have to be set back."""
    device.write(0x02, b"x")
    device.read(0x81, 64)
    device.ctrl_transfer(0x40, HALT, endpoint)
    call = (device.read, 0x81, 64) if endpoint & 0x80 else (device.write, 0x02, b"y")
    fails(errno.EPIPE, *call)
    device.clear_halt(endpoint)
    device.write(0x02, b"z")
    assert bytes(device.read(0x81, 64)) == b"z"
    assert sim.usb.counters.wrong_toggles == 0


def test_configurations(device, backend):
    device.write(0x02, b"x")
    device.read(0x81, 64)
    fails(errno.EBUSY, device.set_configuration)
    usb.util.dispose_resources(device)
    device.set_configuration()
    device.write(0x02, b"x")
    assert bytes(device.read(0x81, 64)) == b"x"
    usb.util.dispose_resources(device)
    device.set_configuration(0)
    usb.util.dispose_resources(device)
    with pytest.raises(usb.core.USBError, match="Configuration not set"):
        usb.core.find(backend=backend).get_active_configuration()
    handle = backend.open_device(next(backend.enumerate_devices()))
    fails(errno.ENOENT, backend.set_configuration, handle, 7)


def test_claims(device, backend):
    other = usb.core.find(backend=backend)
    usb.util.claim_interface(device, 0)
    fails(errno.EBUSY, usb.util.claim_interface, other, 0)
    usb.util.claim_interface(other, 1)
    fails(errno.ENOENT, usb.util.claim_interface, device, 2)
    usb.util.release_interface(device, 0)
    usb.util.claim_interface(other, 0)
    usb.util.dispose_resources(other)
    device.set_interface_altsetting(0, 0)


def test_no_kernel_driver(device):
    assert device.is_kernel_driver_active(0) is False
    fails(errno.ENOENT, device.detach_kernel_driver, 0)
    fails(errno.ENOENT, device.attach_kernel_driver, 0)


def test_reset(device, sim):
    device.write(0x02, b"x")
    waiting = Call(device.read, 0x81, 64, UNTIL_DONE)
    assert bytes(waiting.join().result) == b"x"
    waiting = Call(device.read, 0x81, 64, UNTIL_DONE)
    while not sim.usb.pending:
        time.sleep(0.001)
    device.reset()
    assert waiting.join().error.errno == errno.EIO
    device.write(0x02, b"y")
    assert bytes(device.read(0x81, 64)) == b"y"
    assert sim.usb.counters.wrong_toggles == 0


def test_unplug_and_plug(device, backend, sim):
    waiting = Call(device.read, 0x81, 64, UNTIL_DONE)
    while not sim.usb.pending:
        time.sleep(0.001)
    backend.unplug(sim)
    assert waiting.join().error.errno == errno.ENODEV
    assert waiting.error.backend_error_code == -4
    fails(errno.ENODEV, device.write, 0x02, b"x")
    fails(errno.ENODEV, device.reset)
    assert usb.core.find(backend=backend) is None
    backend.plug(sim)
    fails(errno.ENODEV, device.write, 0x02, b"x")
    again = usb.core.find(backend=backend)
    assert (again.address, again.port_number) == (2, 1)
    again.write(0x02, b"x")
    assert bytes(again.read(0x81, 64)) == b"x"


def test_a_board_that_detaches_itself(device, backend, sim):
    device.ctrl_transfer(0x40, DETACH)
    assert fails(errno.ENODEV, device.read, 0x81, 64).backend_error_code == -4
    assert usb.core.find(backend=backend) is None


def test_a_firmware_that_stops(device):
    with pytest.raises(usb.core.USBError):
        device.ctrl_transfer(0x40, STOP)
        device.read(0x81, 64)
    fails(errno.EIO, device.write, 0x02, b"x")


@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_reading_and_writing_at_once(usb_board, speed):
    device = usb.core.find(backend=SimBackend(usb_board(), speed=speed))
    packets = [bytes([i]) * (1 + i % 63) for i in range(200)]

    def read_all():
        return [bytes(device.read(0x81, 64, UNTIL_DONE)) for _ in packets]

    reading = Call(read_all)
    for packet in packets:
        device.write(0x02, packet, UNTIL_DONE)
    assert reading.join().result == packets


def test_two_boards_and_one_that_stalls(usb_board):
    """By serial number; the board that takes nothing does not delay the other."""
    backend = SimBackend([usb_board(SERIAL=ord("A")), usb_board(SERIAL=ord("B"))])
    slow, fast = (usb.core.find(backend=backend, serial_number=name) for name in ("SNA", "SNB"))
    assert (slow.address, fast.address, fast.port_number) == (1, 2, 2)
    slow.ctrl_transfer(0x40, HOLD, 1)
    held = Call(slow.write, 0x02, bytes(640), UNTIL_DONE)
    for i in range(100):
        fast.write(0x02, bytes([i]))
        assert bytes(fast.read(0x81, 64)) == bytes([i])
    assert held.thread.is_alive()
    slow.ctrl_transfer(0x40, HOLD, 0)
    got = 0
    while got < 640:
        got += len(slow.read(0x81, 64))
    assert held.join().result == 640


def test_without_pyusb(monkeypatch):
    monkeypatch.setitem(sys.modules, "j2a_sim._usb.backend", None)
    with pytest.raises(ImportError, match="pip install pyusb"):
        j2a_sim.SimBackend  # noqa: B018 - getting it is what fails
    with pytest.raises(AttributeError, match="nothing_like_it"):
        j2a_sim.nothing_like_it  # noqa: B018


def test_bad_arguments(usb_board, sim, backend):
    with pytest.raises(SimError, match="speed -1 is out of range"):
        SimBackend(usb_board(), speed=-1)
    with pytest.raises(SimError, match="none of the backend's"):
        backend.unplug(usb_board())
