"""The USB/IP server, with a client that is not a kernel."""

import contextlib
import errno
import io
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import pytest
from j2a_sim import FirmwareStopped, SimError, run_usbip

from firmware.sim.tests.usbip_client import RET_SUBMIT, RET_UNLINK, ZERO_PACKET, Client, Served
from transports.tests.guest.attach import Refused  # noqa: TID251 - not installed

pytestmark = pytest.mark.avr

WAIT_S = 60
HALT, HOLD, DETACH, STOP, KEEP, BURST = range(1, 7)
NODEV, BUSY = 4, 2
DEVICE_DESCRIPTOR = (0x80, 6, 0x0100, 0)


@pytest.fixture
def client(served):
    with served.attach() as client:
        yield client


def request(port, data, most=4096):
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.settimeout(WAIT_S)
        connection.sendall(data)
        got = b""
        while chunk := connection.recv(most):
            got += chunk
        return got


def test_list(usb_board):
    with Served(usb_board(), usb_board(SERIAL=ord("B"))) as served:
        ask = struct.pack(">HHI", 0x0111, 0x8005, 0)
        got = request(served.port, ask)
        assert struct.unpack(">HHII", got[:12]) == (0x0111, 5, 0, 2)
        assert len(got) == 12 + 2 * (312 + 2 * 4)
        first = got[12:]
        assert first[256:288] == b"1-1".ljust(32, b"\0")
        assert struct.unpack(">IIIHHH", first[288:306]) == (1, 1, 2, 0x6666, 0xCAFE, 0x1234)
        assert first[306:312] == bytes([0, 0, 0, 1, 1, 2])
        assert first[312:320] == bytes([0xFF, 0x12, 0xEF, 0, 0xFF, 0x34, 0x01, 0])
        with served.attach("1-1"):
            got = request(served.port, ask)
            assert struct.unpack(">I", got[8:12]) == (1,)
            assert got[12 + 256 : 12 + 288].rstrip(b"\0") == b"1-2"


def test_what_cannot_be_imported(served):
    for busid in ("1-2", "", "\x01" * 32):
        with pytest.raises(Refused) as caught:
            Client(served.port, busid)
        assert caught.value.args == (NODEV,)
    with served.attach(), pytest.raises(Refused) as caught:
        Client(served.port)
    assert caught.value.args == (BUSY,)


def test_enumeration_as_a_kernel_does_it(client):
    status, data = client.control(*DEVICE_DESCRIPTOR, 64)
    assert (status, len(data), data[8:12].hex()) == (0, 18, "6666feca")
    assert client.control(0x00, 5, 77) == (0, 0)  # SET_ADDRESS, which vhci keeps to itself
    assert client.control(*DEVICE_DESCRIPTOR, 18) == (0, data)
    status, configuration = client.control(0x80, 6, 0x0200, 0, 255)
    assert (status, len(configuration)) == (0, 48)
    status, serial = client.control(0x80, 6, 0x0303, 0x0409, 255)
    assert serial[2:].decode("utf-16-le") == "SNA"
    assert client.control(0x00, 9, 1) == (0, 0)
    assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")


@pytest.mark.parametrize("size", [1, 63, 64, 65, 250])
def test_bulk_echo(client, size):
    data = bytes(i & 0xFF for i in range(size))
    for _ in range(3):
        assert client.transfer(2, data, flags=ZERO_PACKET) == (0, size)
        assert client.transfer(1, 512) == (0, data)


def test_control_data_to_the_board(client):
    assert client.control(0x40, KEEP, 0, 0, b"0123456789") == (0, 10)
    assert client.control(0xC0, KEEP, 0, 0, 16) == (0, b"0123456789" + bytes(6))


def test_interrupt_transfer(client):
    assert client.transfer(3, b"sync packe") == (0, 10)


def test_a_stall_and_what_ends_it(client):
    assert client.control(0xC0, 99, 0, 0, 8) == (-errno.EPIPE, b"")
    assert client.transfer(2, b"x") == (0, 1)
    assert client.transfer(1, 64) == (0, b"x")
    assert client.control(0x40, HALT, 0x81) == (0, 0)
    assert client.transfer(1, 64) == (-errno.EPIPE, b"")
    assert client.control(0x02, 1, 0, 0x81) == (0, 0)
    assert client.transfer(2, b"y") == (0, 1)
    assert client.transfer(1, 64) == (0, b"y")


@pytest.mark.parametrize("setup", [(0x00, 9, 1, 0), (0x01, 11, 0, 0)])
def test_toggles_follow_the_configuration(client, setup):
    """One packet each way, so that the next would have the wrong toggle."""
    for _ in range(2):
        assert client.transfer(2, b"x") == (0, 1)
        assert client.transfer(1, 64) == (0, b"x")
        if setup[1] == 11:  # the firmware keeps its toggles, so both are halted and freed
            for endpoint in (0x81, 0x02):
                assert client.control(0x02, 1, 0, endpoint) == (0, 0)
        assert client.control(*setup) == (0, 0)


def test_other_failures(client):
    assert client.transfer(9, b"x") == (-errno.EPROTO, 0)
    assert client.transfer(2, b"x" * 64) == (0, 64)
    assert client.transfer(1, 10)[0] == -errno.EOVERFLOW
    client.socket.sendall(
        struct.pack(">5I I4i 8s", 1, 500, client.devid, 1, 4, 0, 0, 0, 2, 0, bytes(8)) + bytes(32)
    )
    client._sent[500] = 1
    assert client.result() == (RET_SUBMIT, 500, -errno.EINVAL, b"")
    # A control transfer whose length is not that of its setup packet.
    setup = struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 18)
    assert client.transfer(0, 17, setup) == (-errno.EINVAL, b"")
    assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")


def test_unlink(client):
    reading = client.submit(1, 64)
    unlink = client.unlink(reading)
    assert client.result() == (RET_UNLINK, unlink, -errno.ECONNRESET)
    assert client.transfer(2, b"x") == (0, 1)
    done = client.submit(1, 64)
    assert client.result() == (RET_SUBMIT, done, 0, b"x")
    unlink = client.unlink(done)
    assert client.result() == (RET_UNLINK, unlink, 0)


def test_unlink_loses_no_byte(client):
    """What a transfer has brought when it is taken back is delivered."""
    reading = client.submit(1, 640)
    writing = client.submit(2, bytes(64))
    assert client.result() == (RET_SUBMIT, writing, 0, 64)
    assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")
    unlink = client.unlink(reading)
    assert client.result() == (RET_SUBMIT, reading, 0, bytes(64))
    assert client.result() == (RET_UNLINK, unlink, 0)


def test_many_transfers_under_way(client):
    reads = [client.submit(1, 64) for _ in range(50)]
    writes = [client.submit(2, bytes([i])) for i in range(50)]
    results = [client.result() for _ in range(100)]
    assert [r[3] for r in results if r[1] in reads] == [bytes([i]) for i in range(50)]
    assert sorted(r[1] for r in results) == reads + writes


def test_the_port_was_reset(client):
    """The kernel tells nothing of it, but then asks for the descriptor as after every reset."""
    assert client.control(0x40, HOLD, 1) == (0, 0)
    assert client.control(*DEVICE_DESCRIPTOR, 64)[0] == 0
    assert client.control(0x00, 9, 1) == (0, 0)
    assert client.transfer(2, b"x") == (0, 1)
    assert client.transfer(1, 64) == (0, b"x")


def test_a_client_that_goes_can_come_back(served):
    for _ in range(3):
        with served.attach() as client:
            client.submit(1, 64)
            writing = client.submit(2, b"x")
            assert sorted(client.result()[:3] for _ in range(2)) == [
                (RET_SUBMIT, writing - 1, 0),
                (RET_SUBMIT, writing, 0),
            ]


def test_unplugged_and_plugged_by_the_server(served):
    with served.attach() as client:
        reading = client.submit(1, 64)
        assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")
        served.server.unplug("1-1")
        assert client.result() == (RET_SUBMIT, reading, -errno.ENODEV, b"")
        with pytest.raises(ConnectionError):
            client.result()
    with pytest.raises(Refused) as caught:
        Client(served.port)
    assert caught.value.args == (NODEV,)
    served.server.plug("1-1")
    with served.attach() as client:
        assert client.transfer(2, b"x") == (0, 1)
    with pytest.raises(SimError, match="no board '1-9'; there are 1-1"):
        served.server.plug("1-9")


def test_a_board_that_detaches_itself(client):
    assert client.control(0x40, DETACH) == (0, 0)
    with pytest.raises(ConnectionError):
        client.result()


def test_a_firmware_that_stops_ends_the_server(usb_board):
    served = Served(usb_board())
    with served.attach() as client, contextlib.suppress(ConnectionError):
        client.control(0x40, STOP)
        client.result()
    served.join()
    assert isinstance(served.error, FirmwareStopped)


def test_two_boards(usb_board):
    with (
        Served(usb_board(), usb_board(SERIAL=ord("B"))) as served,
        served.attach("1-1") as held,
        served.attach("1-2") as other,
    ):
        assert held.control(0x40, HOLD, 1) == (0, 0)
        held.submit(2, bytes(640))
        for i in range(50):
            assert other.transfer(2, bytes([i])) == (0, 1)
            assert other.transfer(1, 64) == (0, bytes([i]))
        assert held.control(0x40, HOLD, 0) == (0, 0)


def test_real_time_is_not_faster_than_the_clock(usb_board):
    sim = usb_board()
    with Served(sim, speed=1.0) as served, served.attach() as client:
        assert client.transfer(2, b"x") == (0, 1)
        began_s, began_simulated_s = time.monotonic(), sim.time_s
        time.sleep(0.2)
        # A slice may be under way.
        assert sim.time_s - began_simulated_s < time.monotonic() - began_s + 0.01


def test_the_function(firmware):
    out, err, stop = io.StringIO(), io.StringIO(), threading.Event()
    elf = firmware("usb_board", "atmega32u4")
    thread = threading.Thread(
        target=run_usbip,
        args=([elf, elf], ("127.0.0.1", 0), 0.0),
        kwargs={"stop": stop, "out": out, "err": err},
    )
    thread.start()
    end = time.monotonic() + WAIT_S
    while "detach" not in out.getvalue():
        assert time.monotonic() < end
        time.sleep(0.01)
    lines = out.getvalue().splitlines()
    port = int(lines[0].rpartition(":")[2])
    assert lines[:2] == [f"exporting 1-{n} at 127.0.0.1:{port}" for n in (1, 2)]
    assert f"usbip --tcp-port {port} attach -r 127.0.0.1 -b 1-1" in out.getvalue()
    with Client(port, "1-2") as client:
        assert client.transfer(2, b"x") == (0, 1)
    stop.set()
    thread.join(WAIT_S)
    assert not thread.is_alive()
    figures = [dict(re.findall(r"(\w+)=([\w.-]+)", line)) for line in err.getvalue().splitlines()]
    boards = [f for f in figures if "busid" in f]
    assert [f["busid"] for f in boards] == ["1-1", "1-2"]
    assert int(boards[1]["bytes_out"]) >= 1
    assert all(int(f["cycles"]) > 0 and f["wrong_toggles"] == "0" for f in boards)


def test_the_command(firmware):
    command = [sys.executable, "-m", "j2a_sim", "usb", firmware("usb_board", "atmega32u4")]
    with subprocess.Popen(
        [*command, "--usbip", "127.0.0.1:0", "--commands"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            port = int(process.stdout.readline().rpartition(":")[2])
            with Client(port) as client:
                assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")
                assert "1-1: attached by" in process.stderr.readline()
                print("unplug 1-1", file=process.stdin, flush=True)
                with pytest.raises(ConnectionError):
                    client.result()
            said = {process.stderr.readline() for _ in range(2)}
            assert said == {"1-1: unplugged\n", "1-1: detached\n"}
            print("jump\nplug 1-1", file=process.stdin, flush=True)
            assert "'jump' is neither plug BUSID nor unplug BUSID" in process.stderr.readline()
            assert process.stderr.readline() == "1-1: plugged\n"
            process.stdin.close()
            Client(port).socket.close()
            process.send_signal(signal.SIGINT)
            assert process.wait(WAIT_S) == 128 + signal.SIGINT
            assert "figures of the run: busid=1-1 cycles=" in process.stderr.read()
        finally:
            process.kill()


@pytest.mark.parametrize("address", ["1.2.3.4:x", ":1", "[]:0", "127.0.0.1:65536"])
def test_a_bad_address(address, firmware, capsys):
    elf = firmware("usb_board", "atmega32u4")
    command = [sys.executable, "-m", "j2a_sim", "usb", elf, "--usbip", address]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert "is not HOST:PORT" in result.stderr


def test_commands_need_standard_input():
    command = [sys.executable, "-m", "j2a_sim", "usb", "none.elf", "--commands"]
    result = subprocess.run(
        ["sh", "-c", 'exec "$@" <&-', "sh", *command], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert result.stderr == "j2a sim: --commands reads standard input, and that is closed\n"
