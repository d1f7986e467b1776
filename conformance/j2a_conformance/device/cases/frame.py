"""Frames: layout, lengths, what is skipped, and what interrupts a frame (J2A-FRAME)."""

import random
from collections.abc import Iterator
from itertools import product

from j2a_spec import constants as c
from j2a_spec.oracle import Frame, FrameError, Incomplete, checksum, decode, encode

from j2a_conformance.device._case import Case
from j2a_conformance.device._peer import Expected, Peer, refusal
from j2a_conformance.wire._dimensions import damaged, lengths, misread, payload_of, places, spread

from .sums import broken

PATTERNS = (0x12, 0xED, 0x7D, 0x11, 0xEC, 0x7C)
MARKED = bytes((0x12, 0xED, 0x7D, 0x11, 0xEC, 0x7C, 0x13, 0xEE, 0x7E, 0x00, 0xFF))
CLEAN = bytes(b for b in range(256) if b not in c.MARKERS)


def patterns(length: int) -> list[bytes]:
    """Return the eight adversarial payloads of `length` bytes."""
    noise = random.Random(length).randbytes(length)
    return [*(bytes((v,)) * length for v in PATTERNS), bytes(range(length)), noise]


def quiet(length: int, n: int) -> bytes:
    """Return `length` bytes that start no frame, of the kind that `n` chooses."""
    return bytes(byte - (byte in c.MARKERS) for byte in payload_of(length, n))


class Layout(Case):
    """Compares the bytes of some replies on the wire with those of the oracle."""

    ID = "frame.layout"
    EXPECTATION = (
        "Each reply is SOF and the stuffed seq, opcode, length, payload and checksum, byte by "
        "byte, and nothing comes before, between or after them."
    )
    REQUIREMENTS = (
        "J2A-FRAME-001",
        "J2A-FRAME-002",
        "J2A-FRAME-004",
        "J2A-FRAME-010",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-SUM-001",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for payload in (b"", b"a", b"abc", MARKED, bytes(255), bytes(range(255))):
            peer.ask_exact(peer.echo(payload))


class Lengths(Case):
    """Echoes payloads of every length from 0 to 255 of five kinds each: all values in a row,
    special bytes in disorder, runs of special bytes, noise, one special byte only; as many
    at a time as j2a.rxbuf holds.
    """

    ID = "frame.lengths"
    EXPECTATION = (
        "1280 of 1280 echoes come back unchanged, each reply as the bytes of the oracle, but those "
        "that are longer than the room of the device, which are answered by 0xFF."
    )
    REQUIREMENTS = (
        "J2A-SEQ-001",
        "J2A-DISP-001",
        "J2A-FRAME-001",
        "J2A-FRAME-002",
        "J2A-FRAME-004",
        "J2A-FRAME-005",
        "J2A-FRAME-010",
        "J2A-STUFF-001",
        "J2A-STUFF-002",
        "J2A-STUFF-003",
        "J2A-SUM-001",
        "J2A-SUM-002",
        "J2A-ECHO-001",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        peer.ask_all(
            peer.echo(payload_of(length, kind + 5 * (length % 7)))
            for length in lengths()
            for kind in range(5)
        )


class Largest(Case):
    """Sends a request of 518 bytes, in which every byte is stuffed but the length and the start,
    and asks for echoes of the largest size whose checksum is stuffed.
    """

    ID = "frame.largest"
    EXPECTATION = "Each is answered; the 518-byte one by 0xF0 where opcode 0x12 has no function."
    REQUIREMENTS = ("J2A-FRAME-005", "J2A-STUFF-005", "J2A-SUM-002")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        if 0x12 in peer.out_of_range():
            request = peer.request(0x12, b"\x12" * 255, c.ERR_OPCODE, seq=0x12)
            assert len(request.wire) == c.MAX_WIRE
            peer.ask(request)
        opcode = peer.echo_opcode
        for seq, code in product(sorted(c.STUFFED), (opcode, c.ECHO)):
            # 255 bytes that need stuffing, with a checksum that does so too where there is one.
            for first, second in product(range(0, 256, 5), repeat=2):
                payload = b"\x12" * first + b"\xed" * second + b"\x7d" * (255 - first - second)
                if first + second <= 255 and checksum(seq, code, payload) in c.STUFFED:
                    peer.ask(peer.echo(payload, seq))
                    break


class Noise(Case):
    """Sends bytes outside frames: each value but the start bytes alone and many times, all of them
    in a row, 1 to 255 bytes, a lonely ESC, and a frame without its start byte; some of them again
    after an error.
    """

    ID = "frame.noise"
    EXPECTATION = "Nothing answers them, and a good frame directly behind them is answered."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-FRAME-009", "J2A-FRAME-010")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        headless = peer.probe().wire[1:]
        streams = [bytes((b,)) for b in CLEAN]
        streams += [quiet(length, length) for length in lengths() if length]
        streams += [CLEAN, b"\x7d" * 7, headless, headless * 3, b"\x7d\xff", b"\x7d\x11\x04\x00"]
        for stream in streams:
            request = peer.probe()
            peer.play(stream + request.wire, request.expected)
        peer.play_all(self._before(peer))
        for stream in streams[::29]:
            broken(peer, c.GET_ECHO, b"before")
            request = peer.probe()
            peer.play(stream + request.wire, request.expected)
        for stream in (b"\x11" * 600, bytes(random.Random(1).choices(CLEAN, k=1500))):
            peer.play(stream, alone=True)

    @staticmethod
    def _before(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield good frames behind and before noise of many lengths."""
        for n, length in enumerate(spread(300, 23, 1)):
            noise = quiet(length, n)
            request = peer.echo(payload_of(n, n + 1))
            yield noise + request.wire + noise[: n % 9], [request.expected]


class NoiseBehind(Case):
    """Sends a good frame with bytes directly behind it that start no frame."""

    ID = "frame.noise-behind"
    EXPECTATION = "The frame is answered once, the bytes are not."
    REQUIREMENTS = ("J2A-FRAME-006", "J2A-DISP-001")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for behind in (b"\0", b"\x7d", b"\xff" * 9, b"\x7d\xff", b"abc\x7d\x7d"):
            request = peer.probe()
            peer.play(request.wire + behind, request.expected, alone=True)
        peer.play_all(self._every_value(peer))

    @staticmethod
    def _every_value(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield frames of many lengths before every value that starts no frame."""
        for n, length in enumerate(spread(step=59)):
            request, good = peer.echo(payload_of(length, n)), peer.probe()
            first = n * 17 % len(CLEAN)
            noise = CLEAN[first:] + CLEAN[:first]
            yield request.wire, [request.expected]
            yield noise + good.wire, [good.expected]


class Interrupted(Case):
    """Cuts a frame with plain and stuffed bytes in every field after each of its bytes, and sends
    a good frame directly behind the cut; also cuts it by SOS; some of it after an error. Cuts
    frames with each seq.
    """

    ID = "frame.interrupted"
    EXPECTATION = (
        "The good frame is answered. Before it comes error 0xF4 with the seq of the cut frame, if "
        "its seq was complete."
    )
    REQUIREMENTS = (
        "J2A-FRAME-007",
        "J2A-FRAME-009",
        "J2A-ERR-003",
        "J2A-ERR-005",
        "J2A-STUFF-005",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        whole = [
            encode(Frame(c.SOF, 0x51, opcode, b"abcd")),
            encode(Frame(c.SOF, 0x7D, opcode, bytes((0x12, 0xED, 0x7D, 0x00)))),
        ]
        for frame in whole:
            for cut in range(1, len(frame)):
                for n, between in enumerate((b"", bytes((c.SOS,)), bytes((c.SOS, 0x20, 0x7D)))):
                    if cut % 3 == n:
                        broken(peer, c.GET_ECHO, b"before")
                    request = peer.probe()
                    stream = frame[:cut] + between + request.wire
                    peer.play(stream, *answers(stream[: -len(request.wire) + 1]), request.expected)
        for stream, due in self._of_every_seq(peer):  # one by one: what comes behind may matter
            peer.play(stream, *due)

    @staticmethod
    def _of_every_seq(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        for seq in range(256):
            wire, request = peer.echo(b"cut", seq).wire, peer.probe()
            stream = wire[: len(wire) - 1 - seq % 3] + request.wire
            yield stream, [refusal(seq, c.ERR_FRAMING), request.expected]


class InterruptedAnywhere(Case):
    """Cuts long frames after each of their bytes by a good frame, in turn directly, behind ESC, and
    behind SOS or ESC and SOS and the rest of the frame; at some places in each of these ways.
    Cuts frames of every length, with and without bytes that need stuffing, also by raw start bytes
    that make a whole frame of it for a device that takes them for a value or leaves them out.
    """

    ID = "frame.interrupted-anywhere"
    EXPECTATION = (
        "Error 0xF4 with the seq of the long frame, if its seq was complete, and then the reply to "
        "the good frame, wherever the cut is."
    )
    REQUIREMENTS = (
        "J2A-FRAME-005",
        "J2A-FRAME-007",
        "J2A-FRAME-009",
        "J2A-ERR-003",
        "J2A-ERR-005",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        peer.play_all(self._streams(peer))

    @staticmethod
    def _streams(peer: Peer) -> Iterator[tuple[bytes, list[Expected]]]:
        ways = (b"", bytes((c.SOS,)), bytes((c.ESC,)), bytes((c.ESC, c.SOS)))
        opcodes = [peer.echo_opcode, *peer.out_of_range()[-1:]]
        opcodes += [peer.opcode(c.MANY)] if peer.has(c.MANY) else []
        for kind, length in ((0, 255), (1, 255), (2, 255), (3, 140)):
            data = b"plain" * 51 if kind == 2 else payload_of(length, kind)
            opcode = opcodes[kind % len(opcodes)]
            frame = encode(Frame(c.SOF, 0x55 + kind, opcode, data))
            at_all = {*range(1, 9), *spread(len(frame), 61)}
            for cut in places(frame):
                if kind in (1, 3) and not (cut % 5 == kind or cut in at_all):
                    continue
                one = b"" if kind == 2 else ways[cut % 4]
                for way in ways if kind in (0, 2) and cut in at_all else (one,):
                    # The rest behind SOS: taken for data, SOS would make the checksum wrong.
                    rest = frame[cut:] if way[-1:] == bytes((c.SOS,)) else b""
                    yield InterruptedAnywhere._cut(peer, frame[:cut] + way + rest)
        for length in lengths():
            for n, data in enumerate((b"plain" * 51, payload_of(255, length))):
                frame = encode(Frame(c.SOF, length, opcodes[0], data[:length]))
                cut = len(frame) - 1 - length * (3 + 8 * n) % (len(frame) - 4)
                yield InterruptedAnywhere._cut(peer, frame[:cut])
        markers = [(value, bytes((value,))) for value in sorted(c.MARKERS)]
        kinds: list[tuple[bytes, int | None]] = []
        for value, raw in markers:
            kinds += [(raw, value), (raw, None), (b"\x7d" + raw, value + 1)]
        for n, (stream, _) in enumerate(misread(opcodes[0], kinds)):
            if not any(isinstance(e, Frame) and e.start == c.SOF for e in decode(stream)):
                # Before some of them no good frame, but another broken one.
                if n % 3 == 0:
                    first, wrong = damaged(opcodes[0], n)
                    yield first, [refusal(wrong, c.ERR_CHECKSUM)]
                yield InterruptedAnywhere._cut(peer, stream)

    @staticmethod
    def _cut(peer: Peer, stream: bytes) -> tuple[bytes, list[Expected]]:
        """Return the stream followed by a valid frame, and the expected replies."""
        request = peer.probe()
        return stream + request.wire, [*answers(stream + b"\x12"), request.expected]


class EscapedMarker(Case):
    """Sends a good frame directly after an ESC in every field of another frame."""

    ID = "frame.marker-after-escape"
    EXPECTATION = "The good frame is answered, after error 0xF4 for the other if its seq came."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-STUFF-003", "J2A-ERR-003")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        frame = encode(Frame(c.SOF, 0x52, peer.echo_opcode, b"abcd"))
        for cut in range(1, len(frame)):
            request = peer.probe()
            stream = frame[:cut] + bytes((c.ESC,)) + request.wire
            peer.play(stream, *answers(stream[: -len(request.wire) + 1]), request.expected)


class StartBytes(Case):
    """Sends many start bytes in a row, SOF, SOS and mixed, and then a good frame."""

    ID = "frame.start-bytes"
    EXPECTATION = "Only the good frame is answered."
    REQUIREMENTS = ("J2A-FRAME-007", "J2A-FRAME-008", "J2A-FRAME-009", "J2A-ERR-005")
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        for starts in (b"\x12", b"\xed", b"\x12\xed", b"\xed\x12", b"\x12" * 20, b"\xed\x12" * 20):
            request = peer.probe()
            peer.play(starts + request.wire, request.expected, alone=True)


class FromHost(Case):
    """Sends frames that start with SOS: good ones for a2jEcho and for no function, with a wrong
    checksum, with ESC 0xFF, and cut short; also behind each byte of a request, and behind ESC
    there.
    """

    ID = "frame.sos-to-device"
    EXPECTATION = "None of them is answered, only the request that one interrupts."
    REQUIREMENTS = ("J2A-FRAME-008",)
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        opcode = peer.echo_opcode
        good = encode(Frame(c.SOS, 0x53, opcode, b"abcd"))
        streams = [
            good,
            encode(Frame(c.SOS, 0x53, opcode, MARKED)),
            encode(Frame(c.SOS, 0x53, 0xFF)),
            good[:-1] + bytes((good[-1] ^ 1,)),
            good[:5] + b"\x7d\xff" + good[5:],
            *(good[:cut] for cut in range(1, len(good))),
        ]
        for stream in streams:
            peer.play(stream, alone=True)
        peer.play_all(self._of_lengths(peer, opcode))
        peer.play_all(self._within(peer, streams[:-2]))

    @staticmethod
    def _within(peer: Peer, frames: list[bytes]) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield frames with SOS behind each byte of a request, each before a good one."""
        request = encode(Frame(c.SOF, 0xED, peer.echo_opcode, b"a\x12b"))
        for cut in places(request):
            for n, way in enumerate((b"", bytes((c.ESC,)))):
                if way and request[cut - 1] == c.ESC:  # ESC ESC would be a value of its own
                    continue
                # The first one is taken each time, because it would be executed.
                for frame in (frames[0], frames[(2 * cut + n) % len(frames)]):
                    stream, good = request[:cut] + way + frame, peer.probe()
                    yield stream + good.wire, [*answers(stream + b"\x12"), good.expected]

    @staticmethod
    def _of_lengths(peer: Peer, opcode: int) -> Iterator[tuple[bytes, list[Expected]]]:
        """Yield frames with SOS of every length, good, damaged and cut, each before a good one and
        behind what leaves the receiver in another state.
        """
        for length in lengths():
            whole = encode(Frame(c.SOS, length * 7 % 256, opcode, payload_of(length, length)))
            wrong = whole[-1] ^ (0x01 if whole[-1] ^ 0x01 not in c.STUFFED else 0x04)
            first, seq = damaged(opcode, length)
            begun = encode(Frame(c.SOF, seq, opcode, b"x"))[:-1]  # whose checksum is due
            before, due = (
                (b"", []),
                (bytes((c.SOF,)), []),
                (begun, [refusal(seq, c.ERR_FRAMING)]),
                (b"", []),
            )[length % 4]
            for frame in (
                whole,
                (whole[: -1 - length % 2], whole[:-1] + bytes((wrong,)))[length % 2],
            ):
                if length % 4 == 3:
                    yield first, [refusal(seq, c.ERR_CHECKSUM)]
                request = peer.probe()
                yield before + frame + request.wire, [*due, request.expected]


class Garbage(Case):
    """Sends 150 random streams, rich in start bytes, escapes and pieces of frames, each with a
    good frame directly behind it.
    """

    ID = "frame.garbage"
    EXPECTATION = "The error replies that the oracle derives, and the reply to the good frame."
    REQUIREMENTS = (
        "J2A-FRAME-006",
        "J2A-FRAME-007",
        "J2A-FRAME-009",
        "J2A-STUFF-003",
        "J2A-STUFF-004",
        "J2A-ERR-003",
        "J2A-ERR-004",
        "J2A-ERR-009",
    )
    LEVEL = "frame"

    def _run(self, peer: Peer) -> None:
        rng = random.Random(2)
        piece = encode(Frame(c.SOF, 0x54, peer.echo_opcode, MARKED))
        done = 0
        while done < 150:
            stream = b"".join(_shred(rng, piece) for _ in range(rng.randint(1, 5)))
            if any(isinstance(e, Frame) and e.start == c.SOF for e in decode(stream)):
                continue  # a good frame by chance; what it would call is not known
            request = peer.probe()
            due = answers(stream + request.wire[:1])
            peer.play(stream + request.wire, *due, request.expected)
            done += 1


def _shred(rng: random.Random, piece: bytes) -> bytes:
    """Return some random bytes, or a part of `piece`."""
    if rng.random() < 0.5:
        return bytes(rng.choices(MARKED, k=rng.randint(1, 8)))
    first = rng.randrange(len(piece))
    return piece[first : first + rng.randint(1, 12)]


def answers(stream: bytes) -> list[Expected]:
    """Return the error replies that a device owes to `stream`, which holds no good request."""
    codes = {"checksum": c.ERR_CHECKSUM, "marker": c.ERR_FRAMING, "escape": c.ERR_FRAMING}
    due = []
    for event in decode(stream):
        assert isinstance(event, Incomplete) or not isinstance(event, Frame) or event.start == c.SOS
        if isinstance(event, FrameError) and event.start == c.SOF and event.seq is not None:
            due.append(refusal(event.seq, codes[event.reason]))
    return due
