"""Finding and opening USB boards: names, addresses, and what is said when it does not work."""

from __future__ import annotations

import builtins
import errno
import os
import sys
import threading
from pathlib import Path
from typing import Any

import j2a_transports
import pytest
import usb.core
from j2a_spec import constants
from j2a_transports import BadUrl, MissingExtra, OpenFailed, usb_boards
from j2a_transports._usb import find
from j2a_transports._usb.address import Address

from .fake_libusb import give_libusb
from .fake_usb import (
    SYNC,
    FakeDevice,
    board,
    endpoint,
    interface,
    usb_error,
)
from .fake_usb_backend import FakeBackend


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> FakeBackend:
    """What `usb://` finds; the tests put devices on it."""
    backend = FakeBackend()
    monkeypatch.setattr("j2a_transports._usb.link.libusb", lambda what: backend)
    monkeypatch.setattr("j2a_transports._usb.pipes.SLICE_MS", 10)
    return backend


def names(*devices: FakeDevice) -> list[str]:
    return [each.url for each in usb_boards(FakeBackend(*devices))]


def talks(device: FakeDevice, url: str, **options: Any) -> bool:
    """Tell whether the URL opens this device, of possibly several."""
    with j2a_transports.open(url, **options) as near:
        near.write(b"?")
        return bool(device.pipes[0x02].packets)


def opened_and_closed(device: FakeDevice) -> bool:
    """Tell whether everything that was taken has been given back."""
    return device.handles == 0 and device.busy == set()


@pytest.mark.requirement("USB-002", "SYNC-001")
def test_the_numbers_are_those_of_the_specification() -> None:
    kind = (constants.USB_CLASS, constants.USB_SUBCLASS, constants.USB_PROTOCOL)
    sync = (constants.USB_CLASS, constants.SYNCUSB_SUBCLASS, constants.SYNCUSB_PROTOCOL)
    assert kind == find.LINK_CLASS
    assert sync == find.SYNC_CLASS


def test_what_is_known_of_a_board() -> None:
    (found,) = usb_boards(FakeBackend(board()))
    assert found == j2a_transports.UsbBoard(
        url="usb://A1",
        vendor=0x6666,
        product=0xCAFE,
        manufacturer="J2A",
        name="demo board",
        serial="A1",
        bus=1,
        address=4,
        port_path="1-2.3",
        speed=12.0,
        interface=0,
        device_file=None,
        sync=True,
        problem=None,
    )


def test_looking_leaves_a_board_closed() -> None:
    device = board()
    usb_boards(FakeBackend(device))
    assert opened_and_closed(device)


@pytest.mark.requirement("USB-002")
def test_a_board_is_told_by_its_interface_whatever_its_ids_and_number() -> None:
    ends = [endpoint(0x85), endpoint(0x06)]
    composite = FakeDevice(
        [interface(0, (3, 0, 0), [endpoint(0x81, 3)]), interface(7, endpoints=ends)],
        vendor=0x1234,
        product=0x5678,
    )
    keyboard = FakeDevice([interface(0, (3, 1, 1), [endpoint(0x81, 3)])], address=5)
    (found,) = usb_boards(FakeBackend(keyboard, composite))
    assert (found.vendor, found.interface, found.sync) == (0x1234, 7, False)


def test_an_interface_without_both_endpoints_is_none() -> None:
    assert names(FakeDevice([interface(endpoints=[endpoint(0x81)])])) == []
    assert names(FakeDevice([interface(endpoints=[endpoint(0x81, 1), endpoint(0x02, 1)])])) == []


def test_a_board_that_cannot_be_read_is_shown_with_advice() -> None:
    (found,) = usb_boards(FakeBackend(board(denied=True)))
    assert (found.serial, found.name, found.url) == (None, None, "usb://1-2.3")
    assert found.problem is not None
    assert 'run `sudo "$(command -v j2a)" setup udev` once' in found.problem


def test_on_windows_the_advice_is_winusb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    device = board(refuses={"open_device": NotImplementedError()})
    (found,) = usb_boards(FakeBackend(device))
    assert found.problem is not None
    assert "WinUSB" in found.problem
    with pytest.raises(OpenFailed, match="WinUSB"):
        j2a_transports.open_usb_device(usb.core.find(backend=FakeBackend(device)))


def test_devices_that_go_or_fail_meanwhile_do_not_disturb() -> None:
    class Hasty(FakeBackend):
        def enumerate_devices(self) -> list[FakeDevice]:
            return self.devices

    broken = board(refuses={"get_configuration_descriptor": usb_error(errno.EIO)}, address=9)
    found = usb_boards(Hasty(board(gone=True), broken, board(serial="B2")))
    assert [each.serial for each in found] == ["B2"]


def test_a_backend_that_lists_nothing_is_an_error_of_ours(bus: FakeBackend) -> None:
    bus.broken = True
    with pytest.raises(OpenFailed, match="cannot be listed"):
        usb_boards(bus)
    with pytest.raises(OpenFailed, match="cannot be listed"):
        j2a_transports.open("usb://")


def test_names_are_stable_and_different() -> None:
    assert names(board(serial="A1"), board(serial="B2", address=5)) == ["usb://A1", "usb://B2"]
    assert names(board(serial=None)) == ["usb://1-2.3"]
    assert names(board(serial=None, ports=None)) == ["usb://001:004"]
    # Equal serial numbers: other ids tell them apart, or else where they are plugged in.
    assert names(board(), board(product=0xF00D, address=5)) == [
        "usb://6666:cafe/A1",
        "usb://6666:f00d/A1",
    ]
    assert names(board(), board(address=5, ports=(4,))) == ["usb://1-2.3", "usb://1-4"]
    # A serial number that looks like something else, or needs escapes.
    assert names(board(serial="1-2")) == ["usb://6666:cafe/1-2"]
    assert names(board(serial="AA:BB/ü?")) == ["usb://AA%3ABB%2F%C3%BC%3F"]
    # Two links in one device.
    more = interface(5, endpoints=[endpoint(0x84), endpoint(0x05)])
    assert names(FakeDevice([interface(), more])) == [
        "usb://A1?interface=0",
        "usb://A1?interface=5",
    ]


SPECIALS = ["A1", "1-2", "AA:BB/ü?&=%", "0001:0002", "001:004", "dev", "a b"]


@pytest.mark.parametrize("serial", SPECIALS)
def test_the_name_of_a_board_opens_it(bus: FakeBackend, serial: str) -> None:
    others = [board(serial=text, address=10 + at, ports=(at,)) for at, text in enumerate("XYZ")]
    device = board(serial=serial)
    bus.devices += [*others, device]
    url = next(each.url for each in usb_boards(bus) if each.serial == serial)
    assert talks(device, url)
    assert opened_and_closed(device)
    assert talks(device, "usb://", serial=serial)


ADDRESSES = ["", "A1", "6666:CAFE", "6666:cafe/A1", "001:004", "1:4", "1-2.3", "?serial=A1"]


def test_a_serial_number_of_digits_is_no_port_of_a_host(bus: FakeBackend) -> None:
    bus.devices.append(board(serial="0001"))
    assert talks(bus.devices[0], "usb:0001")


@pytest.mark.parametrize("text", ADDRESSES)
def test_every_form_of_address_finds_the_board(bus: FakeBackend, text: str) -> None:
    bus.devices.append(board())
    assert talks(bus.devices[0], f"usb://{text}")
    assert talks(bus.devices[0], f"usb:{text}")


@pytest.mark.parametrize(
    "text", ["B2", "6666:f00d", "6666:cafe/B2", "001:005", "002:004", "1-2", "2-2.3", "?serial=B2"]
)
def test_what_does_not_fit_is_not_opened_and_what_is_there_is_listed(
    bus: FakeBackend, text: str
) -> None:
    bus.devices += [board(), board(address=7, serial="C3", ports=(9,))]
    with pytest.raises(OpenFailed, match=r"only these: usb://A1, usb://C3$"):
        j2a_transports.open(f"usb://{text}")


def test_what_was_taken_for_a_serial_number_is_said(bus: FakeBackend) -> None:
    bus.devices.append(board())
    for url in ("usb://6666", "usb:6666", "usb:?serial=6666"):
        with pytest.raises(OpenFailed, match=r"has the serial number '6666'; .* these: usb://A1$"):
            j2a_transports.open(url)


def test_more_than_one_board_are_listed(bus: FakeBackend) -> None:
    bus.devices += [board(), board(serial="B2", address=5), board(product=1, address=6)]
    with pytest.raises(OpenFailed, match=r"one of these: usb://6666:cafe/A1, usb://B2$"):
        j2a_transports.open("usb://6666:cafe")
    with pytest.raises(OpenFailed, match=r"^usb: more than one fits"):
        j2a_transports.open("usb:")


def test_no_board_says_what_to_check(bus: FakeBackend) -> None:
    with pytest.raises(OpenFailed, match=r"cable.*`lsusb` .package usbutils."):
        j2a_transports.open("usb://")
    with pytest.raises(OpenFailed, match="no device on the USB has an interface 3"):
        j2a_transports.open("usb://A1?interface=3")


@pytest.mark.parametrize(
    "text", ["6666:caf", "1:2:3", "x/y", "0001:4", "6666:cafe/A/B", "1000:1", "1234:zzzz"]
)
def test_a_malformed_address_gets_all_forms(text: str) -> None:
    with pytest.raises(BadUrl, match=r"usb://SERIAL.*usb://\?serial=TEXT"):
        j2a_transports.open(f"usb://{text}")


def test_wrong_options() -> None:
    with pytest.raises(BadUrl, match="given twice"):
        Address.parse("usb://A1?serial=B2", "//A1", "B2")
    for option, said in (
        ("baud=1", "usb has: interface, serial, transfers, wait, write_timeout"),
        ("interface=256", "whole number from 0 to 255"),
        ("transfers=0", "whole number from 1 to 64"),
    ):
        with pytest.raises(BadUrl, match=said):
            j2a_transports.open(f"usb://?{option}")


def test_a_device_file_with_a_name_that_is_too_long() -> None:
    url = "usb:///" + "a" * 300
    j2a_transports.check(url)
    with pytest.raises(OpenFailed, match="there is no /aaa"):
        j2a_transports.open(url)


@pytest.mark.parametrize("transfers", [1, 4])
def test_without_a_thread_a_board_is_given_back(
    bus: FakeBackend, monkeypatch: pytest.MonkeyPatch, transfers: int
) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    give_libusb(monkeypatch)
    bus.devices.append(board())
    with monkeypatch.context() as patched:
        patched.setattr("threading.Thread.start", refuse)
        with pytest.raises(OpenFailed, match="can't start new thread"):
            j2a_transports.open("usb://", transfers=transfers)
    assert opened_and_closed(bus.devices[0])


def test_a_device_file_and_a_link_to_one(
    bus: FakeBackend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus.devices += [board(), board(address=5, serial="B2")]
    link = tmp_path / "left arm"
    link.touch()
    real = {str(link): "/dev/bus/usb/001/005"}
    monkeypatch.setattr(os.path, "realpath", lambda path: real.get(path, path))
    assert talks(bus.devices[1], f"usb://{link}")
    assert talks(bus.devices[1], f"usb://{str(link).replace(' ', '%20')}")
    with pytest.raises(BadUrl, match="no USB device file and no link to one"):
        j2a_transports.open("usb:///dev/null")
    with pytest.raises(OpenFailed, match="there is no /dev/j2a/gone; is the board plugged in"):
        j2a_transports.open("usb:///dev/j2a/gone")


def test_an_interface_of_ones_own(bus: FakeBackend) -> None:
    ends = [endpoint(0x83, 3), endpoint(0x04), endpoint(0x85), endpoint(0x81, 3)]
    bus.devices.append(FakeDevice([interface(2, (0xFF, 0, 0), ends), SYNC]))
    with pytest.raises(OpenFailed, match="no J2A board"):
        j2a_transports.open("usb://")
    with j2a_transports.open("usb://6666:cafe?interface=2") as near:
        # Bulk endpoints come before interrupt ones.
        far = bus.devices[0].end(0x04, 0x85)
        near.write(b"there")
        assert far.read(1) == b"there"
        far.write(b"back")
        assert near.read(1) == b"back"
    with pytest.raises(OpenFailed, match="no device on the USB has an interface 1 "):
        j2a_transports.open("usb://6666:cafe?interface=1")


@pytest.mark.parametrize("url", ["usb:", "usb://", "usb://?wait=0.3"])
def test_a_device_that_nobody_named_keeps_its_driver(bus: FakeBackend, url: str) -> None:
    stick = FakeDevice([interface(0, (8, 6, 0x50))], serial="STICK", drivers={0})
    bus.devices.append(stick)
    with pytest.raises(BadUrl, match=r"of which device, .* usb://6666:cafe\?interface=0"):
        j2a_transports.open(url, interface=0)
    with pytest.raises(OpenFailed, match="no J2A board"):
        j2a_transports.open(url)
    assert stick.calls == []
    # Whoever names it gets it.
    assert talks(stick, "usb://STICK?interface=0")
    assert stick.drivers == {0}


def test_another_interface_than_asked_for_is_not_taken() -> None:
    device = usb.core.find(backend=FakeBackend(board()))
    with pytest.raises(OpenFailed, match="no interface 1 with an endpoint in each direction"):
        j2a_transports.open_usb_device(device, 1)


def test_waiting_for_a_board(bus: FakeBackend, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: bus.devices.append(board()))
    with j2a_transports.open("usb://A1?wait=5") as near:
        near.write(b"?")
        assert bus.devices[0].end().read(1) == b"?"


def test_a_board_that_does_not_come_ends_the_wait(bus: FakeBackend) -> None:
    with pytest.raises(OpenFailed, match="no J2A board"):
        j2a_transports.open("usb://A1?wait=0.01")


def test_without_pyusb_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "usb.backend", None)
    with pytest.raises(MissingExtra, match=r"pip install pyusb .*j2a\[usb\]"):
        j2a_transports.open("usb://")
    with pytest.raises(MissingExtra, match=r"pip install pyusb .*j2a\[usb\]"):
        usb_boards()


def test_without_libusb_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda find_library=None: None)
    with pytest.raises(OpenFailed, match=r"libusb-1\.0-0"):
        j2a_transports.open("usb://")
    real = builtins.__import__

    def no_package(name: str, *rest: Any) -> Any:
        if name == "libusb_package":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", no_package)
    with pytest.raises(OpenFailed, match=r"libusb-1\.0-0"):
        j2a_transports.open("usb://")


def test_strings_and_rights_come_from_linux_without_opening(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = board(denied=True)
    (tmp_path / "1-2.3").mkdir()
    for name, text in (("manufacturer", "Me"), ("product", "Arm"), ("serial", "S9")):
        (tmp_path / "1-2.3" / name).write_text(f"{text}\n")
    file = tmp_path / "001" / "004"
    file.parent.mkdir()
    file.touch()
    monkeypatch.setattr(find, "is_libusb", lambda backend: True)
    monkeypatch.setattr(find, "SYSFS", tmp_path)
    monkeypatch.setattr(find, "DEVICE_FILES", tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != file)
    (found,) = usb_boards(FakeBackend(device))
    assert (found.manufacturer, found.name, found.serial) == ("Me", "Arm", "S9")
    assert found.device_file == str(file)
    assert found.problem == find.UDEV_ADVICE
    assert device.calls == []
