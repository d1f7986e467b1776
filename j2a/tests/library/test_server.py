"""The device's server: the timed scenarios of the specification, in virtual time."""

import pytest
from j2a_spec import oracle, vectors
from j2a_spec.constants import ERRORS, SOF, SOS

from j2a.events import Frame, FrameError
from j2a.io.functions import DebugText, FunctionTable
from j2a.protocol.server import Server

SCENARIOS = {test["id"]: test for test in vectors.load("scenario")}


class DeviceInVirtualTime:
    """A server, the built-in functions and a clock; `now` is in seconds."""

    def __init__(self, now: float = 50.0) -> None:
        self.now = now
        self.server = Server()
        self.table = FunctionTable({"j2a.spec": "1.1"}, lambda _payload: DebugText().take())
        self.sent: list[oracle.Frame] = []

    def opcode(self, name: str) -> int:
        return self.table.names.index(name)

    def receive(self, data: bytes) -> None:
        self.server.receive(data, self.now)
        self.work()

    def wait(self, milliseconds: float) -> None:
        end = self.now + milliseconds / 1000
        due = self.server.next_timeout()
        if due is not None and due <= end:
            self.now = due
            self.server.handle_timeout(self.now)
            self.work()
        self.now = end

    def work(self) -> None:
        while (request := self.server.next_request()) is not None:
            self.server.reply(request, *self.table.execute(request.opcode, request.payload))
        self.sent += oracle.decode(self.server.data_to_send())


def damaged(wire: bytes, damage: dict[str, object]) -> bytes:
    changed = bytearray(wire)
    for at, mask in damage.get("xor", []):
        changed[at] ^= mask
    if "insert" in damage:
        at, extra = damage["insert"]
        changed[at:at] = bytes.fromhex(extra)
    return bytes(changed[damage.get("skip", 0) : damage.get("cut", len(changed))])


@pytest.mark.parametrize("is_bytewise", [False, True], ids=["whole", "bytewise"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario(name, is_bytewise):
    device = DeviceInVirtualTime()

    def send(data: bytes) -> None:
        for chunk in [data[i : i + 1] for i in range(len(data))] if is_bytewise else [data]:
            device.receive(chunk)

    for step in SCENARIOS[name]["steps"]:
        if "send" in step:
            request = step["send"]
            opcode = (
                request["opcode"] if "opcode" in request else device.opcode(request["function"])
            )
            frame = oracle.Frame(SOF, request["seq"], opcode, bytes.fromhex(request["payload"]))
            send(damaged(oracle.encode(frame), step.get("damage", {})))
        elif "raw" in step:
            send(bytes.fromhex(step["raw"]))
        elif "pause_ms" in step:
            device.wait(step["pause_ms"])
        elif "silence_ms" in step:
            device.wait(step["silence_ms"])
            assert device.sent == []
        else:
            reply, want = device.sent.pop(0), step["expect"]
            assert (reply.start, reply.seq, reply.opcode) == (SOF, want["seq"], want["code"])
            if want["payload"] is not None:
                assert reply.payload == bytes.fromhex(want["payload"])
            elif want["code"] in ERRORS:
                assert len(reply.payload) == 2
    assert device.sent == []


def test_the_byte_timeout_begins_anew_with_each_arrival():
    device = DeviceInVirtualTime()
    request = oracle.encode(oracle.Frame(SOF, 1, device.opcode("a2jEcho"), b"slow"))
    for byte in request[:-1]:
        device.receive(bytes((byte,)))
        assert device.server.next_timeout() == pytest.approx(device.now + 0.010)
        device.wait(9)
    device.receive(request[-1:])
    assert device.server.next_timeout() is None
    assert device.sent == [oracle.Frame(SOF, 1, 0xBA, b"slow")]


def test_a_timeout_is_not_judged_early():
    device = DeviceInVirtualTime()
    device.receive(bytes((SOF, 1)))
    device.server.handle_timeout(device.now + 0.0099)
    device.work()
    assert device.sent == []
    device.server.handle_timeout(device.now + 0.0101)
    device.work()
    assert [frame.opcode for frame in device.sent] == [0xF2]


def test_error_replies_keep_their_place_between_replies():
    device = DeviceInVirtualTime()
    echo = device.opcode("a2jEcho")
    wires = [bytearray(oracle.encode(oracle.Frame(SOF, seq, echo, b"x"))) for seq in range(1, 6)]
    wires[1][-1] ^= 1
    del wires[3][-2:]
    device.receive(b"".join(map(bytes, wires)))
    assert [(frame.seq, frame.opcode) for frame in device.sent] == [
        (1, 0xBA),
        (2, 0xF3),
        (3, 0xBA),
        (4, 0xF4),
        (5, 0xBA),
    ]


def test_broken_sifs_are_nobodys_business():
    device = DeviceInVirtualTime()
    sif = bytearray(oracle.encode(oracle.Frame(SOS, 1, 4, b"x")))
    sif[-1] ^= 1
    device.receive(bytes(sif) + bytes((SOS, 1, 2)))
    device.wait(100)
    assert device.sent == []


def test_sifs_count_from_0_and_wrap():
    device = DeviceInVirtualTime()
    assert device.server.waiting == 0
    for _ in range(257):
        device.server.send_sif(0xED, b"\x12")
    assert device.server.waiting == 257 * 8 + 3 + 3  # three seqs and three checksums are escaped
    device.work()
    assert device.server.waiting == 0
    assert {(frame.start, frame.opcode, frame.payload) for frame in device.sent} == {
        (SOS, 0xED, b"\x12")
    }
    assert [frame.seq for frame in device.sent] == [*range(256), 0]


def test_a_trace_sees_what_passes_in_its_order():
    seen = []
    server = Server(trace=lambda *at: seen.append(at))
    request = Frame(SOF, 9, 4, b"abc")
    wire, begun = oracle.encode(oracle.Frame(*request)), bytes((SOF,))
    server.receive(wire + begun, 0.0)
    taken = server.next_request()
    server.send_sif(7, b"sif")
    server.reply(taken, 0xBA, b"cba")
    sent = server.data_to_send()
    assert server.data_to_send() == b""
    server.handle_timeout(1.0)
    assert server.next_request() is None
    assert seen == [
        ("rx", wire + begun),
        ("rx", request),
        ("tx", Frame(SOS, 0, 7, b"sif")),
        ("tx", Frame(SOF, 9, 0xBA, b"cba")),
        ("tx", sent),
        ("rx", FrameError("timeout", SOF, None)),
    ]
    assert sent == b"".join(oracle.encode(oracle.Frame(*item)) for _, item in seen[2:4])
