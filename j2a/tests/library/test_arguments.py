"""The public arguments of both clients: the same ones, their defaults, and what each limit limits.

The clients are the real ones; only their engines' calls are answered at once, in virtual time.
"""

import asyncio
import inspect
import math

import j2a_transports
import pytest

import j2a
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.io.handlers import Handlers

COST_S = 0.25
"""What each request costs; a sum of it is exact."""

DATA = bytes(1000)
CHUNKS = 5
TIMED = {
    "call": ("ret", b"\x07"),
    "echo": (b"x",),
    "read_debug": (),
    "read_many": ("store",),
    "write_many": ("store", DATA),
    "echo_many": (DATA,),
}
"""Each method that takes time limits, with other arguments; those with chunks send several."""

OF_DEVICE = ("functions", "properties", "capabilities", "room", "refresh")
DEFAULTS = {
    "payload": b"",
    "check": False,
    "definitions": "",
    "max_waiting": 4096,
    "timeout": None,
    "total_timeout": None,
    "max_bytes": 64 * 2**20,
    "progress": None,
    "boot_time": None,
    "opcodes": None,
    "handler": None,
}
"""What an argument of a method is when it is left out."""

OF_CLIENTS = {"timeout": 1.0, "window": 1, "trace": None, "on_handler_error": None}


class Virtual:
    """The blocking client of a demo device, each request of which takes `COST_S`.

    Attributes:
        now: the time, in seconds.
        limits: the time limit of each request so far, in seconds.
        is_silent: the device answers nothing any more.
    """

    def __init__(self, **options):
        self.now = 64.0
        self.limits = []
        self.is_silent = False
        self.device = DemoDevice()
        self._near, self._far = j2a_transports.pair()
        self._connect(options)
        self.client._engine.call = self._call
        self.client.now = lambda: self.now

    def _connect(self, options):
        self.client = j2a.Client(self._near, **options)

    def _call(self, what, opcode, payload, limit_s, _generation=None):
        self.limits.append(limit_s)
        cost_s = math.inf if self.is_silent else COST_S
        self.now += min(cost_s, limit_s)
        if cost_s > limit_s:
            raise j2a.CallTimeout(what)
        return Reply(*self.device._execute(opcode, payload))

    def do(self, name, *args, **limits):
        """Use a method or a property."""
        member = getattr(self.client, name)
        return member(*args, **limits) if callable(member) else member

    def close(self):
        self.client.close()
        self._far.close()


class VirtualAsyncio(Virtual):
    """The same of the asyncio client."""

    def _connect(self, options):
        self._runner = asyncio.Runner()
        self._runner.run(self._start(options))

    async def _start(self, options):
        self.client = j2a.AsyncClient(self._near, **options)

    def _call(self, *args):
        async def call():
            return super(VirtualAsyncio, self)._call(*args)

        return call()

    def do(self, name, *args, **limits):
        async def work():
            return await getattr(self.client, name)(*args, **limits)

        return self._runner.run(work())

    def close(self):
        self._runner.run(self.client.close())
        self._runner.close()
        self._far.close()


@pytest.fixture(params=[Virtual, VirtualAsyncio])
def connected(request):
    """A function that makes a client, which knows its device already."""
    clients = []

    def connect(**options):
        clients.append(request.param(**options))
        clients[-1].do("properties")
        clients[-1].limits.clear()
        return clients[-1]

    yield connect
    for client in clients:
        client.close()


def public(kind):
    return {
        name: inspect.signature(member)
        for name, member in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_")
    }


def shape(signature):
    return [(p.name, p.kind, p.default) for p in signature.parameters.values()]


def defaults(signature):
    return {
        name: parameter.default
        for name, parameter in signature.parameters.items()
        if parameter.default is not inspect.Parameter.empty
    }


class TestSignatures:
    def test_both_clients_have_the_same_methods_with_the_same_arguments(self):
        blocking, others = public(j2a.Client), public(j2a.AsyncClient)
        properties = {
            name for name, _ in inspect.getmembers(j2a.Client, lambda m: isinstance(m, property))
        }
        assert others.keys() - blocking.keys() <= properties
        assert blocking.keys() <= others.keys()
        for name, signature in blocking.items():
            assert shape(signature) == shape(others[name]), name

    @pytest.mark.parametrize("kind", [j2a.Client, j2a.AsyncClient])
    def test_what_is_left_out(self, kind):
        for name, signature in public(kind).items():
            found = defaults(signature)
            assert found == {key: DEFAULTS[key] for key in found}, name
        assert defaults(inspect.signature(kind)) == OF_CLIENTS

    @pytest.mark.parametrize("function", [j2a.connect, j2a.aconnect])
    def test_of_connecting(self, function):
        assert defaults(inspect.signature(function)) == OF_CLIENTS | {"boot_time": 5.0}

    def test_of_a_device(self):
        assert defaults(inspect.signature(j2a.Device)) == {
            "properties": None,
            "interface": True,
            "boot": False,
            "transducers": None,
            "settings": None,
            "clock": None,
            "room": 255,
            "byte_timeout_s": 0.01,
            "trace": None,
        }
        serve = defaults(inspect.signature(j2a.Device.serve_forever))
        assert serve == {"max_hosts": None, "idle_s": 60.0}
        assert defaults(inspect.signature(j2a.Device.send_sif)) == {"payload": b""}

    @pytest.mark.parametrize("kind", [j2a.Client, j2a.AsyncClient])
    def test_those_below_are_all_that_take_limits(self, kind):
        timed = {n for n, s in public(kind).items() if "timeout" in s.parameters}
        assert timed == {*TIMED, "wait_sif"}  # which asks nothing of the device


@pytest.mark.requirement("J2A-TIME-008")
class TestLimits:
    """The limit of each request is that of a chunk or what is left of the whole."""

    def check(self, client, name, step_s, total_s, **limits):
        client.device._content[:] = DATA
        start = client.now
        left = (total_s - n * COST_S for n in range(CHUNKS + 1))
        want = [min(step_s, left_s) for left_s in left if left_s > 0]
        try:
            client.do(name, *TIMED[name], **limits)
        except j2a.CallTimeout:
            assert client.now == start + total_s
            assert client.limits == want
        else:
            chunks = CHUNKS if name.endswith("_many") else 1
            assert client.limits == want[:chunks]
            assert len(client.limits) == chunks

    @pytest.mark.parametrize("timeout", [None, 0.5, 3.0, math.inf])
    @pytest.mark.parametrize("name", [name for name in TIMED if not name.endswith("_many")])
    def test_of_a_call(self, connected, name, timeout):
        limit_s = 2.0 if timeout is None else timeout
        self.check(connected(timeout=2.0), name, limit_s, limit_s, timeout=timeout)

    def test_that_no_float_holds_is_for_ever(self, connected):
        self.check(connected(timeout=2.0), "echo", math.inf, math.inf, timeout=10**400)

    @pytest.mark.parametrize("total", [None, 0.125, 0.75, 1.125, 8.0, math.inf])
    @pytest.mark.parametrize("timeout", [None, 0.5, 3.0, math.inf])
    @pytest.mark.parametrize("name", [name for name in TIMED if name.endswith("_many")])
    def test_of_a_transfer(self, connected, name, timeout, total):
        step_s = 2.0 if timeout is None else timeout
        total_s = math.inf if total is None else total
        client = connected(timeout=2.0)
        self.check(client, name, step_s, total_s, timeout=timeout, total_timeout=total)

    @pytest.mark.parametrize("name", TIMED)
    def test_that_are_left_out(self, connected, name):
        total_s = math.inf if name.endswith("_many") else 1.0
        self.check(connected(), name, 1.0, total_s)

    @pytest.mark.parametrize("name", OF_DEVICE)
    @pytest.mark.parametrize("timeout", [1.0, 0.5])
    def test_of_what_the_device_tells(self, connected, name, timeout):
        client = connected(timeout=timeout)
        client.do("refresh")
        client.client._device.functions = None
        client.limits.clear()
        client.do(name)
        assert client.limits == [timeout] * len(client.limits)
        assert client.limits, "the function map at least is asked for"

    @pytest.mark.parametrize("name", ["refresh", "functions"])
    def test_of_a_device_that_is_silent(self, connected, name):
        client = connected(timeout=0.5)
        client.is_silent = True
        client.client._device.functions = None
        with pytest.raises(j2a.CallTimeout):
            client.do(name)
        assert client.limits == [0.5]

    def test_of_a_device_that_boots(self, connected):
        client = connected()
        client.is_silent = True
        with pytest.raises(j2a.CallTimeout):
            client.do("refresh", 2.0)
        assert client.limits == [0.25, 0.5, 1.0, 0.25]


@pytest.mark.parametrize(("options", "window"), [({}, 1), ({"window": 1}, 1), ({"window": 3}, 3)])
def test_so_many_calls_are_on_their_way_at_once(connected, options, window):
    session = connected(**options).client._session
    session.rxbuf = 4096
    waiters = [object() for _ in range(5)]
    for waiter in waiters:
        session.start_call("echo", 4, b"", now=0.0, timeout_s=9.0, waiter=waiter)
    assert session.counters.frames_sent == window
    for waiter in reversed(waiters):
        session.cancel(waiter)


@pytest.mark.parametrize(("options", "limit_s"), [({}, 5.0), ({"boot_time": 2.0}, 2.0)])
@pytest.mark.parametrize("is_asyncio", [False, True])
def test_for_so_long_a_board_may_boot(monkeypatch, is_asyncio, options, limit_s):
    near, far = j2a_transports.pair()
    limits = []

    def call(_engine, what, _opcode, _payload, limit, _generation=None):
        limits.append(limit)
        raise j2a.CallTimeout(what)

    async def acall(*args):
        call(*args)

    monkeypatch.setattr("j2a.io.blocking.Engine.call", call)
    monkeypatch.setattr("j2a.io.loop.AsyncEngine.call", acall)
    for module in ("client", "aio"):
        monkeypatch.setattr(f"j2a.{module}.open_transport", lambda _url, _options: near)
    with far, pytest.raises(j2a.CallTimeout, match=rf"within {limit_s:g} s"):
        if is_asyncio:
            asyncio.run(j2a.aconnect("loopback:x", **options))
        else:
            j2a.connect("loopback:x", **options)
    assert sum(limits) == limit_s


def test_a_handler_that_an_earlier_one_cancels_is_not_called_any_more():
    handlers = Handlers()
    handlers.add(7, "first".encode)
    second = handlers.add(None, "second".encode)
    handlers.add((6, 7), "third".encode)
    called = []
    for handler in handlers.matching(7):
        called.append(handler())
        second.cancel()
    assert called == [b"first", b"third"]
