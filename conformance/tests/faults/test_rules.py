"""What is due for any bytes, how theory counts, and how a stream becomes short and is kept."""

import json
from random import Random

import jsonschema
import pytest
from j2a_conformance._model import Claims, HarnessError
from j2a_conformance._peer import Expected
from j2a_conformance.faults import _vectors
from j2a_conformance.faults._proxy import Tap
from j2a_conformance.faults._rules import Rules, difference
from j2a_conformance.faults._shrink import shrink
from j2a_conformance.faults._theory import Share, wilson
from j2a_spec import constants as c
from j2a_spec import vectors
from j2a_spec.oracle import Frame, FrameError, Skipped, decode, encode

ECHO = c.BUILTINS.index(c.GET_ECHO)
RULES = Rules(Claims(mapped=True, functions=(*c.BUILTINS, "own"), properties={"j2a.rxbuf": "16"}))


def request(opcode: int, payload: bytes = b"", seq: int = 7) -> bytes:
    return encode(Frame(c.SOF, seq, opcode, payload))


@pytest.mark.parametrize(
    ("stream", "due"),
    [
        ((), []),
        ((b"noise",), []),
        ((request(ECHO, b"x"),), [Expected(7, c.ECHO, b"x")]),
        ((request(0),), [Expected(7, c.RET_OK)]),
        ((request(1, b"short"),), [Expected(7, c.RET_FAILED)]),
        ((request(1, b"longer"),), [Expected(7)]),
        ((request(c.BUILTINS.index(c.GET_ECHO_MANY)),), [Expected(7, c.ERR_OPCODE)]),
        ((request(6),), [Expected(7)]),
        ((request(7),), [Expected(7, c.ERR_OPCODE)]),
        ((b"\x12\x07\x04\x00\x00",), [Expected(7, c.ERR_CHECKSUM)]),
        ((b"\x12\x07\x7d\xff",), [Expected(7, c.ERR_FRAMING)]),
        ((b"\x12\x07\xed\x01",), [Expected(7, c.ERR_FRAMING)]),
        ((b"\x12\x07",), [Expected(7, c.ERR_TIMEOUT)]),
        ((b"\x12",), []),
        ((b"\x12\x07", b"\x00\x12\x08"), [Expected(7, c.ERR_TIMEOUT), Expected(8, c.ERR_TIMEOUT)]),
        ((request(ECHO)[:3], request(ECHO)[3:]), [Expected(7, c.ERR_TIMEOUT)]),
    ],
)
def test_what_is_due(stream, due):
    assert RULES.due(stream) == due


def test_what_is_due_without_a_mapping():
    rules = Rules(Claims(mapped=False, functions=c.BUILTINS))
    assert rules.due((request(0),)) == [Expected(7, c.ERR_OPCODE)]
    assert rules.due((request(99),)) == [Expected(7)]


def test_what_is_due_to_long_payloads_where_there_is_little_room():
    rules = Rules(RULES.claims, longest=32)
    fits, long, refused = bytes(32), bytes(33), [Expected(7, c.RET_FAILED, b"")]
    assert rules.due((request(ECHO, fits),)) == [Expected(7, c.ECHO, fits)]
    assert rules.due((request(0, fits),)) == [Expected(7, c.RET_OK)]
    for opcode in (0, 1, ECHO):
        assert rules.due((request(opcode, long),)) == refused
    assert rules.due((request(c.BUILTINS.index(c.GET_ECHO_MANY), long),)) == [
        Expected(7, c.ERR_OPCODE)
    ]
    assert rules.due((request(6, long),)) == [Expected(7)]
    assert rules.due((request(99, long),)) == [Expected(7, c.ERR_OPCODE)]


def test_more_than_the_device_has_room_for_is_not_judged():
    small, large = request(ECHO), request(ECHO, bytes(40))
    assert RULES.is_exact((small + small,))
    assert RULES.is_exact((large,))
    assert RULES.is_exact((large + small,))
    assert not RULES.is_exact((small + large,))
    assert RULES.is_exact((small, large))
    assert Rules(RULES.claims, held=4096).is_exact((small + large,))


@pytest.mark.parametrize(
    ("segment", "pieces"),
    [
        (request(ECHO) * 2, (request(ECHO),) * 2),
        (request(ECHO) + b"noise", (request(ECHO), b"noise")),
        (b"noise" + request(ECHO) + request(ECHO), (b"noise", request(ECHO), request(ECHO))),
        # A frame that another one interrupts stays as it is.
        (b"\x12\x07" + request(ECHO), (b"\x12\x07" + request(ECHO),)),
    ],
)
def test_streams_are_taken_apart_between_frames(segment, pieces):
    rules = Rules(Claims(mapped=True, functions=c.BUILTINS))
    assert rules.apart((b"\x12\x07", segment)) == (b"\x12\x07", *pieces)
    assert rules.due(pieces) == rules.due((segment,))
    assert Rules(rules.claims, held=4096).apart((segment,)) == (segment,)


def test_a_difference_is_told_in_words():
    due = [Expected(7, c.ECHO, b"x")]
    right, sif = Frame(c.SOF, 7, c.ECHO, b"x"), Frame(c.SOS, 0, 1, b"")
    assert difference([sif, right, sif], due) == ""
    assert "code 0xBA, 1 payload bytes [79] came instead" in difference(
        [Frame(c.SOF, 7, c.ECHO, b"y")], due
    )
    assert difference([], due).startswith("nothing came instead")
    assert "where nothing more was due" in difference([right, right], due)
    assert "J2A-FRAME-010" in difference([right, Skipped(1)], due)
    assert "checksum is wrong" in difference([FrameError("checksum", c.SOF, 7)], due)


class OwnTime:
    """What a tap needs of a transport, with time that is set."""

    url, write_timeout_s, now_s = "own:", None, 0.0

    def clock(self):
        return self.now_s

    def write(self, data):
        self.now_s += 0.001


@pytest.mark.parametrize(
    ("pause_s", "byte_s", "stream"),
    [
        (0.0, 0.0, (b"abcd",)),
        (0.006, 0.0, (b"abcd",)),
        (0.008, 0.0, None),
        (0.020, 0.0, None),
        (0.021, 0.0, (b"ab", b"cd")),
        # What was written before was still on its way when the pause began.
        (0.021, 0.001, None),
        (0.023, 0.001, (b"ab", b"cd")),
    ],
)
def test_the_tap_tells_pauses(pause_s, byte_s, stream):
    link = OwnTime()
    tap = Tap(link)
    tap.write(b"before")
    tap.clear()
    tap.write(b"ab")
    link.now_s += pause_s
    tap.write(b"cd")
    assert tap.sent == b"abcd"
    assert tap.stream(byte_s) == stream


# ---------------------------------------------------------------------- theory


@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    # From the formula of Wilson (1927), and the examples of Newcombe (1998), table I.
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_the_wilson_interval(hits, of, low, high):
    assert wilson(hits, of) == pytest.approx((low, high), abs=5e-5)


def test_no_sample_excludes_nothing():
    assert wilson(0, 0) == (0.0, 1.0)
    assert Share().agrees(Share(1000, 1000))


def test_shares_agree_when_they_may_be_the_same():
    assert Share(100, 10).agrees(Share(4000, 480))
    assert not Share(1000, 100).agrees(Share(4000, 40))


def two_flips(random, wire):
    number = int.from_bytes(wire, "little")
    for bit in random.sample(range(8 * len(wire)), 2):
        number ^= 1 << bit
    return number.to_bytes(len(wire), "little")


def two_replaced(random, wire):
    data = bytearray(wire)
    for at in random.sample(range(len(wire)), 2):
        data[at] ^= random.randrange(1, 256)
    return bytes(data)


def burst(random, wire):
    bits = random.randint(9, 16)
    pattern = 1 | random.getrandbits(bits - 2) << 1 | 1 << bits - 1
    number = int.from_bytes(wire, "little") ^ pattern << random.randrange(8 * len(wire) - bits + 1)
    return number.to_bytes(len(wire), "little")


def swapped(random, wire):
    at = random.randrange(1, len(wire) - 1)
    return wire[:at] + wire[at + 1 : at + 2] + wire[at : at + 1] + wire[at + 2 :]


@pytest.mark.parametrize(
    ("damage", "low", "high"),
    [(two_flips, 0.08, 0.125), (two_replaced, 0.0, 0.01), (burst, 0.0, 0.01), (swapped, 0.78, 1.0)],
)
def test_what_the_checksum_cannot_see(damage, low, high):
    """The shares of docs/conformance/faults.md, for exactly one damage in each frame."""
    random = Random(5)
    missed = of = 0
    while of < 2000:
        frame = Frame(c.SOF, random.randrange(256), ECHO, random.randbytes(32))
        wire = encode(frame)
        if (received := damage(random, wire)) == wire:
            continue
        of += 1
        missed += any(isinstance(e, Frame) and e != frame for e in decode(received))
    assert low <= missed / of <= high


# ---------------------------------------------------------------------- shrinking


def test_what_fails_is_made_short_and_plain():
    asked = []

    def fails(stream):
        asked.append(stream)
        data = b"".join(stream)
        return 0x7D in data and data[-1:] == b"\xff"

    data = bytes(range(256)) * 4
    assert shrink((data,), fails) == (b"\x7d\xff",)
    assert len(asked) < 400
    assert len(asked) == len(set(asked))


def test_pauses_are_left_out_unless_they_matter():
    stream = (b"abc", b"def", b"ghi")
    assert shrink(stream, lambda s: b"e" in b"".join(s)) == (b"e",)
    assert shrink(stream, lambda s: len(s) > 1) == (b"\0", b"\0")


def test_what_cannot_be_shorter_stays():
    assert shrink((b"\x00",), lambda s: s == (b"\x00",)) == (b"\x00",)


# ---------------------------------------------------------------------- vectors


@pytest.mark.parametrize(
    "stream",
    [
        (b"\x12\x00\x00\x00\x00",),
        (b"noise",),
        (b"\xed\x01",),
        (b"\x12\x07", b"\x00"),
        (request(6) + request(ECHO, b"x"), b"\x12\x07"),
    ],
)
def test_a_vector_is_one_of_the_specification(tmp_path, stream):
    path = tmp_path / "vector.json"
    _vectors.save(path, stream, "what it shows", RULES)
    saved = json.loads(path.read_text("utf-8"))
    jsonschema.validate(saved, vectors.schema())
    assert saved["kind"] == ("stream" if len(stream) == 1 else "scenario")
    assert list(_vectors.load(path).values()) == [stream]


def test_golden_vectors_can_be_loaded(tmp_path):
    tests = vectors.load("stream")
    path = tmp_path / "stream.json"
    path.write_text(json.dumps({"kind": "stream", "tests": tests}), "utf-8")
    assert [(s.hex(),) for (s,) in _vectors.load(path).values()] == [(t["stream"],) for t in tests]


def test_of_scenarios_those_of_raw_bytes_are_loaded(tmp_path):
    steps = [{"raw": "1207"}, {"pause_ms": 5}, {"raw": "04"}, {"pause_ms": 30}, {"raw": "00"}]
    other = [{"send": {"seq": 1, "opcode": 4, "payload": ""}}]
    tests = [{"id": "one", "steps": steps}, {"id": "two", "steps": other}]
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps({"kind": "scenario", "tests": tests}), "utf-8")
    assert _vectors.load(path) == {"one": (b"\x12\x07\x04", b"\x00")}


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"kind": "stream", "tests": []}', '{"kind": "frame", "tests": [1]}']
)
def test_what_is_no_file_of_streams(tmp_path, text):
    path = tmp_path / "vector.json"
    path.write_text(text, "utf-8")
    with pytest.raises(HarnessError, match="vector"):
        _vectors.load(path)


def test_a_vector_that_cannot_be_saved(tmp_path):
    with pytest.raises(HarnessError, match="cannot be saved"):
        _vectors.save(tmp_path / "no" / "folder", (b"x",), "", RULES)
