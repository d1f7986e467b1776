"""`usb://` on the kernel's USB stack: what runs inside the guest, both ends in one process.

In: the guest, whose dummy_hcd joins a host controller with a device controller.  Out: what pytest
says.  Rules: test_usb.py starts it there; the board is our own gadget.
"""

import gc
import random
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import j2a_transports
import pytest
import usb.core
import usb.util
from j2a_transports import (
    LinkClosed,
    LinkLost,
    Listener,
    OpenFailed,
    Transport,
    UsbArrived,
    UsbBoard,
    UsbLeft,
    usb_boards,
    watch_usb,
)
from j2a_transports._usb.find import libusb
from j2a_transports._usb.pipes import BlockingPipes
from j2a_transports._usb.transfers import AsyncPipes

from ..suite import (
    MEGABYTE,
    PATIENCE_S,
    Background,
    read_exactly,
)

CONTROLLER = Path("/sys/kernel/config/usb_gadget/j2a/UDC")
SETTLE_S = 0.3
# More than all buffers on the way hold; a whole megabyte takes an emulated processor a minute.
MUCH = MEGABYTE // 8


class Plug:
    """The plug of the board, pulled by taking the gadget off its controller.

    It is put back by the next test, when both ends are closed: a board that leaves while the host
    enumerates it costs the host's port seconds.
    """

    def __init__(self) -> None:
        self._name = ""

    def pull(self) -> None:
        self._name = CONTROLLER.read_text().strip()
        CONTROLLER.write_text("\n")

    def put_back(self) -> None:
        if self._name:
            CONTROLLER.write_text(self._name)
        self._name = ""


plug = Plug()


@pytest.fixture(scope="session")
def gadget() -> Iterator[Listener]:
    with j2a_transports.listen("gadget:?serial=G1") as listener:
        yield listener


def accepted(listener: Listener) -> Transport:
    plug.put_back()
    transport = listener.accept(PATIENCE_S)
    assert transport is not None
    return transport


@contextmanager
def linked(listener: Listener, **options: object) -> Iterator[tuple[Transport, Transport]]:
    with accepted(listener) as far, j2a_transports.open("usb://G1?wait=30", **options) as near:
        yield near, far


def plugged() -> UsbBoard:
    """Wait for the board, and return it."""
    with watch_usb() as watch:
        event = watch.next(PATIENCE_S)
    assert isinstance(event, UsbArrived)
    return event.board


@pytest.fixture(params=[4, 1], ids=["asynchronous", "blocking"])
def ends(gadget: Listener, request: pytest.FixtureRequest) -> Iterator[tuple[Transport, Transport]]:
    with linked(gadget, transfers=request.param) as both:
        kind = AsyncPipes if request.param > 1 else BlockingPipes
        assert isinstance(both[0]._pipes, kind)
        yield both


class TestStream:
    def test_much_both_ways(self, ends: tuple[Transport, Transport]) -> None:
        near, far = ends
        out, back = random.Random(1).randbytes(MUCH), random.Random(2).randbytes(MUCH)
        writers = [Background(lambda: near.write(out)), Background(lambda: far.write(back))]
        reader = Background(lambda: read_exactly(far, MUCH))
        assert read_exactly(near, MUCH) == back
        assert reader.result() == out
        for writer in writers:
            writer.result()

    def test_unplugging_ends_a_blocked_read(self, ends: tuple[Transport, Transport]) -> None:
        reader = Background(lambda: ends[0].read(None))
        reader.thread.join(SETTLE_S)
        plug.pull()
        with pytest.raises(LinkLost, match="unplugged"):
            reader.result()

    def test_unplugging_while_bytes_run_both_ways(self, ends: tuple[Transport, Transport]) -> None:
        near, far = ends
        near.write_timeout_s = None

        def for_ever(transport: Transport) -> None:
            while True:
                transport.write(bytes(5000))

        def read(transport: Transport) -> None:
            while True:
                transport.read(None)

        tasks = [
            Background(lambda: for_ever(near)),
            Background(lambda: for_ever(far)),
            Background(lambda: read(near)),
            Background(lambda: read(far)),
        ]
        tasks[0].thread.join(SETTLE_S)
        plug.pull()
        for task in tasks:
            with pytest.raises(LinkLost):
                task.result()

    def test_closing_ends_a_blocked_read(self, ends: tuple[Transport, Transport]) -> None:
        reader = Background(lambda: ends[0].read(None))
        reader.thread.join(SETTLE_S)
        ends[0].close()
        with pytest.raises(LinkClosed):
            reader.result()

    def test_closing_while_bytes_arrive(self, ends: tuple[Transport, Transport]) -> None:
        near, far = ends
        writer = Background(lambda: far.write(bytes(MEGABYTE)))
        read_exactly(near, 10_000)
        near.close()
        # The gadget waits so long for a host to take the rest.
        far.write_timeout_s = 0.1
        far.close()
        with pytest.raises(LinkClosed):
            writer.result()

    def test_a_reset_by_another_program_is_a_lost_link(
        self, ends: tuple[Transport, Transport]
    ) -> None:
        reader = Background(lambda: ends[0].read(None))
        reader.thread.join(SETTLE_S)
        device = usb.core.find(backend=libusb(), idVendor=0x6666)
        device.reset()
        usb.util.dispose_resources(device)
        with pytest.raises(LinkLost, match="unplugged or reset"):
            reader.result()

    def test_the_far_end_reads_what_a_program_wrote_that_ended(self, gadget: Listener) -> None:
        """A program that closes nothing ends without a crash, and its bytes are there."""
        program = (
            "import j2a_transports\n"
            "near = j2a_transports.open('usb://G1?wait=30')\n"
            "near.write(bytes(3000))\n"
        )
        with accepted(gadget) as far:
            reader = Background(lambda: read_exactly(far, 3000))
            done = subprocess.run(
                [sys.executable, "-W", "error", "-c", program],
                capture_output=True,
                text=True,
                check=False,
            )
            assert (done.returncode, done.stderr) == (0, "")
            assert reader.result() == bytes(3000)


class TestBoards:
    def test_what_is_known_of_the_board(self, gadget: Listener) -> None:
        with accepted(gadget):
            board = plugged()
            print(board)
            assert board.url == "usb://G1"
            assert (board.vendor, board.product, board.serial) == (0x6666, 0xCAFE, "G1")
            assert board.manufacturer
            assert board.name
            assert board.device_file == f"/dev/bus/usb/{board.bus:03}/{board.address:03}"
            assert Path(board.device_file).exists()
            assert board.port_path == f"{board.bus}-1"
            assert board.speed in (12, 480)
            assert board.sync
            assert board.problem is None

    @pytest.mark.parametrize(
        "text",
        ["{serial}", "6666:CAFE", "{bus:03}:{address:03}", "{port_path}", "{device_file}"],
    )
    def test_every_form_of_address_opens_it(self, gadget: Listener, text: str) -> None:
        with accepted(gadget) as far:
            board = plugged()
            fields = {name: getattr(board, name) for name in board.__slots__}
            with j2a_transports.open(f"usb://{text.format(**fields)}") as near:
                near.write(b"hello")
                assert read_exactly(far, 5) == b"hello"

    def test_a_second_program_is_told_that_it_is_busy(
        self, ends: tuple[Transport, Transport]
    ) -> None:
        with pytest.raises(OpenFailed, match="another program uses it"):
            j2a_transports.open("usb://G1")

    def test_without_rights_the_board_is_shown_and_the_rule_is_named(
        self, gadget: Listener
    ) -> None:
        program = (
            "import j2a_transports\n"
            "(board,) = j2a_transports.usb_boards()\n"
            "print(board.url, board.problem)\n"
            "try:\n"
            "    j2a_transports.open(board.url)\n"
            "except j2a_transports.OpenFailed as error:\n"
            "    print(error)\n"
        )
        # The capability lets nobody read a repository in a private home, and write nothing.
        nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
        nobody += ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
        with accepted(gadget):
            plugged()
            done = subprocess.run(
                [*nobody, sys.executable, "-c", program],
                capture_output=True,
                text=True,
                check=False,
            )
            shown, refused = done.stdout.splitlines()
            assert shown.startswith("usb://G1 not allowed to open it")
            assert refused.startswith("usb://G1: not allowed to open it")
            assert "setup udev` once and plug it in again" in refused

    def test_plugging_is_told_by_the_kernel(self, gadget: Listener) -> None:
        with accepted(gadget), watch_usb(interval_s=PATIENCE_S * 10) as watch:
            first = watch.next(PATIENCE_S)
            assert isinstance(first, UsbArrived)
            waiting = Background(lambda: watch.next(PATIENCE_S))
            waiting.thread.join(SETTLE_S)
            plug.pull()
            assert waiting.result() == UsbLeft(first.board)
            plug.put_back()
            again = watch.next(PATIENCE_S)
            assert isinstance(again, UsbArrived)
            assert again.board.url == first.board.url
            assert again.board.address != first.board.address

    def test_the_other_interfaces_driver_is_left_alone(
        self, ends: tuple[Transport, Transport]
    ) -> None:
        bound = {
            path.parent.name: path.resolve().name
            for path in Path("/sys/bus/usb/devices").glob("*:1.*/driver")
        }
        board = usb_boards()[0]
        assert bound[f"{board.port_path}:1.{board.interface}"] == "usbfs"
        assert "usbfs" not in [
            driver for name, driver in bound.items() if not name.endswith(f".{board.interface}")
        ]

    def test_opening_and_closing_leaves_nothing_behind(self, gadget: Listener) -> None:
        with accepted(gadget):
            plugged()
            for _ in range(10):
                j2a_transports.open("usb://G1").close()
            gc.collect()
            assert not [one for one in threading.enumerate() if one.name.startswith("usb ")]
            opened = [str(fd.resolve()) for fd in Path("/proc/self/fd").iterdir()]
            assert not [name for name in opened if name.startswith("/dev/bus/usb/")]


def test_no_board_is_there_when_none_is_plugged_in() -> None:
    with pytest.raises(OpenFailed, match="no J2A board is on the USB"):
        j2a_transports.open("usb://")
