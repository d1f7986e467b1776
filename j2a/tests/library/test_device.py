"""A device in Python: hosts that come and go, SIFs, pauses in requests, stopping."""

import contextlib
import socket
import struct
import sys
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS
from j2a_transports._loopback import Channel, LoopbackTransport
from j2a_transports._tcp import TcpTransport

import j2a
from j2a.demo import SIF_PERIODIC, DemoDevice
from j2a.device import default_max_hosts
from j2a.io import connection

from .support import PATIENCE_S, linked, served


class Host:
    """A host that speaks frame by frame."""

    def __init__(self, link: str | j2a_transports.Transport) -> None:
        self._transport = j2a_transports.open(link) if isinstance(link, str) else link
        self._data = b""

    def __enter__(self) -> "Host":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._transport.close()

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def send(self, seq: int, opcode: int, payload: bytes = b"") -> None:
        self.write(oracle.encode(oracle.Frame(SOF, seq, opcode, payload)))

    def frames(self, number: int) -> list[oracle.Frame]:
        while len(oracle.decode(self._data)) < number or isinstance(
            oracle.decode(self._data)[-1], oracle.Incomplete
        ):
            data = self._transport.read(PATIENCE_S)
            assert data, "the device does not answer"
            self._data += data
        events, self._data = oracle.decode(self._data), b""
        assert len(events) == number
        return events

    def is_silent(self, seconds: float) -> bool:
        return self._transport.read(seconds) == b""


@pytest.fixture(params=["loopback", "tcp"])
def url(request):
    where = {"loopback": None, "tcp": "tcp://127.0.0.1:0"}[request.param]
    with served(DemoDevice(), where) as url:
        yield url


def test_requests_without_waiting_are_answered_in_order(url):
    with Host(url) as host:
        host.write(
            b"".join(
                oracle.encode(oracle.Frame(SOF, seq & 0xFF, 4, struct.pack("<H", seq)))
                for seq in range(400)
            )
        )
        replies = host.frames(400)
        assert [struct.unpack("<H", reply.payload)[0] for reply in replies] == list(range(400))
        assert [reply.seq for reply in replies] == [seq & 0xFF for seq in range(400)]


def test_a_request_that_stops_is_given_up(url):
    with Host(url) as host:
        host.write(bytes((SOF, 7, 4, 5)))
        (reply,) = host.frames(1)
        assert (reply.seq, reply.opcode) == (7, 0xF2)
        host.write(b"the rest")
        host.send(8, 4, b"next")
        assert host.frames(1) == [oracle.Frame(SOF, 8, 0xBA, b"next")]


def test_a_busy_device_does_not_take_waiting_bytes_for_late_ones():
    device = DemoDevice()
    with served(device) as url, Host(url) as host:
        wire = oracle.encode(oracle.Frame(SOF, 2, 4, b"waited"))
        delay = oracle.encode(oracle.Frame(SOF, 1, device.functions["delay"], b"\x2c\x01"))
        host.write(delay + wire[:5])
        host.write(wire[5:])
        replies = host.frames(2)
        assert [(reply.seq, reply.opcode) for reply in replies] == [(1, 0), (2, 0xBA)]


def test_bytes_that_came_while_nobody_looked_are_not_late():
    class Late(LoopbackTransport):
        """Says that nothing came in time, and has the bytes all the same."""

        def read(self, timeout_s):
            if timeout_s:
                time.sleep(timeout_s + 0.005)
                while not (there._data or over.is_set()) and time.monotonic() < deadline:
                    time.sleep(0.0005)
                return b""
            return super().read(timeout_s)

    over, deadline = threading.Event(), time.monotonic() + PATIENCE_S
    there, back = Channel(), Channel()
    near, far = LoopbackTransport("near", back, there), Late("far", there, back)
    device = j2a.Device()
    wire = oracle.encode(oracle.Frame(SOF, 1, 4, b"not late"))
    server = threading.Thread(target=device.serve, args=(far,))
    near.write(wire[:4])
    server.start()
    while there._data and time.monotonic() < deadline:
        time.sleep(0.0005)
    near.write(wire[4:])
    (reply,) = oracle.decode(near.read(PATIENCE_S))
    device.stop()
    over.set()
    server.join(PATIENCE_S)
    assert reply == oracle.Frame(SOF, 1, 0xBA, b"not late")


def test_several_hosts_share_the_functions_and_have_their_own_sif_counters():
    with served(device := DemoDevice()) as url, Host(url) as first:
        first.send(0, 4)
        first.frames(1)
        assert device.send_sif(1, b"one host") == 1
        with Host(url) as second:
            second.send(0, 4)
            second.frames(1)
            assert device.send_sif(2, b"two hosts") == 2
            assert second.frames(1) == [oracle.Frame(SOS, 0, 2, b"two hosts")]
        assert [frame.seq for frame in first.frames(2)] == [0, 1]


@pytest.mark.parametrize("limit_s", [0, 0.008, 0.021, 5, float("nan"), "10 ms", None])
def test_byte_timeouts_that_cannot_be(limit_s):
    with pytest.raises(j2a.LocalError, match="byte_timeout_s"):
        j2a.Device(byte_timeout_s=limit_s)


@pytest.mark.parametrize("limit_s", [0.009, 0.01, 0.02])
def test_byte_timeouts_that_can_be(limit_s):
    j2a.Device(byte_timeout_s=limit_s)


def test_a_device_that_waits_for_hosts_lets_others_work():
    class Listener:
        url = "test:"
        waits = ()

        def accept(self, timeout_s):
            self.waits += (timeout_s,)
            if len(self.waits) == 3:
                raise j2a_transports.LinkClosed(f"{self.url} is closed")

        def close(self):
            pass

    listener = Listener()
    j2a.Device().serve_forever(listener)
    assert all(0.1 <= wait_s <= 10 for wait_s in listener.waits)


def test_a_device_that_waits_for_requests_lets_others_work():
    class Silent(j2a_transports.Transport):
        waits = ()
        closed = False

        def read(self, timeout_s):
            self.waits += (timeout_s,)
            if len(self.waits) == 6:
                raise j2a_transports.LinkLost(f"{self.url} is gone")
            return b""

        def write(self, data):
            pass

        def close(self):
            pass

    transport = Silent("silent:")
    j2a.Device().serve(transport)
    assert all(0.1 <= wait_s <= 10 for wait_s in transport.waits[::2])
    assert set(transport.waits[1::2]) == {0}  # it may have been late itself


def test_a_link_that_takes_no_sif_ends():
    class Deaf(j2a_transports.Transport):
        def __init__(self):
            super().__init__("deaf:")
            self.ended = threading.Event()

        def read(self, timeout_s):
            if self.ended.wait(timeout_s):
                raise j2a_transports.LinkClosed(f"{self.url} is closed")
            return b""

        def write(self, data):
            raise j2a_transports.WriteTimeout(f"{self.url} takes nothing")

        @property
        def closed(self):
            return self.ended.is_set()

        def close(self):
            self.ended.set()

    device, transport = j2a.Device(), Deaf()
    server = threading.Thread(target=device.serve, args=(transport,), daemon=True)
    server.start()
    end = time.monotonic() + PATIENCE_S
    while not device.send_sif(1) and time.monotonic() < end:
        time.sleep(0.001)
    assert transport.ended.wait(PATIENCE_S)
    server.join(PATIENCE_S)
    assert not server.is_alive()


def test_a_host_whose_call_goes_on_ends_with_the_device():
    device, began, goes_on = j2a.Device(), threading.Event(), threading.Event()
    before = set(threading.enumerate())

    @device.function
    def long(payload):
        began.set()
        goes_on.wait(PATIENCE_S)

    with served(device, "tcp://127.0.0.1:0") as url, Host(url) as host:
        host.send(1, device.functions["long"])
        assert began.wait(PATIENCE_S)
        new = set(threading.enumerate()) - before
        [serving] = [thread for thread in new if thread.name.startswith("j2a device tcp")]
        device.stop()
        goes_on.set()
        serving.join(PATIENCE_S)
        assert not serving.is_alive()


def test_a_sif_without_a_host_goes_nowhere_and_says_so():
    assert DemoDevice().send_sif(1, b"x") == 0


@pytest.mark.parametrize(
    "misuse",
    [
        lambda device: device.send_sif(256),
        lambda device: device.send_sif("x"),
        lambda device: device.send_sif(1, bytes(256)),
        lambda device: device.send_sif(1, "text"),
    ],
)
def test_sifs_that_cannot_be(misuse):
    with pytest.raises(j2a.LocalError):
        misuse(DemoDevice())


def test_a_sif_from_inside_a_function_comes_before_its_reply(url):
    with Host(url) as host:
        sif = DemoDevice().functions["sif"]
        host.send(3, sif, b"\xf2payload")
        assert host.frames(2) == [
            oracle.Frame(SOS, 0, 0xF2, b"payload"),
            oracle.Frame(SOF, 3, 0, b""),
        ]


def test_sifs_from_many_threads_are_whole_and_numbered_in_order():
    with served(device := DemoDevice()) as url, Host(url) as host:
        host.send(0, 4)
        host.frames(1)
        threads = [
            threading.Thread(
                target=lambda n=n: [device.send_sif(n, bytes((SOF, n)) * 50) for _ in range(50)]
            )
            for n in range(4)
        ]
        for thread in threads:
            thread.start()
        frames = host.frames(200)
        for thread in threads:
            thread.join(PATIENCE_S)
        assert [frame.seq for frame in frames] == list(range(200))
        assert all(frame.payload == bytes((SOF, frame.opcode)) * 50 for frame in frames)


def test_no_periodic_sif_follows_the_reply_that_ends_them():
    """Also when the request comes while one is on its way out."""
    begun, goes_on = threading.Event(), threading.Event()

    class Slow(DemoDevice):
        def send(self, *args, **kwargs):
            begun.set()
            assert goes_on.wait(PATIENCE_S)
            return super().send(*args, **kwargs)

    with served(device := Slow()) as url, Host(url) as host:
        period = device.functions["sifPeriod"]
        host.send(0, period, b"\x01\x00")
        assert host.frames(1) == [oracle.Frame(SOF, 0, 0, b"")]
        assert begun.wait(PATIENCE_S)
        host.send(1, period, b"\x00\x00")
        assert host.is_silent(0.1)
        goes_on.set()
        assert host.frames(2) == [
            oracle.Frame(SOS, 0, SIF_PERIODIC, bytes(4)),
            oracle.Frame(SOF, 1, 0, b""),
        ]


def narrow(url: str) -> j2a_transports.Transport:
    """Connect with a receive buffer that is full after a few frames."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    sock.connect(("127.0.0.1", int(url.rpartition(":")[2])))
    return TcpTransport(url, sock, None)


def test_a_host_that_does_not_read_delays_nobody():
    """It loses SIFs, which it can see; the others get all of theirs, and their replies."""
    device = DemoDevice()
    with (
        served(device, "tcp://127.0.0.1:0") as url,
        Host(narrow(url)) as stuck,
        Host(url) as host,
    ):
        for one in (stuck, host):
            one.send(0, 4)
            one.frames(1)
        count, goes_to = 0, 2
        while goes_to == 2:  # until no more can wait for the one that is stuck
            goes_to = device.send_sif(count % 251, bytes(255))
            count += 1
            sifs = host.frames(1)
            assert (sifs[0].seq, sifs[0].opcode) == ((count - 1) & 0xFF, (count - 1) % 251)
            assert count < 1_000_000
        host.send(1, 4, b"reply")
        assert host.frames(1)[0].payload == b"reply"


class AtOnce(LoopbackTransport):
    """Takes at once what has room; has a time of its own."""

    now = 0.0

    def clock(self):
        return self.now

    def try_write(self, data):
        return self._outgoing.put(memoryview(data), 0)


@pytest.mark.parametrize("kind", [LoopbackTransport, AtOnce])
def test_a_sif_that_is_lost_leaves_a_gap(kind):
    near = kind("near", Channel(), Channel(limit=100), write_timeout_s=None)
    far = LoopbackTransport("far", near._outgoing, near._incoming)
    device = j2a.Device()
    server = threading.Thread(target=device.serve, args=(near,))
    server.start()
    while not device.send_sif(1, b""):  # not yet connected
        time.sleep(0.001)
    # Which ones find no room depends on when the writer takes what waits.
    sent = [0, *[n for n in range(1, 3001) if device.send_sif(1, bytes(250))]]
    assert 1000 < len(sent) < 3001
    frames = [oracle.Frame(SOS, n & 0xFF, 1, bytes(250) if n else b"") for n in sent]
    due = b"".join(map(oracle.encode, frames))
    data = b""
    while len(data) < len(due) and (piece := far.read(PATIENCE_S)):
        data += piece
    assert oracle.decode(data) == frames
    assert device.send_sif(2, b"") == 1
    assert oracle.decode(far.read(PATIENCE_S)) == [oracle.Frame(SOS, 3001 & 0xFF, 2, b"")]
    device.stop()
    server.join(PATIENCE_S)


@pytest.mark.parametrize(("size", "later_s"), [(200, 1.0), (10, 0.0)])
def test_a_sif_that_the_link_takes_at_once_needs_no_thread(size, later_s):
    """One that it does not, or that comes right behind another, does."""
    device, has_thread = j2a.Device(), []
    sifs = ((20, 1.0), (30, 1.0), (size, later_s))
    earlier = set(threading.enumerate())  # those of other tests may not have ended yet

    @device.function
    def tell(_payload):
        for length, seconds in sifs:
            near.now += seconds
            device.send_sif(1, bytes(length))
            threads = set(threading.enumerate()) - earlier
            has_thread.append(any(one.name == "j2a SIFs near" for one in threads))

    near = AtOnce("near", Channel(), Channel(limit=100))
    far = LoopbackTransport("far", near._outgoing, near._incoming)
    server = threading.Thread(target=device.serve, args=(near,))
    server.start()
    far.write(oracle.encode(oracle.Frame(SOF, 7, device.functions["tell"], b"")))
    due = [oracle.Frame(SOS, n, 1, bytes(length)) for n, (length, _) in enumerate(sifs)]
    due.append(oracle.Frame(SOF, 7, 0, b""))
    data = b""
    while len(data) < sum(len(oracle.encode(frame)) for frame in due):
        data += far.read(PATIENCE_S)
    device.stop()
    server.join(PATIENCE_S)
    assert oracle.decode(data) == due
    assert has_thread == [False, False, True]


class InParts(AtOnce):
    """Takes at once all but some of the bytes."""

    leaves = 0

    def try_write(self, data):
        self.now += 1.0  # no SIF comes right behind another
        return super().try_write(data[: max(0, len(data) - self.leaves)])


@contextlib.contextmanager
def in_parts(monkeypatch, device, kind=InParts):
    """Serve a device whose thread writes only what it must, at both ends of such a link."""
    monkeypatch.setattr(connection, "WAIT_S", 2 * PATIENCE_S)
    near = kind("near", Channel(), Channel())
    far = LoopbackTransport("far", near._outgoing, near._incoming)
    server = threading.Thread(target=device.serve, args=(near,))
    server.start()
    far.write(oracle.encode(oracle.Frame(SOF, 1, 0, b"")))
    assert far.read(PATIENCE_S)
    try:
        yield near, far
    finally:
        device.stop()
        server.join(PATIENCE_S)


def read_sifs(far, first, count):
    """Read SIFs of this opcode, whose payload is their number."""
    due = [oracle.Frame(SOS, n, 1, bytes((n,))) for n in range(first, first + count)]
    data = b""
    while len(data) < sum(len(oracle.encode(frame)) for frame in due):
        data += far.read(PATIENCE_S) or pytest.fail(f"only {oracle.decode(data)} came")
    assert oracle.decode(data) == due


@pytest.mark.parametrize("leaves", [1, 2, 5, 100])
def test_what_the_link_does_not_take_at_once_follows(monkeypatch, leaves):
    """Each time, and without another SIF or a request behind it."""
    device = j2a.Device()
    with in_parts(monkeypatch, device) as (near, far):
        near.leaves = leaves
        for number in range(4):
            device.send_sif(1, bytes((number,)))
            read_sifs(far, number, 1)


@pytest.mark.parametrize("leaves", [1, 2, 5, 100])
@pytest.mark.parametrize("is_asked", [True, False])
def test_sifs_behind_what_waits_stay_behind_it(monkeypatch, leaves, is_asked):
    """Also if the system has no thread to give, so that a reply or the end writes them."""

    def refuse(*_):
        raise j2a.LinkError("no thread")

    device = j2a.Device()
    with in_parts(monkeypatch, device) as (near, far):
        monkeypatch.setattr(connection, "start_thread", refuse)
        near.leaves = leaves
        device.send_sif(1, b"\0")
        near.leaves = 0
        for number in range(1, 4):
            device.send_sif(1, bytes((number,)))
        if is_asked:
            far.write(oracle.encode(oracle.Frame(SOF, 2, 0, b"")))
        else:
            device.stop()
        data = b""
        with contextlib.suppress(j2a_transports.LinkLost):
            while data.count(SOF if is_asked else SOS) < (1 if is_asked else 4):
                data += far.read(PATIENCE_S) or pytest.fail(f"only {data} came")
        sifs = [one for one in oracle.decode(data) if one.start == SOS]
        assert sifs == [oracle.Frame(SOS, n, 1, bytes((n,))) for n in range(4)]


def test_a_sif_while_another_is_being_written_follows(monkeypatch):
    class Meanwhile(InParts):
        leaves = 0

        def write(self, data):
            super().write(data)
            if self.leaves:
                self.leaves = 0
                device.send_sif(1, b"\1")

    device = j2a.Device()
    with in_parts(monkeypatch, device, Meanwhile) as (near, far):
        near.leaves = 100
        device.send_sif(1, b"\0")
        read_sifs(far, 0, 2)


def test_sifs_reach_the_host_before_the_device_stops():
    for _ in range(20):
        device = j2a.Device()
        with served(device, "tcp://127.0.0.1:0") as url, Host(url) as host:
            host.send(0, 4)
            host.frames(1)
            for number in range(50):
                device.send_sif(number)
            device.stop()
            assert [frame.opcode for frame in host.frames(50)] == list(range(50))


def is_refused(host):
    try:
        host.is_silent(PATIENCE_S)
    except j2a_transports.LinkLost:
        return True
    return False


def ask(host):
    host.send(7, 4, b"there")
    assert host.frames(1)[0].payload == b"there"


def test_too_many_hosts_are_refused():
    with contextlib.ExitStack() as stack:
        url = stack.enter_context(served(DemoDevice(), "tcp://127.0.0.1:0", max_hosts=3))
        hosts = [stack.enter_context(Host(url)) for _ in range(3)]
        for host in hosts:
            ask(host)
        for _ in range(3):
            assert is_refused(stack.enter_context(Host(url)))
        for host in hosts:
            ask(host)
        hosts[1].__exit__()
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            late = stack.enter_context(Host(url))
            with contextlib.suppress(j2a_transports.LinkLost):  # the place is not yet free
                ask(late)
                break
        ask(late)


def test_a_host_that_never_asked_makes_room_at_once():
    with contextlib.ExitStack() as stack:
        url = stack.enter_context(served(DemoDevice(), "tcp://127.0.0.1:0", max_hosts=4))
        asked = stack.enter_context(Host(url))
        ask(asked)
        idle = [stack.enter_context(Host(url)) for _ in range(40)]
        late = stack.enter_context(Host(url))
        ask(late)
        ask(asked)
        assert all(is_refused(host) for host in idle[:-3])


def test_a_host_that_was_silent_for_long_makes_room():
    with contextlib.ExitStack() as stack:
        url = stack.enter_context(
            served(DemoDevice(), "tcp://127.0.0.1:0", max_hosts=2, idle_s=0.0)
        )
        first, second, third = (stack.enter_context(Host(url)) for _ in range(3))
        # The third took the place of one that never asked.
        ask(second)
        ask(third)
        assert is_refused(first)
        ask(stack.enter_context(Host(url)))
        assert is_refused(second)
        ask(third)


@pytest.mark.parametrize("limits", [{"max_hosts": 0}, {"max_hosts": "2"}, {"idle_s": -1}])
def test_limits_that_cannot_be(limits):
    with j2a_transports.listen("loopback:limits") as listener:
        listener.close()  # so that this ends where the limits are taken
        with pytest.raises(j2a.LocalError, match=next(iter(limits))):
            j2a.Device().serve_forever(listener, **limits)


def test_the_number_of_hosts_fits_the_limit_of_files(monkeypatch):
    resource = pytest.importorskip("resource")
    for files, hosts in [(16, 1), (62, 10), (1024, 64), (resource.RLIM_INFINITY, 64)]:
        monkeypatch.setattr(resource, "getrlimit", lambda _, files=files: (files, files))
        assert default_max_hosts() == hosts


def test_the_number_of_hosts_where_the_system_does_not_limit_files(monkeypatch):
    monkeypatch.setitem(sys.modules, "resource", None)
    assert default_max_hosts() == 64


def test_a_function_may_stop_the_device():
    device = j2a.Device()

    @device.function
    def goodbye(payload):
        device.stop()

    with served(device) as url, Host(url) as host:
        host.send(1, device.functions["goodbye"])
        deadline = time.monotonic() + PATIENCE_S
        with pytest.raises(j2a_transports.TransportError):
            while time.monotonic() < deadline:
                host.is_silent(0.05)
    with pytest.raises(j2a.LocalError, match="stopped"):
        device.serve_forever(j2a_transports.listen("loopback:too late"))


def test_the_device_survives_hosts_that_vanish(url):
    for _ in range(10):
        with Host(url) as host:
            host.write(bytes((SOF, 1, 4)))
    with Host(url) as host:
        host.send(5, 4, b"alive")
        assert host.frames(1) == [oracle.Frame(SOF, 5, 0xBA, b"alive")]


class TestDemo:
    def test_time_goes_on(self):
        with linked() as client:
            (first,) = struct.unpack("<Q", client.call("getTime").payload)
            (second,) = struct.unpack("<Q", client.call("getTime").payload)
            assert first <= second < first + PATIENCE_S * 1e6

    def test_delay(self):
        with linked() as client:
            start = time.monotonic()
            assert client.call("delay", b"\x32\x00") == (0, b"")
            assert time.monotonic() - start >= 0.05

    @pytest.mark.parametrize("name", ["add", "delay", "sifPeriod", "sif", "ret"])
    def test_payloads_of_the_wrong_length(self, name):
        with linked() as client:
            assert client.call(name, b"") == (0xFF, b"")

    def test_overruns(self):
        with linked() as client:
            assert client.call("overruns") == (0, b"\0\0")

    def test_a_write_with_a_gap_is_refused(self):
        with linked() as client:
            store = client.functions["store"]

            def write(offset, data):
                payload = struct.pack("<BBL", store, 2, offset) + data
                return client.call("a2jMany", payload).payload[0]

            assert write(0, b"abc") == 0
            assert write(4, b"x") == 0xFF
            assert write(2, b"x") == 0xFF
            assert write(3, b"d") == 0
            assert client.read_many("store") == b"abcd"
            assert write(0, b"new") == 0
            assert client.read_many("store") == b"new"

    def test_a_new_period_begins_at_0(self):
        with linked() as client:
            numbers, enough = [], threading.Event()

            def count(sif):
                numbers.extend(struct.unpack("<L", sif.payload))
                if len(numbers) > 3:
                    enough.set()

            client.on_sif(0x20, count)
            client.call("sifPeriod", b"\x02\x00")
            assert enough.wait(PATIENCE_S)
            client.call("sifPeriod", b"\x03\x00")
            enough.clear()
            deadline = time.monotonic() + PATIENCE_S
            while numbers.count(0) < 2 and time.monotonic() < deadline:
                time.sleep(0.005)
            assert numbers.count(0) == 2
