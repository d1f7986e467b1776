"""`j2a list`, with ports that pyserial would report."""

import json
import sys

import pytest
from serial.tools.list_ports_common import ListPortInfo

from j2a.cli._boards import BOARDS, board_name
from j2a.cli._list import port_url, stable_names


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
    assert "is the board plugged in" in result.out
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


def test_without_pyserial(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    result = run("list")
    assert (result.code, result.out) == (2, "")
    assert "pip install j2a[serial]" in result.err


def test_board_names():
    assert board_name(0x6666, 0xCAFE) == "J2A device"
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
