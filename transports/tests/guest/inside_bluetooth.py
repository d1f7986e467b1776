"""RFCOMM between two controllers: the tests that run inside the guest, both ends in one process.

In: the guest.  Out: what pytest says.  Rules: test_bluetooth.py starts it there; the kernel of the
guest is not to be asked for devices that are not there, because Debian's 6.1.192 dies of it.
"""

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import j2a_transports
import pytest
from j2a_transports import LinkLost, Listener, OpenFailed, Transport

# The suite that every transport passes is a test itself, in a folder that is no package.
from ..suite import (
    PATIENCE_S,
    Background,
    BackToBack,
    read_exactly,
)
from . import bluetooth

# Reasons in the command that ends a connection: what a link that has died is told with, and what
# a device says that closes it.
CONNECTION_TIMEOUT, USER_ENDED = 0x08, 0x13


@pytest.fixture(scope="session", autouse=True)
def air() -> Iterator[list[str]]:
    with bluetooth.controllers() as addresses:
        yield addresses


def accepted(listener: Listener) -> Transport:
    transport = listener.accept(PATIENCE_S)
    assert transport is not None
    return transport


@contextmanager
def linked(listener: Listener, **options: object) -> Iterator[tuple[Transport, Transport]]:
    """Open what a listener at hci0 offers from hci1."""
    near = j2a_transports.open(listener.url, adapter="hci1", **options)
    with near, accepted(listener) as far:
        yield near, far


def echo(near: Transport, far: Transport, word: bytes = b"\x12hello\xed") -> None:
    near.write(word)
    assert read_exactly(far, len(word)) == word
    far.write(word)
    assert read_exactly(near, len(word)) == word


@pytest.fixture
def listener() -> Iterator[Listener]:
    with j2a_transports.listen("bt://hci0/") as one:
        yield one


class TestRfcomm(BackToBack):
    """The suite that every transport passes."""

    @contextmanager
    def connect(self) -> Iterator[tuple[Transport, Transport]]:
        with j2a_transports.listen("bt://hci0/") as listener, linked(listener) as ends:
            yield ends


class TestChannels:
    def test_the_listener_says_where_it_is(self, air: list[str]) -> None:
        with (
            j2a_transports.listen("bt:") as anywhere,
            j2a_transports.listen(f"bt://{air[0]}/9") as fixed,
            j2a_transports.listen("bt:///30") as last,
        ):
            address, channel = anywhere.url.removeprefix("bt://").split("/")
            assert address == air[0]
            assert 1 <= int(channel) <= 30
            assert fixed.url == f"bt://{air[0]}/9"
            assert last.url == f"bt://{air[0]}/30"
            for listener in (anywhere, fixed, last):
                with linked(listener) as (near, far):
                    assert far.url == f"bt://{air[1]}/{listener.url.rpartition('/')[2]}"
                    echo(near, far)

    def test_a_channel_that_is_taken(self, listener: Listener) -> None:
        with pytest.raises(OpenFailed, match="another program listens there"):
            j2a_transports.listen(listener.url)

    def test_a_channel_where_nobody_listens(self, air: list[str]) -> None:
        with pytest.raises(OpenFailed, match="the device refuses channel 29: start what listens"):
            j2a_transports.open(f"bt://{air[0]}/29", adapter="hci1")

    def test_a_channel_that_is_open_already(self, listener: Listener) -> None:
        with linked(listener), pytest.raises(OpenFailed, match="is in use; close the other"):
            j2a_transports.open(listener.url, adapter="hci1")

    def test_a_listener_that_comes_a_moment_later(self, air: list[str]) -> None:
        before = j2a_transports.listen("bt://hci0/")
        url = before.url
        before.close()
        opening = Background(lambda: j2a_transports.open(url, adapter="hci1"))
        time.sleep(0.2)
        with (
            j2a_transports.listen(url) as listener,
            opening.result() as near,
            accepted(listener) as far,
        ):
            echo(near, far)

    def test_an_adapter_that_is_not_there(self, air: list[str]) -> None:
        with pytest.raises(OpenFailed, match=f"there is: hci0 {air[0]}, hci1 {air[1]}"):
            j2a_transports.open(f"bt://{air[0]}/1", adapter="hci7")


class TestLosses:
    @pytest.mark.parametrize(
        ("reason", "says"),
        [
            (CONNECTION_TIMEOUT, "does not answer any more: out of range, or switched off"),
            (USER_ENDED, "the device closed it"),
        ],
    )
    def test_a_link_that_dies_is_lost_at_both_ends_and_opens_again(
        self, listener: Listener, air: list[str], reason: int, says: str
    ) -> None:
        for _ in range(3):
            with linked(listener) as (near, far):
                echo(near, far)
                subprocess.run(["hcitool", "-i", "hci1", "dc", air[0], str(reason)], check=True)
                for end in (near, far):
                    with pytest.raises(LinkLost, match=says):
                        end.read(PATIENCE_S)
                    with pytest.raises(LinkLost, match=says):
                        end.write(b"x")
        with linked(listener) as (near, far):
            echo(near, far)

    def test_a_writer_that_hears_first_of_the_end_leaves_it_for_the_reader(
        self, listener: Listener
    ) -> None:
        """The kernel tells its error once."""
        with linked(listener) as (near, far):
            near.write(b"last")
            near.close()
            deadline = time.monotonic() + PATIENCE_S
            with pytest.raises(LinkLost, match="the device closed it"):
                while time.monotonic() < deadline:
                    far.write(b"x")
            assert far.read(PATIENCE_S) == b"last"
            with pytest.raises(LinkLost, match="the device closed it"):
                far.read(PATIENCE_S)

    def test_adapters_switched_off_and_on_again(self, listener: Listener, air: list[str]) -> None:
        with linked(listener) as (near, far):
            echo(near, far)
            # Both, because the radio waves here do not tell the other one.
            for index in (0, 1):
                bluetooth.down(index)
            for end in (near, far):
                with pytest.raises(LinkLost, match="this machine has disconnected"):
                    end.read(PATIENCE_S)
        try:
            with pytest.raises(OpenFailed, match="switched off: `bluetoothctl power on`"):
                j2a_transports.open(listener.url, adapter="hci1")
            with pytest.raises(OpenFailed, match="switched off: `bluetoothctl power on`"):
                j2a_transports.listen("bt:")
        finally:
            for index in (0, 1):
                bluetooth.up(index)
        with linked(listener) as (near, far):
            echo(near, far)


def test_a_terminal_of_the_kernel(listener: Listener, air: list[str]) -> None:
    """`rfcomm bind` makes a serial port, which pyserial opens."""
    channel = listener.url.rpartition("/")[2]
    subprocess.run(["rfcomm", "-i", "hci1", "bind", "0", air[0], channel], check=True)
    try:
        bluetooth.until(Path("/dev/rfcomm0").exists, "the terminal")
        for _ in range(2):
            with (
                j2a_transports.open("serial:///dev/rfcomm0") as near,
                accepted(listener) as far,
            ):
                echo(near, far, bytes(range(256)))
                far.close()
                with pytest.raises(LinkLost):
                    near.read(PATIENCE_S)
    finally:
        subprocess.run(["rfcomm", "release", "0"], check=True)


@pytest.fixture(scope="module")
def bluez() -> Iterator[None]:
    with bluetooth.bluez():
        yield


@pytest.mark.usefixtures("bluez")
class TestServiceDiscovery:
    """Last, because BlueZ switches the controllers off when it ends."""

    def test_a_device_without_a_serial_port(self, air: list[str]) -> None:
        with pytest.raises(OpenFailed, match="publishes no serial port; start the program"):
            j2a_transports.open(f"bt://{air[0]}", adapter="hci1")

    @pytest.mark.requirement("SPP-001", "SPP-002")
    def test_the_record_leads_to_the_channel_while_the_listener_is_there(
        self, air: list[str]
    ) -> None:
        url = f"bt://{air[0]}"
        with j2a_transports.listen("bt://hci0/23", service="J2A board ä") as listener:
            browsed = subprocess.run(
                ["sdptool", "browse", "local"], capture_output=True, text=True, check=True
            ).stdout
            assert "Service Name: J2A board ä" in browsed
            assert "Channel: 23" in browsed
            for options in ({}, {"service": "J2A board ä"}):
                with (
                    j2a_transports.open(url, adapter="hci1", **options) as near,
                    accepted(listener) as far,
                ):
                    echo(near, far)
        with pytest.raises(OpenFailed, match="publishes no serial port"):
            j2a_transports.open(url, adapter="hci1")

    def test_the_record_of_another_program(self, air: list[str]) -> None:
        subprocess.run(["sdptool", "add", "--channel=7", "SP"], check=True)
        with j2a_transports.listen("bt://hci0/7") as seven:
            with (
                j2a_transports.open(f"bt://{air[0]}", adapter="hci1") as near,
                accepted(seven) as far,
            ):
                echo(near, far)
            with (
                j2a_transports.listen("bt://hci0/8", service="eight") as eight,
                j2a_transports.open(f"bt://{air[0]}?service=eight", adapter="hci1") as near,
                accepted(eight) as far,
            ):
                echo(near, far)
                with pytest.raises(OpenFailed, match="named 'nine'; it has 'Serial Port'"):
                    j2a_transports.open(f"bt://{air[0]}", adapter="hci1", service="nine")

    def test_many_records(self, air: list[str]) -> None:
        """The answer comes in several packets."""
        names = [f"board {index} {'x' * 200}" for index in range(12)]
        listeners = [
            j2a_transports.listen(f"bt://hci0/{10 + index}", service=name)
            for index, name in enumerate(names)
        ]
        with (
            j2a_transports.open(f"bt://{air[0]}", adapter="hci1", service=names[-1]) as near,
            accepted(listeners[-1]) as far,
        ):
            echo(near, far)
        for listener in listeners:
            listener.close()


@pytest.mark.usefixtures("bluez")
def test_pairing() -> None:
    """Both sides demand it; nobody is there to compare numbers, which the highest level needs."""
    with bluetooth.agent():
        for _ in range(2):
            with (
                j2a_transports.listen("bt://hci0/?security=medium") as listener,
                linked(listener, security="medium") as (near, far),
            ):
                echo(near, far)
        with (
            j2a_transports.listen("bt://hci0/?security=high") as listener,
            pytest.raises(OpenFailed, match=r"`bluetoothctl pair 00:AA:|confirm a pairing"),
        ):
            j2a_transports.open(listener.url, adapter="hci1", security="high")
