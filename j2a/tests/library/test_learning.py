"""What a device tells about itself, where answers are lost: only its own word is kept."""

import asyncio
import contextlib
import inspect
import time

import pytest
from j2a_spec import constants as c
from j2a_spec import oracle
from j2a_spec.constants import BOOT, SOF, SOS

import j2a
from j2a.errors import Outcome
from j2a.protocol import interface as interface_module
from j2a.protocol.device_info import DeviceInfo
from j2a.types.transds_file import read_transds

from .rebooting import boot_payload
from .support import PATIENCE_S, linked
from .test_simulated_time import SlowDevice

TRANSDS = "SENSOR(fast, 0, fast, X, 1, int16_t, none)\n"
CHECKSUM = 0xF3, b"\x00"
REFUSED = 0xF0, b"\x01\x02"


def described(**options):
    device = j2a.Device({}, transducers=read_transds(TRANSDS), boot=True, **options)

    @device.function
    def add(a: j2a.i32, b: j2a.i32) -> j2a.i32:
        return a + b

    return device


class Board(SlowDevice):
    """Loses some replies to what is asked about the device; time is simulated.

    Attributes:
        asked: how often each function was read, by name, and how often the map was.
        losses: how many replies of it are still to be lost, by name.
        instead: what comes in place of a reply, nothing by default.
    """

    def __init__(self, device):
        super().__init__(0.001)
        self.device = device
        self.names = list(device.functions)
        self.asked = dict.fromkeys(self.names, 0)
        self.losses = {}
        self.instead = None

    def write(self, data):
        with self._lock:
            for request in oracle.decode(bytes(data)):
                answer = self._answer(request)
                if answer is not None:
                    reply = oracle.encode(oracle.Frame(SOF, request.seq, *answer))
                    self.due.append((self.now_s + self.takes_s, reply))

    def _answer(self, request):
        opcode = request.payload[0] if request.opcode == 1 else request.opcode
        name = self.names[opcode]
        self.asked[name] += 1
        if self.losses.get(name, 0):
            self.losses[name] -= 1
            return self.instead
        return self.device._execute(request.opcode, request.payload)

    def restart(self):
        with self._lock:
            frame = oracle.Frame(SOS, 0, BOOT, boot_payload(self.device))
            self.due.append((self.now_s, oracle.encode(frame)))


async def awaited(one):
    return await one


class Both:
    """A client of one kind or the other, which is connected to a board."""

    def __init__(self, stack, kind, **options):
        self._runner = stack.enter_context(asyncio.Runner()) if kind == "asyncio" else None
        self.client = self.do(
            j2a.aconnect if self._runner else j2a.connect, "simulated:", **options
        )
        stack.callback(lambda: self.do(self.client.close))

    def do(self, call, *args, **options):
        found = call(*args, **options)
        if not inspect.isawaitable(found):
            return found
        return self._runner.run(asyncio.wait_for(awaited(found), 2 * PATIENCE_S))

    def transducers(self):
        """Look what the device has, and learn that where it is not known."""
        if self._runner:
            return dict(self.do(self.client.transducers))
        return dict(self.client.transducers)

    def functions(self):
        return self.do(self.client.functions) if self._runner else self.client.functions

    def until(self, is_so):
        """Let both sides go on until something is so."""

        async def wait():
            while not is_so():
                await asyncio.sleep(0.001)

        if self._runner:
            self.do(wait)
        while not is_so():
            time.sleep(0.001)


@pytest.fixture(autouse=True)
def empty_cache(monkeypatch):
    monkeypatch.setattr(interface_module, "_kept", type(interface_module._kept)())


@pytest.fixture(params=["blocking", "asyncio"])
def connect(request, monkeypatch):
    with contextlib.ExitStack() as stack:

        def connect(board, **options):
            for module in ("client", "aio"):
                monkeypatch.setattr(f"j2a.{module}.open_transport", lambda _url, _options: board)
            return Both(stack, request.param, **options)

        yield connect


DESCRIPTIONS = [c.GET_PROPERTIES, c.GET_INTERFACE, c.GET_TRANSDS]


@pytest.mark.parametrize("instead", [None, CHECKSUM], ids=["lost", "damaged"])
@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_lost_reply_while_connecting_costs_nothing_but_time(connect, name, instead):
    board = Board(described())
    board.losses, board.instead = {name: 1}, instead
    both = connect(board)
    assert (both.client.interface_problem, both.client.transducers_problem) == ("", "")
    assert both.do(both.functions().add, 40, 2) == 42
    assert list(both.transducers()) == ["fast"]


@pytest.mark.parametrize("instead", [None, CHECKSUM], ids=["lost", "damaged"])
@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_what_a_device_never_told_is_asked_for_again(connect, name, instead):
    board = Board(described())
    board.losses, board.instead = {name: 10**6}, instead
    both = connect(board)
    assert both.client.interface_problem or both.client.transducers_problem
    for _ in range(2):
        with pytest.raises((j2a.CallTimeout, j2a.errors.DamageReported), match=name):
            both.transducers()
    assert both.do(both.client.call, "a2jEcho", b"x").payload == b"x"  # needs only the map
    board.losses.clear()
    assert list(both.transducers()) == ["fast"]
    assert both.do(both.functions().add, 40, 2) == 42
    assert (both.client.interface_problem, both.client.transducers_problem) == ("", "")
    assert board.asked[c.GET_MAPPING] == 1


@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_refusal_is_the_word_of_the_device(connect, name):
    board = Board(described())
    board.losses, board.instead = {name: 10**6}, REFUSED
    both = connect(board)
    asked = dict(board.asked)
    for _ in range(3):
        assert list(both.transducers()) == ([] if name != c.GET_INTERFACE else ["fast"])
        both.functions()
    assert board.asked == asked


@pytest.mark.requirement("J2A-BOOT-005", "J2A-TIME-008")
@pytest.mark.parametrize("name", DESCRIPTIONS)
def test_a_call_behind_a_restart_hides_nothing(connect, name):
    board = Board(described())
    both = connect(board)
    client, told = both.client, []
    client.on_restart(told.append)
    add, fast = both.functions().add, client.transducers["fast"]
    interface_module._kept.clear()
    board.losses = {name: 10**6}
    board.restart()
    both.until(lambda: client.counters.restarts)
    begun_s = board.now_s
    with pytest.raises(j2a.CallTimeout) as caught:
        both.do(client.call, "add", bytes(8), 0.5)
    assert caught.value.outcome is Outcome.NOT_SENT
    assert begun_s + 0.5 <= board.now_s
    both.until(lambda: told)
    # What it has now is not known, so it may be another one.
    assert [(one.is_changed, one.interface_hash) for one in told] == [(True, "")]
    board.losses.clear()
    assert both.do(add, 40, 2) == 42
    assert list(both.transducers()) == ["fast"]
    assert fast.descriptor.name == "fast"


def test_a_clock_is_asked_where_the_transducers_are_not_known(connect):
    """As on a slow link, where they take longer than the limit of an exchange."""
    board = Board(described(clock=0.0))
    board.losses = {c.GET_TRANSDS: 10**6}
    both = connect(board)
    asked = board.asked[c.GET_TRANSDS]
    both.do(both.client.clock.exchange)
    assert board.asked[c.GET_TRANSDS] == asked


# ---------------------------------------------------------------------- without a link

NO_ANSWER = [
    j2a.CallTimeout("no reply"),
    j2a.LinkStalled("no reply"),
    j2a.errors.ChecksumRefused("no reply", *CHECKSUM),
]


def answers(device, requests):
    return [j2a.Reply(*device._execute(one.opcode or 1, one.payload)) for one in requests]


def told(device, learning):
    """Answer all that is asked; return the result."""
    try:
        requests = next(learning)
        while True:
            requests = learning.send(answers(device, requests))
    except StopIteration as end:
        return end.value


def begun(what):
    """Begin to learn something; return the device, its description, what learns, and that begun."""
    device, peer = described(), DeviceInfo()
    peer.take_map(j2a.Reply(*device._execute(0, b"")))
    learn = getattr(peer, f"learn_{what}")
    learning = learn()
    next(learning)
    return device, peer, learn, learning


@pytest.mark.parametrize("error", NO_ANSWER, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("what", ["interface", "transducers"])
def test_what_another_thread_has_found_stays(what, error):
    device, peer, learn, learning = begun(what)
    assert told(device, learn()) is None
    with pytest.raises(StopIteration) as end:
        learning.throw(error.copy(str(error), error.outcome))
    assert end.value.value is None
    assert getattr(peer, f"{what}_problem") == ""
    assert (peer.interface if what == "interface" else peer.descriptors) is not None


@pytest.mark.parametrize("error", NO_ANSWER, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("what", ["interface", "transducers"])
def test_no_answer_is_told_and_not_kept(what, error):
    device, peer, learn, learning = begun(what)
    with pytest.raises(StopIteration) as end:
        learning.throw(error.copy(str(error), error.outcome))
    assert str(end.value.value) == "no reply" == getattr(peer, f"{what}_problem")
    assert not getattr(peer, f"asked_for_{what}")
    assert told(device, learn()) is None
    assert getattr(peer, f"{what}_problem") == ""
    assert (peer.interface if what == "interface" else peer.descriptors) is not None


# ---------------------------------------------------------------------- while it is learnt anew

LATE = "a_function_with_a_long_name_150"  # which the map has no room for


class Watched(DeviceInfo):
    """Lets another thread look at each moment at which something of it has changed."""

    look = staticmethod(lambda: None)

    def __setattr__(self, name, value):
        super().__setattr__(name, value)
        self.look()


def long_named():
    device = j2a.Device()
    for number in range(200):
        device.function(f"a_function_with_a_long_name_{number}", signature="()")(lambda: None)
    return device


@pytest.mark.parametrize("name", ["a2jEcho", LATE])
def test_a_function_is_known_at_each_moment_while_another_thread_learns_anew(name):
    device = long_named()
    with linked(device) as board:
        board._device = peer = Watched()
        peer.take_map(j2a.Reply(*device._execute(0, b"")))
        assert told(device, peer.learn_interface()) is None
        right, looks = (name, device.functions[name]), []

        def look():
            # None: it is asked for what it has, and then called.
            assert board._known(name, b"") in ((right, None) if name == LATE else (right,))
            looks.append(peer.asked_for_interface)

        peer.look = look
        looks.clear()
        for _ in range(2):
            peer.take_map(j2a.Reply(*device._execute(0, b"")))
            assert told(device, peer.learn_interface()) is None
        assert {True, False} == set(looks)


@pytest.mark.parametrize("call", ["_call", "_read_many", "_write_many"])
def test_a_function_that_was_found_is_called_whatever_another_thread_takes(call, monkeypatch):
    device = long_named()
    with linked(device) as board:

        def take_map(function):
            board._device.take_map(j2a.Reply(*device._execute(0, b"")))
            return function

        monkeypatch.setattr(board, "_current", take_map)
        arguments = {"_call": (b"",), "_read_many": (9, None), "_write_many": (b"", None)}
        asking = getattr(board, call)(LATE, *arguments[call])
        [request] = next(asking)
        opcode = device.functions[LATE]
        assert opcode == (request.opcode or request.payload[0])
        asking.close()


def test_functions_are_looked_up_in_all_that_there_are(monkeypatch):
    device = long_named()
    with linked(device) as board:
        load, loads = board._load, []

        def load_and_be_overtaken():
            load()
            if not loads:
                board._device.take_map(j2a.Reply(*device._execute(0, b"")))
            loads.append(0)

        monkeypatch.setattr(board, "_load", load_and_be_overtaken)
        assert board.functions[LATE].signature is not None
