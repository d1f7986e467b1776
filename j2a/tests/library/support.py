"""What the tests of the library share: the oracle in the library's types, devices to talk to, and
the judge of answers that came over a bad link."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, pairwise

import j2a_transports
from hypothesis import strategies as st
from j2a_spec import oracle
from j2a_spec.constants import ESC, SOF, SOS

import j2a
from j2a.demo import DemoDevice
from j2a.events import Frame, FrameError

PATIENCE_S = 30.0
"""Longer than anything takes that is going to happen at all."""

_names = count()

# ---------------------------------------------------------------------- streams

TRICKY = [SOF, SOS, ESC, SOF - 1, SOS - 1, ESC - 1, 0x00, 0x01, 0xFF, 0xFE]
tricky_bytes = st.lists(st.one_of(st.sampled_from(TRICKY), st.integers(0, 255)), max_size=24).map(
    bytes
)
payloads = st.one_of(
    tricky_bytes,
    st.binary(max_size=255),
    st.builds(
        lambda byte, size: bytes((byte,)) * size, st.sampled_from(TRICKY), st.integers(0, 255)
    ),
)
frames = st.builds(
    oracle.Frame,
    st.sampled_from([SOF, SOS]),
    st.integers(0, 255),
    st.integers(0, 255),
    payloads,
)


@st.composite
def damaged(draw: st.DrawFn, wires: st.SearchStrategy[bytes]) -> bytes:
    """Wire bytes with a few bytes replaced, removed, doubled or inserted."""
    wire = bytearray(draw(wires))
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(wire) - 1)) if wire else 0
        kind = draw(st.sampled_from(["replace", "remove", "double", "insert"]))
        byte = bytes((draw(st.sampled_from(TRICKY)),))
        if kind == "replace":
            wire[at : at + 1] = byte
        elif kind == "remove":
            del wire[at : at + 1]
        elif kind == "double":
            wire[at:at] = wire[at : at + 1]
        else:
            wire[at:at] = byte
    return bytes(wire)


wires = frames.map(oracle.encode)
streams = st.lists(st.one_of(wires, damaged(wires), tricky_bytes), max_size=6).map(b"".join)


def chunked(data: bytes, cuts: list[int]) -> list[bytes]:
    """Cut data at the given places, in any order and repeated as they like."""
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[start:end] for start, end in pairwise(edges)]


def by_the_oracle(
    stream: bytes,
) -> tuple[list[Frame | FrameError], int, tuple[int, int | None] | None]:
    """Return what the library is to make of a stream.

    Returns: frames and frame errors; the number of skipped bytes; start and seq of the frame that
        is still open, if one is.
    """
    events: list[Frame | FrameError] = []
    skipped, rest = 0, None
    for event in oracle.decode(stream):
        match event:
            case oracle.Frame(start, seq, opcode, payload):
                events.append(Frame(start, seq, opcode, payload))
            case oracle.FrameError(reason, start, seq):
                events.append(FrameError(reason, start, seq))
            case oracle.Skipped(size):
                skipped += size
            case oracle.Incomplete(start, seq):
                rest = (start, seq)
    return events, skipped, rest


# ---------------------------------------------------------------------- devices


@contextmanager
def served(device: j2a.Device, url: str | None = None, **limits: float) -> Iterator[str]:
    """Serve a device in a thread, within limits of hosts; yields the URL to connect to."""
    listener = j2a_transports.listen(url or f"loopback:device-{next(_names)}")

    def serve() -> None:
        try:
            device.serve_forever(listener, **limits)
        except j2a.LocalError as error:
            if "was stopped" not in str(error):  # by a test that ends before this thread begins
                raise

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.url
    finally:
        device.stop()
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), "the device does not stop"


@contextmanager
def linked(device: j2a.Device | None = None, **options: object) -> Iterator[j2a.Client]:
    """Connect a client to a device, the demo by default."""
    options.setdefault("timeout", PATIENCE_S)
    options.setdefault("boot_time", PATIENCE_S)
    with served(device or DemoDevice()) as url, j2a.connect(url, **options) as client:
        yield client


class OldDevice(j2a.Device):
    """A device of version 1.0: looks at one byte of the offset only, and has what is asked for.

    Args:
        properties: of the device; j2a.spec is never among them.
        has_map: it answers opcode 0.
    """

    def __init__(self, properties: dict[str, str] | None = None, *, has_map: bool = True) -> None:
        self.content = b""
        self.offsets: list[int] = []
        self.written: list[bytes] = []
        self._old_properties = b"".join(
            f"{key}\0{value}\0".encode() for key, value in (properties or {}).items()
        )
        self._has_map = has_map
        super().__init__()
        self.many("content")(self._content)

    def _content(self, request: j2a.ManyRequest) -> j2a.ManyReply:
        self.offsets.append(request.offset)
        if request.is_write:
            self.written.append(request.data)
            return j2a.ManyReply(is_last=request.is_last)
        return j2a.read_chunk(self.content, request)

    def _execute(self, opcode: int, payload: bytes) -> tuple[int, bytes]:
        if opcode == 0 and not self._has_map:
            return 0xF0, b"\x01\x02"
        if opcode != 1 or len(payload) < 6:
            return super()._execute(opcode, payload)
        func, flags, offset, data = payload[0], payload[1], payload[2:6], payload[6:]
        seen = offset[0]
        if func == 2:
            request = j2a.ManyRequest(False, False, seen, b"")
            chunk = j2a.read_chunk(self._old_properties, request)
            return 0, bytes((0, chunk.is_last)) + offset + chunk.data
        code, reply = super()._execute(1, bytes((func, flags, seen, 0, 0, 0)) + data)
        if code == 0:
            reply = reply[:2] + offset + reply[6:]  # the old firmware echoes what was asked for
        return code, reply


# ---------------------------------------------------------------------- the judge


class Judge:
    """Knows every frame that was sent and every byte that arrived, in both directions.

    A frame that arrived whole although nobody sent it was changed in a way that the checksum cannot
    see; only such a frame excuses a wrong answer. What arrived is read by the oracle.
    """

    def __init__(self) -> None:
        self._sent: dict[str, set[Frame]] = {"host": set(), "device": set()}
        self._arrived: dict[str, list[bytearray]] = {"host": [bytearray()], "device": [bytearray()]}
        self.host = self._trace("host")
        self.device = self._trace("device")

    def _trace(self, side: str) -> j2a.Trace:
        def trace(direction: str, item: Frame | FrameError | bytes) -> None:
            if direction == "tx" and isinstance(item, Frame):
                self._sent[side].add(item)
            elif direction == "rx" and isinstance(item, bytes):
                self._arrived[side][-1] += item
            elif isinstance(item, FrameError) and item.reason == "timeout":
                self._arrived[side].append(bytearray())  # what follows belongs to no frame

        return trace

    def forged(self, side: str) -> set[Frame]:
        """Return the frames that arrived at a side and were never sent by the other."""
        sent = self._sent["device" if side == "host" else "host"]
        arrived = set()
        for part in self._arrived[side]:
            events, _, _ = by_the_oracle(bytes(part))
            arrived.update(event for event in events if isinstance(event, Frame))
        return arrived - sent

    def excuses(self, seq: int) -> bool:
        """Whether a frame with this seq was changed unseen, on its way there or back."""
        return any(frame.seq == seq for frame in self.forged("host") | self.forged("device"))
