"""`j2a list`, with ports as pyserial and USB boards as the transports report them."""

import json
import sys
from contextlib import nullcontext
from dataclasses import replace

import pytest
from j2a_transports import MissingExtra, OpenFailed, UsbArrived, UsbBoard, UsbLeft
from serial.tools.list_ports_common import ListPortInfo

from j2a.cli._boards import BOARDS, board_name
from j2a.cli._list import port_url, stable_names

BOARD = UsbBoard(
    url="usb://0001",
    vendor=0x6666,
    product=0xCAFE,
    manufacturer="J2A",
    name="demo",
    serial="0001",
    bus=1,
    address=4,
    port_path="1-2.3",
    speed=12.0,
    interface=0,
    device_file="/dev/bus/usb/001/004",
    sync=True,
    problem=None,
)


@pytest.fixture(autouse=True)
def boards(monkeypatch):
    """The boards on the USB; a list to fill."""
    found = []
    monkeypatch.setattr("j2a.cli._list.usb_boards", lambda: found)
    return found


@pytest.fixture
def ports(monkeypatch):
    """What pyserial finds; a list to fill."""
    found = []
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    return found


def usb_port(device, vid, pid, **facts):
    port = ListPortInfo(device)
    port.vid, port.pid = vid, pid
    for name, value in facts.items():
        setattr(port, name, value)
    return port


def test_no_ports(run, ports):
    result = run("list")
    assert (result.code, ports) == (0, [])
    assert "is it plugged in" in result.out
    assert json.loads(run("list", "--json").out) == []


def test_ports_and_boards(run, ports, tmp_path, monkeypatch):
    device = tmp_path / "ttyACM0"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-Arduino_Uno_7543").symlink_to(device)
    monkeypatch.setattr("j2a.cli._list._BY_ID", by_id)
    ports.append(
        usb_port(
            str(device),
            0x2341,
            0x0043,
            description="ttyACM0",
            serial_number="7543",
            manufacturer="A",
        )
    )
    ports.append(ListPortInfo("/dev/ttyS0"))
    found = {port["device"]: port for port in json.loads(run("list", "--json").out)}
    assert found["/dev/ttyS0"]["url"] == "serial:///dev/ttyS0"
    assert found["/dev/ttyS0"]["board"] is found["/dev/ttyS0"]["usb_id"] is None
    assert found[str(device)] == {
        "kind": "serial",
        "url": f"serial://{device}",
        "device": str(device),
        "board": "Arduino Uno R3",
        "description": "ttyACM0",
        "manufacturer": "A",
        "usb_id": "2341:0043",
        "vid": 0x2341,
        "pid": 0x43,
        "serial_number": "7543",
        "stable": str(by_id / "usb-Arduino_Uno_7543"),
    }
    out = run("list").out
    assert f"serial://{device}\n  board          Arduino Uno R3\n" in out
    assert "  serial number  7543\n" in out
    assert "usb-Arduino_Uno_7543" in out


def test_usb_boards(run, ports, boards):
    boards.append(BOARD)
    ports.append(ListPortInfo("/dev/ttyS0"))
    result = run("list")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines() == [
        "usb://0001",
        "  name           demo",
        "  manufacturer   J2A",
        "  usb id         6666:CAFE",
        "  serial number  0001",
        "  bus            001:004",
        "  port path      1-2.3",
        "  speed          12 Mbit/s",
        "  device         /dev/bus/usb/001/004",
        "  SyncUSB        yes",
        "serial:///dev/ttyS0",
    ]
    usb, serial = json.loads(run("list", "--json").out)
    assert (usb["kind"], usb["url"], usb["speed"]) == ("usb", "usb://0001", 12)
    assert (serial["kind"], serial["url"]) == ("serial", "serial:///dev/ttyS0")


def test_the_link_of_a_board_is_shown(run, ports, boards, tmp_path, monkeypatch):
    """Udev writes some characters of a serial number in another way, so the link is looked up."""
    device = tmp_path / "004"
    device.touch()
    links = tmp_path / "j2a"
    links.mkdir()
    (links / "left_arm").symlink_to(device)
    monkeypatch.setattr("j2a.cli._list._BY_SERIAL", links)
    boards += [replace(BOARD, serial="left arm", device_file=str(device)), BOARD]
    assert f"  stable         {links / 'left_arm'}\n" in run("list").out
    found = json.loads(run("list", "--json").out)
    assert [facts["stable"] for facts in found] == [str(links / "left_arm"), None]


def test_a_board_that_may_not_be_opened(run, ports, boards):
    boards.append(replace(BOARD, serial=None, url="usb://1-2.3", problem="not allowed: ..."))
    out = run("list").out
    assert "  problem        not allowed: ...\n" in out
    assert "serial number" not in out


def test_boards_that_come_and_go(run, monkeypatch):
    def watch():
        return nullcontext(iter([UsbArrived(BOARD), UsbLeft(BOARD)]))

    monkeypatch.setattr("j2a.cli._list.watch_usb", watch)
    result = run("list", "--watch")
    assert result.err == "waiting for USB boards; Ctrl-C ends\n"
    lines = result.out.splitlines()
    assert (lines[0], lines[1], lines[-1]) == (
        "+ usb://0001",
        "  name           demo",
        "- usb://0001",
    )
    events = [json.loads(line) for line in run("list", "--watch", "--json").out.splitlines()]
    assert [event["event"] for event in events] == ["arrived", "left"]
    assert {event["serial_number"] for event in events} == {"0001"}


def refuse(error):
    def function():
        raise error

    return function


def test_what_needs_a_missing_package_is_left_out(run, ports, monkeypatch):
    ports.append(ListPortInfo("/dev/ttyS0"))
    missing = refuse(MissingExtra("usb:", "pyusb libusb-package", "usb"))
    monkeypatch.setattr("j2a.cli._list.usb_boards", missing)
    monkeypatch.setattr("j2a.cli._list.watch_usb", missing)
    result = run("list")
    assert (result.code, result.out) == (0, "serial:///dev/ttyS0\n")
    assert (
        "left out: usb: a Python package is missing: pip install pyusb libusb-package"
        " (the extra j2a[usb])" in result.err
    )
    assert json.loads(run("list", "--json").out)[0]["kind"] == "serial"
    assert run("list", "--watch").code == 2


def test_without_libusb_there_are_still_the_ports(run, ports, monkeypatch):
    ports.append(ListPortInfo("/dev/ttyS0"))
    monkeypatch.setattr("j2a.cli._list.usb_boards", refuse(OpenFailed("no libusb")))
    result = run("list")
    assert (result.code, result.out) == (0, "serial:///dev/ttyS0\n")
    assert "no libusb" in result.err


def test_without_pyserial(run, boards, monkeypatch):
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    boards.append(BOARD)
    result = run("list")
    assert (result.code, result.out.splitlines()[0]) == (0, "usb://0001")
    assert "serial ports: a Python package is missing: pip install pyserial (the" in result.err


def test_without_both_packages(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    missing = refuse(MissingExtra("usb:", "pyusb libusb-package", "usb"))
    monkeypatch.setattr("j2a.cli._list.usb_boards", missing)
    result = run("list")
    assert (result.code, result.out) == (2, "")
    assert "j2a[usb]" in result.err
    assert "j2a[serial]" in result.err


def test_board_names():
    assert board_name(0x2341, 0x0043) == "Arduino Uno R3"
    assert board_name(0x2341, 0xFFFF) == "Arduino"
    assert board_name(0x1A86, 0x7523) == "WCH CH340 bridge"
    assert board_name(0x10C4, 0xEA60) == "Silicon Labs CP210x bridge"
    assert board_name(0xFFFF, 0x0001) is None
    assert board_name(None, None) is None
    assert all(0 < vid <= 0xFFFF for vid, _ in BOARDS)


def test_urls_and_links(tmp_path):
    assert port_url("/dev/ttyUSB0") == "serial:///dev/ttyUSB0"
    assert port_url("COM3") == "serial:COM3"
    assert stable_names(tmp_path / "missing") == {}
