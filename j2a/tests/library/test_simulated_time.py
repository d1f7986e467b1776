"""Over a transport whose time is simulated, every time limit is simulated time."""

import asyncio
import math
import os
import re
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF
from j2a_transports import faults

import j2a

from .support import PATIENCE_S
from .test_limits import SlowProperties
from .wire import Background


class SlowDevice(j2a_transports.Transport):
    """Answers each request after so many simulated seconds; time passes only in `read`."""

    is_simulated = True
    read_takes_s = 0.0005  # a simulator takes its time, too

    def __init__(self, takes_s):
        super().__init__("simulated:")
        self.takes_s = takes_s
        self.now_s = 1000.0
        self.due = []
        self._lock = threading.Lock()
        self._closed = False

    def clock(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds

    def read(self, timeout_s):
        time.sleep(self.read_takes_s)
        with self._lock:
            if self._closed:
                raise j2a_transports.LinkClosed("simulated: is closed")
            end_s = self.now_s + (0.01 if timeout_s is None else timeout_s)
            if self.due and self.due[0][0] <= end_s:
                self.now_s, data = self.due.pop(0)
                return data
            self.now_s = end_s
            return b""

    def write(self, data):
        with self._lock:
            for request in oracle.decode(bytes(data)):
                reply = oracle.encode(oracle.Frame(SOF, request.seq, 0, b"done"))
                self.due.append((self.now_s + self.takes_s, reply))

    @property
    def closed(self):
        return self._closed

    def close(self):
        self._closed = True


@pytest.mark.parametrize(("takes_s", "limit_s"), [(3.0, 1.0), (6.0, 2.0), (0.5, 0.05)])
def test_a_call_ends_after_its_limit_in_simulated_time(takes_s, limit_s):
    device = SlowDevice(takes_s)
    with j2a.Client(device) as client:
        begun_s = device.now_s
        with pytest.raises(j2a.CallTimeout):
            client.call(1, timeout=limit_s)
        assert begun_s + limit_s <= device.now_s


@pytest.mark.parametrize(("takes_s", "limit_s"), [(3.0, 9.0), (7.0, 8.0)])
def test_a_reply_within_the_limit_in_simulated_time(takes_s, limit_s):
    with j2a.Client(SlowDevice(takes_s)) as client:
        assert client.call(1, timeout=limit_s).payload == b"done"


LIMIT_S = 2.0 + 10 * 1.0  # boot_time and ten times timeout (J2A-TIME-008)


class Dripping(SlowDevice):
    """A board whose properties come byte by byte and never end, each just within its limit.

    A busy machine may halt a thread of the client anywhere, so that time stands still where the
    client has to act: while no request is there, and (nearly) where the limit is over.
    """

    read_takes_s = 0.0

    def __init__(self):
        super().__init__(0.9)
        self._device = SlowProperties()
        self._end_s = self.now_s + LIMIT_S

    def read(self, timeout_s):
        if not self.due and not self.closed:
            time.sleep(0.0005)
            return b""
        if self.now_s > self._end_s:
            time.sleep(0.3)
        return super().read(timeout_s)

    def write(self, data):
        with self._lock:
            for request in oracle.decode(bytes(data)):
                code, payload = self._device._execute(request.opcode, request.payload)
                reply = oracle.encode(oracle.Frame(SOF, request.seq, code, payload))
                is_slow = request.payload[:1] == b"\x02"  # a piece of a2jGetProperties
                self.due.append((self.now_s + (self.takes_s if is_slow else 0.0), reply))


def connect_and_close(**options):
    with j2a.connect("simulated:", **options) as client:
        return client


async def aconnect_and_close(**options):
    async with await j2a.aconnect("simulated:", **options) as client:
        return client


@pytest.mark.requirement("J2A-TIME-008")
@pytest.mark.parametrize(
    "connect",
    [connect_and_close, lambda **options: asyncio.run(aconnect_and_close(**options))],
    ids=["blocking", "asyncio"],
)
@pytest.mark.parametrize("window", [1, 8])
def test_connecting_ends_however_slowly_a_board_tells_what_it_has(monkeypatch, connect, window):
    board = Dripping()
    for module in ("client", "aio"):
        monkeypatch.setattr(f"j2a.{module}.open_transport", lambda _url, _options: board)
    begun_s, told = board.now_s, r"a2jGetProperties at .* limit of 12 s for the whole is over"
    if window == 1:
        # Its functions can be called, although it does not describe them (J2A-IFACE-009).
        client = connect(timeout=1.0, boot_time=2.0)
        assert re.match(told, client.interface_problem)
    else:
        # Several calls at once need to know how much the board holds.
        with pytest.raises(j2a.CallTimeout, match=told):
            connect(timeout=1.0, boot_time=2.0, window=window)
    assert board.now_s - begun_s <= LIMIT_S + 0.1


def test_calls_on_the_wire_together_keep_their_own_simulated_limits():
    with j2a.Client(SlowDevice(math.inf), window=2) as client:
        client._session.rxbuf = 4096
        made = [("first", 1, b"", 1.0), ("second", 1, b"", 2.0)]
        both = Background(client._engine.call_all, made)
        with pytest.raises(j2a.CallTimeout, match="first"):  # once the second has ended, too
            both.result()
        assert client._session.waiting == 0


def test_the_asyncio_client_keeps_simulated_limits_too():
    async def main():
        device = SlowDevice(3.0)
        async with j2a.AsyncClient(device) as client:
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=1.0)
            assert (await client.call(1, timeout=20.0)).payload == b"done"

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))


class SlowHost(SlowDevice):
    """Sends pieces, each so many simulated seconds after the one before, and goes."""

    def __init__(self, read_takes_s, *pieces):
        super().__init__(0)
        self.read_takes_s = read_takes_s
        self.due = [
            (self.now_s + sum(pause for pause, _ in pieces[: n + 1]), data)
            for n, (_, data) in enumerate(pieces)
        ]
        self.written = b""

    def read(self, timeout_s):
        if not self.due and timeout_s:
            raise j2a_transports.LinkLost("simulated: is lost: the host has gone")
        return super().read(timeout_s)

    def write(self, data):
        self.written += bytes(data)


@pytest.mark.requirement("J2A-TIME-001")
@pytest.mark.parametrize(
    ("pause_s", "read_takes_s", "is_answered"), [(0.005, 0.03, True), (0.025, 0.0, False)]
)
def test_a_device_judges_pauses_by_the_time_of_the_link(pause_s, read_takes_s, is_answered):
    wire = oracle.encode(oracle.Frame(SOF, 7, 0, b""))
    host = SlowHost(read_takes_s, (0.0, wire[:3]), (pause_s, wire[3:]), (0.5, b"\x00"))
    with j2a.Device() as device:
        device.serve(host)
    [reply] = oracle.decode(host.written)
    assert (reply.seq, reply.opcode == 0) == (7, is_answered)


class WithDescriptor(SlowDevice):
    """Has a descriptor, too; nothing is ever readable there."""

    def __init__(self, takes_s):
        super().__init__(takes_s)
        self._ends = os.pipe()

    def fileno(self):
        return self._ends[0]

    def wait(self, timeout_s):
        raise AssertionError("time passes in read only")

    def close(self):
        if not self._closed:
            for end in self._ends:
                os.close(end)
        super().close()


def test_a_descriptor_does_not_end_simulated_time():
    with j2a.Client(WithDescriptor(0.3)) as client:
        assert client.call(1, timeout=1.0).payload == b"done"
    with j2a.Client(WithDescriptor(3.0)) as client, pytest.raises(j2a.CallTimeout):
        client.call(1, timeout=1.0)

    async def run():
        async with j2a.AsyncClient(WithDescriptor(0.3)) as client:
            assert (await client.call(1, timeout=1.0)).payload == b"done"
        async with j2a.AsyncClient(WithDescriptor(3.0)) as client:
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=1.0)

    asyncio.run(run())


def test_behind_faults_time_is_that_of_the_link():
    device = SlowDevice(3.0)
    with j2a.Client(faults.wrap(device)) as client:
        assert client.now() == device.now_s
        with pytest.raises(j2a.CallTimeout):
            client.call(1, timeout=1.0)
        assert client.call(1, timeout=20.0).payload == b"done"

    async def main():
        device = SlowDevice(3.0)
        async with j2a.AsyncClient(faults.wrap(device)) as client:
            assert client.now() == device.now_s
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=1.0)
            assert (await client.call(1, timeout=20.0)).payload == b"done"

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))
