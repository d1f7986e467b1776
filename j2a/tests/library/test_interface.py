"""Reading the interface of a device: damaged, hostile and endless ones, and the cache."""

import re
import zlib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from j2a_spec.constants import GET_INTERFACE

import j2a
from j2a.demo import DemoDevice
from j2a.protocol import device_info
from j2a.protocol import interface as interface_module
from j2a.protocol.interface import MAX_INTERFACE

from .support import linked
from .test_many import drive, know

TEXT = DemoDevice()._table.interface


def crc(content):
    return f"{zlib.crc32(content):08x}"


def device_with(content, announced=None, caps="interface", **more):
    """A device that returns this text as its interface."""
    properties = {"j2a.caps": caps, "j2a.interface": announced or crc(content), **more}
    device = j2a.Device(properties, interface=False)
    device.many(GET_INTERFACE)(lambda request: j2a.read_chunk(content, request))
    device.function("raw")(lambda payload: payload)
    return device


def learnt(device):
    """What a host knows after it has read the interface, and how often it asked for chunks."""
    peer, requests = know(device), []
    drive(device._execute, peer.learn_interface(), requests)
    return peer, sum(request[0] == device.functions[GET_INTERFACE] for request in requests)


def text_of(*lines):
    """An interface of the device's built-in functions and these lines."""
    names = "".join(f"{name}\n" for name in device_with(b"").functions if name != "raw")
    return ("\n" + names + "".join(f"{line}\n" for line in lines)).encode()


@pytest.fixture(autouse=True)
def empty_cache(monkeypatch):
    monkeypatch.setattr(interface_module, "_kept", type(interface_module._kept)())


@pytest.mark.requirement("J2A-IFACE-010")
def test_functions_that_the_mapping_does_not_name_are_called_by_name():
    device = j2a.Device()
    for number in range(200):
        name = f"a_function_with_a_long_name_{number}"
        device.function(name, signature="(a u16) u16")(lambda a, n=number: a + n)
    with linked(device) as board:
        assert len(board.functions) == 207
        assert board.functions.a_function_with_a_long_name_199(1) == 200
        assert board.call("a_function_with_a_long_name_150", b"\0\0") == (0, b"\x96\0")
        board._device.take_map(j2a.Reply(0, device._execute(0, b"")[1]))
        assert "a_function_with_a_long_name_150" not in board._device.functions
        assert board.call("a_function_with_a_long_name_150", b"\0\0") == (0, b"\x96\0")


@pytest.mark.requirement("J2A-IFACE-009", "J2A-CAP-003")
@pytest.mark.parametrize(
    ("device", "problem"),
    [
        (device_with(text_of("raw()"), caps="other"), "does not announce interface"),
        (device_with(text_of("raw()"), announced="00000000"), "says '00000000'"),
        (device_with(text_of("raw()"), announced=crc(text_of("raw()")).upper()), "CRC-32 .* says"),
        (device_with(text_of("raw")[:-1]), "does not end with a line feed"),
        (device_with(text_of("raw(a i33)", "raw")), "another function has the name raw"),
        (device_with(text_of("raw(a u8")), r"rules of its language.*\(line 9, character 9"),
        (device_with(text_of("war()")), "does not begin with the names"),
        (device_with(text_of()), "does not begin with the names"),
        (device_with(text_of("raw # ")[:-1] + b"\xff\n"), "not UTF-8"),
        (device_with(b""), "line feed"),
        (device_with(b"\n" * 70000), "more than 65536 bytes"),
        (device_with(b"", **{"j2a.spec": "2.0"}), "does not announce"),
    ],
    ids=range(12),
)
def test_one_that_cannot_be_used_is_left(device, problem):
    with linked(device) as board:
        assert re.search(problem, board.interface_problem)
        assert board.interface is None
        assert board.call("raw", b"x") == (0, b"x")
        assert board.functions["raw"] == device.functions["raw"]
        with pytest.raises(j2a.LocalError):
            board.functions.raw(1)


@pytest.mark.requirement("J2A-IFACE-008")
def test_the_bound():
    filler = "raw # " + "x" * (MAX_INTERFACE - len(text_of("raw # ")))
    assert len(text_of(filler)) == MAX_INTERFACE
    assert learnt(device_with(text_of(filler)))[0].interface is not None
    peer, _ = learnt(device_with(text_of(filler + "x")))
    assert "more than 65536 bytes" in peer.interface_problem


@pytest.mark.requirement("J2A-IFACE-008")
@pytest.mark.parametrize(
    "reply",
    [
        j2a.ManyReply(data=b"x"),
        j2a.ManyReply(data=b"\n" * 249),
        j2a.ManyReply(),
        j2a.ManyReply(code=0xFF),
        j2a.ManyReply(data=b"x", offset=7),
    ],
    ids=["endless", "long", "empty", "failing", "offset"],
)
def test_one_without_an_end_is_left(reply, monkeypatch):
    # A small bound is as good: up to that of test_the_bound the endless one takes 65,536 calls.
    monkeypatch.setattr(device_info, "MAX_INTERFACE", 1024)
    device = device_with(b"")
    device._table._manys[device.functions[GET_INTERFACE]] = lambda request: reply
    with linked(device) as board:
        assert board.interface_problem
        assert board.call("raw", b"x") == (0, b"x")


def test_silence_costs_the_interface_and_not_the_link():
    class Silent(j2a.Device):
        """Takes its time with the interface."""

        def _execute(self, opcode, payload):
            if opcode == 1 and payload[0] == 6:
                raise j2a.CallTimeout("a2jGetInterface")
            return super()._execute(opcode, payload)

    device = Silent()
    peer = know(device)
    steps = peer.learn_interface()
    asked = next(steps)
    asked = steps.send([j2a.Reply(*device._execute(1, asked[0].payload))])  # the properties
    with pytest.raises(StopIteration):
        steps.throw(j2a.CallTimeout("no reply"))
    assert peer.interface_problem == "no reply"
    assert not peer.asked_for_interface
    assert peer.functions == device.functions
    for error in (j2a.LinkLost, j2a.LinkClosed):
        peer = know(device)
        steps = peer.learn_interface()
        next(steps)
        with pytest.raises(error):
            steps.throw(error("gone"))


@pytest.mark.requirement("J2A-IFACE-011")
def test_what_a_later_version_adds_is_ignored():
    content = b"later of some kind\n" + text_of(
        "raw(a u8) u8 !idempotent !later(x) !slow(7)", "f(a later)"
    )
    device = device_with(content)
    device.function("f")(lambda payload: payload)
    with linked(device) as board:
        assert board.functions.raw(5) == 5
        assert (board.functions.raw.idempotent, board.functions.raw.slow_s) == (True, 0.007)
        assert board.functions["f"].signature is None
        assert board.call("f", b"x") == (0, b"x")


@pytest.mark.requirement("J2A-IFACE-012")
def test_one_that_was_read_before_is_used_again():
    content = text_of("raw(a u8) u8")
    first, asked = learnt(device_with(content))
    assert asked == 1
    again, asked = learnt(device_with(content))
    assert asked == 0
    assert again.interface is first.interface
    changed, asked = learnt(device_with(text_of("raw(a u16) u16")))
    assert asked
    assert changed.interface is not first.interface
    other = device_with(b"no interface\n", announced=crc(content))
    other.function("more")(lambda payload: payload)
    peer, asked = learnt(other)  # the same hash with other names
    assert asked and peer.interface is None


def test_few_are_kept():
    for number in range(100):
        learnt(device_with(text_of(f"raw # {number}")))
    assert len(interface_module._kept) == 64


@settings(deadline=None)
@given(st.data())
@pytest.mark.requirement("J2A-IFACE-009")
def test_a_damaged_one_never_does_harm(data):
    content = bytearray(TEXT)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        kind = data.draw(st.sampled_from(["replace", "remove", "insert", "cut"]))
        byte = data.draw(st.sampled_from(b"\n\0 (),#!ax19[]\xff"))
        if kind == "replace":
            content[at] = byte
        elif kind == "insert":
            content.insert(at, byte)
        elif kind == "cut":
            del content[at:]
        else:
            del content[at]
        if not content:
            break
    judge(bytes(content))


@settings(deadline=None)
@given(st.one_of(st.binary(max_size=300), st.text(max_size=100).map(lambda text: text.encode())))
@example(b"\n" * 65536)
@example(b"\nf(" + b", ".join(b"a%d u8" % n for n in range(7000)) + b")\n")
@example(b"enum e u32 (" + b", ".join(b"a%d=%d" % (n, n) for n in range(4000)) + b")\n\n")
@example(b"\nf" + b" !x" * 20000 + b"\n")
@example(b"".join(b"struct s%d (a s%d)\n" % (n + 1, n) for n in range(3000)) + b"\n")
def test_a_hostile_one_never_does_harm(content):
    judge(content)
    judge(text_of("raw()")[:-1] + content)


def judge(content):
    """Whatever it says: it is used as a whole or not at all, and raw calls go on."""
    interface_module._kept.clear()
    device = device_with(content)
    peer, _ = learnt(device)
    assert (peer.interface is None) == bool(peer.interface_problem)
    assert peer.functions["raw"] == device.functions["raw"]
    names = list(device.functions)
    assert list(peer.functions)[: len(names)] == names
