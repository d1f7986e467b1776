"""The specification as code: grammars, oracle, requirements, vectors and generated files."""

import json
import random
from pathlib import Path

import construct
import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec import constants as c
from j2a_spec import requirements, vectors
from j2a_spec.generate import outputs, spec_text, stale
from j2a_spec.generate.frames import SPECIAL
from j2a_spec.grammar import GRAMMARS, checksum
from j2a_spec.oracle import Event, Frame, FrameError, Incomplete, Skipped, decode, encode, stuff
from j2a_spec.requirements import load, superseded

ROOT = Path(__file__).parents[2]

FRAMES = st.builds(
    Frame,
    start=st.sampled_from(sorted(c.MARKERS)),
    seq=st.integers(0, 255),
    opcode=st.integers(0, 255),
    payload=st.binary(max_size=255),
)


def test_the_example_of_the_thesis_has_the_corrected_checksum() -> None:
    frame = Frame(c.SOF, 0x02, 0x11, bytes((0x12, 0x12, 0x13, 0x7D)))
    assert encode(frame) == bytes.fromhex("12 02 11 04 7D 11 7D 11 13 7D 7C 15")


def test_the_largest_frame_has_518_bytes() -> None:
    wire = encode(Frame(c.SOF, 0x12, 0x12, b"\x12" * 255))
    assert len(wire) == c.MAX_WIRE == 518


@given(FRAMES)
def test_what_is_encoded_decodes_to_itself(frame: Frame) -> None:
    assert decode(encode(frame)) == [frame]
    assert not c.MARKERS & set(encode(frame)[1:])
    assert len(encode(frame)) <= c.MAX_WIRE


@given(FRAMES)
def test_the_oracle_and_the_grammar_tell_the_same_of_a_frame(frame: Frame) -> None:
    body = GRAMMARS["packet"].build(vars_of(frame))
    assert encode(frame) == bytes((frame.start,)) + stuff(body)
    parsed = GRAMMARS["packet"].parse(body)
    assert frame == Frame(frame.start, parsed.seq, parsed.opcode, parsed.payload)
    broken = body[:-1] + bytes((body[-1] ^ 1,))
    with pytest.raises(construct.ChecksumError):
        GRAMMARS["packet"].parse(broken)
    expected = [FrameError("checksum", frame.start, frame.seq)]
    assert decode(bytes((frame.start,)) + stuff(broken)) == expected


def test_the_meaning_of_a_stream_byte_by_byte() -> None:
    """What each byte does to a receiver, told without pieces: the same as the oracle says."""
    rng = random.Random(7)
    special = bytes((c.SOF, c.SOS, c.ESC, 0xFF, 0, 1, 2, c.SOF - 1, c.SOS - 1, c.ESC - 1))
    for _ in range(5000):
        stream = bytes(rng.choice(special) for _ in range(rng.randrange(20)))
        if rng.random() < 0.5:
            payload = bytes(rng.choice(special) for _ in range(rng.randrange(9)))
            stream += encode(Frame(c.SOF, rng.randrange(256), 1, payload))[: rng.randrange(30)]
            stream += bytes(rng.choice(special) for _ in range(rng.randrange(5)))
        assert decode(stream) == by_the_byte(stream), stream.hex(" ")


def by_the_byte(stream: bytes) -> list[Event]:
    events: list[Event] = []
    start: int | None = None
    body = bytearray()
    skipped, escaped = 0, False
    for byte in stream:
        if byte not in c.MARKERS and start is None:
            skipped += 1
            continue
        if skipped:
            events.append(Skipped(skipped))
            skipped = 0
        seq = body[0] if body else None
        if byte in c.MARKERS:
            if start is not None:
                events.append(FrameError("marker", start, seq))
            start, escaped = byte, False
            body.clear()
        elif byte == c.ESC and not escaped:
            escaped = True
        elif escaped and byte == 0xFF:
            assert start is not None
            events.append(FrameError("escape", start, seq))
            start = None
        else:
            body.append(byte + 1 if escaped else byte)
            escaped = False
            if len(body) > c.HEADER and len(body) == c.HEADER + body[2] + 1:
                assert start is not None
                fields = body[0], body[1], bytes(body[c.HEADER : -1])
                good = checksum(*fields) == body[-1]
                events.append(
                    Frame(start, *fields) if good else FrameError("checksum", start, body[0])
                )
                start = None
    if skipped:
        events.append(Skipped(skipped))
    if start is not None:
        events.append(Incomplete(start, body[0] if body else None))
    return events


@given(FRAMES, st.data())
def test_one_flipped_bit_is_never_a_good_frame(frame: Frame, data: st.DataObject) -> None:
    # The flip is made before stuffing: on the wire it may also hit an escape.
    body = bytearray(GRAMMARS["packet"].build(vars_of(frame)))
    index = data.draw(st.integers(0, len(body) - 1))
    body[index] ^= 1 << data.draw(st.integers(0, 7))
    events = decode(bytes((frame.start,)) + stuff(bytes(body)))
    if index != 2:  # a flipped length moves the checksum to another place
        assert events == [FrameError("checksum", frame.start, body[0])]
    assert frame not in events


def vars_of(frame: Frame) -> dict[str, object]:
    return {"seq": frame.seq, "opcode": frame.opcode, "payload": frame.payload}


@given(st.binary(max_size=600), FRAMES)
def test_a_good_frame_after_anything_that_ends_is_found(noise: bytes, frame: Frame) -> None:
    assert decode(noise + encode(frame))[-1] == frame


@given(st.lists(st.one_of(st.binary(max_size=30), FRAMES.map(encode)), max_size=8).map(b"".join))
def test_events_account_for_every_start_byte(stream: bytes) -> None:
    begun = [e for e in decode(stream) if not isinstance(e, Skipped)]
    assert len(begun) == sum(byte in c.MARKERS for byte in stream)
    assert all(not isinstance(e, Incomplete) for e in begun[:-1])


@pytest.mark.parametrize(
    "frame",
    [Frame(0x13, 0, 0), Frame(c.SOF, 256, 0), Frame(c.SOF, 0, -1), Frame(c.SOF, 0, 0, b"x" * 256)],
)
def test_impossible_frames_cannot_be_encoded(frame: Frame) -> None:
    with pytest.raises(ValueError):
        encode(frame)


def test_generated_files_are_current() -> None:
    assert stale(ROOT) == {}


def test_a_file_that_is_missing_or_changed_is_stale(tmp_path: Path) -> None:
    texts = {tmp_path / path.relative_to(ROOT): text for path, text in outputs(ROOT).items()}
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    assert stale(tmp_path) == {}
    missing = tmp_path / "firmware/core/j2a_const.h"
    missing.unlink()
    changed = tmp_path / "spec/j2a_spec/vectors/frame.json"
    changed.write_text(texts[changed] + "\n", "utf-8")
    assert stale(tmp_path) == {path: texts[path] for path in (missing, changed)}


def test_generation_is_deterministic() -> None:
    assert outputs(ROOT) == outputs(ROOT)


@pytest.mark.parametrize("kind", vectors.KINDS)
def test_vector_files_obey_the_schema(kind: vectors.Kind) -> None:
    parsed = json.loads((ROOT / f"spec/j2a_spec/vectors/{kind}.json").read_text("utf-8"))
    validator = jsonschema.Draft202012Validator(vectors.schema())
    assert not list(validator.iter_errors(parsed))
    tests = parsed["tests"]
    assert parsed["count"] == len(tests) == len({test["id"] for test in tests})
    named = {name for test in tests for name in test["requirements"]}
    assert named <= set(load())


def test_the_schema_refuses_a_broken_file() -> None:
    parsed = json.loads((ROOT / "spec/j2a_spec/vectors/frame.json").read_text("utf-8"))
    parsed["tests"][0]["wire"] = "1z"
    validator = jsonschema.Draft202012Validator(vectors.schema())
    assert list(validator.iter_errors(parsed))


def test_frame_vectors_mean_what_the_oracle_says() -> None:
    for test in vectors.load("frame"):
        wire = bytes.fromhex(test["wire"])
        if test["result"] == "invalid":
            assert test["frame"] is None
            assert not any(isinstance(e, Frame) for e in decode(wire)), test["id"]
            continue
        frame = Frame(**{**test["frame"], "payload": bytes.fromhex(test["frame"]["payload"])})
        assert decode(wire) == [frame], test["id"]
        assert (encode(frame) == wire) == (test["result"] == "valid"), test["id"]


def test_payload_vectors_mean_what_the_grammars_say() -> None:
    for test in vectors.load("payload"):
        grammar, data = GRAMMARS[test["grammar"]], bytes.fromhex(test["data"])
        if test["result"] == "invalid":
            with pytest.raises(construct.ConstructError):
                grammar.parse(data)
            continue
        parsed = grammar.parse(data)
        assert plain(parsed) == test["value"], test["id"]
        assert (grammar.build(parsed) == data) == (test["result"] == "valid"), test["id"]


def plain(value: object) -> object:
    """Turn what construct parsed into plain JSON values."""
    if isinstance(value, dict):
        return {
            key: plain(item)
            for key, item in value.items()
            if not key.startswith("_") and not isinstance(key, int)
        }
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value.hex() if isinstance(value, bytes) else value


ONE_WAY = {
    "J2A-FRAME-005": "it only widens what is taken",
    "J2A-FRAME-008": "a device is silent; see the scenarios",
    "J2A-FRAME-010": "it forbids bytes outside frames; receivers skip them",
}


def test_every_frame_level_requirement_has_vectors_both_ways() -> None:
    """Both ways: something that is right by it, and something that it makes wrong."""
    right: set[str] = set()
    wrong: set[str] = set()
    for test in vectors.load("frame"):
        if test["result"] != "invalid":
            right |= set(test["requirements"])
        if test["result"] != "valid":
            wrong |= set(test["requirements"])
    for test in vectors.load("stream"):
        kinds = {event["type"] for event in test["events"]}
        right |= set(test["requirements"]) if "frame" in kinds else set()
        wrong |= set(test["requirements"]) if kinds - {"frame"} else set()
    frame_level = {r.id for r in load().values() if r.level == "frame"}
    assert frame_level <= {name for kind in vectors.KINDS for name in named_by(kind)}
    assert frame_level - (right & wrong) == set(ONE_WAY)


def named_by(kind: vectors.Kind) -> set[str]:
    return {name for test in vectors.load(kind) for name in test["requirements"]}


def test_every_special_value_stands_in_every_field() -> None:
    """Marker values, their neighbours and the ends, in requests and in SIFs, in each field."""
    valid = [t for t in vectors.load("frame") if t["result"] == "valid"]
    for start in c.MARKERS:
        frames = [
            Frame(**{**t["frame"], "payload": bytes.fromhex(t["frame"]["payload"])})
            for t in valid
            if t["frame"]["start"] == start
        ]
        bodies = [GRAMMARS["packet"].build(vars_of(frame)) for frame in frames]
        for value in SPECIAL:
            for field in (0, 1, 2, -1):
                assert any(body[field] == value for body in bodies), (start, value, field)
            assert any(value in frame.payload for frame in frames), (start, value)


def test_requirements_stand_in_the_specification_in_order() -> None:
    text = (ROOT / "spec/SPEC.md").read_text("utf-8")
    assert spec_text.fill(text) == text
    for requirement in load().values():
        assert requirement.text in text


def test_a_specification_without_a_requirement_is_refused() -> None:
    text = (ROOT / "spec/SPEC.md").read_text("utf-8")
    with pytest.raises(ValueError, match="J2A-SUM-001"):
        spec_text.fill(text.replace("**J2A-SUM-001**", "J2A-SUM-001"))


def test_what_was_replaced_stays_behind_what_is_in_force() -> None:
    assert {name: r.superseded_by for name, r in superseded().items()} == {
        "J2A-SEQ-002": "J2A-SEQ-008",
        "J2A-DISP-006": "J2A-DISP-009",
        "J2A-SEQ-007": "J2A-SEQ-009",
    }
    assert list(requirements._read()) == [*load(), *superseded()]
    named = {name for kind in vectors.KINDS for name in named_by(kind)}
    assert named & set(superseded()) == set()
    text = (ROOT / "spec/SPEC.md").read_text("utf-8")
    assert "*(Replaced by J2A-SEQ-008.)*" in text[text.index("## Appendix B") :]


def test_each_id_of_an_area_was_given_once_and_none_was_left_out() -> None:
    known = load() | superseded()
    for area in {r.area for r in known.values()}:
        numbers = sorted(int(name[-3:]) for name, r in known.items() if r.area == area)
        assert numbers == list(range(1, len(numbers) + 1)), area


@pytest.mark.parametrize("by", ["J2A-NONE-001", "J2A-SUM-001"])
def test_a_replacement_must_be_in_force(by: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def entry(name: str, **more: str) -> dict[str, str]:
        return {
            "id": name,
            "level": "frame",
            "role": "both",
            "source": "decision",
            "text": "MUST",
            **more,
        }

    entries = [
        entry("J2A-SUM-001", superseded_by="J2A-SUM-002"),
        entry("J2A-SUM-002"),
        entry("J2A-SUM-003", superseded_by=by),
    ]
    monkeypatch.setattr(requirements.tomllib, "loads", lambda _: {"requirement": entries})
    requirements._read.cache_clear()
    try:
        with pytest.raises(ValueError, match=f"J2A-SUM-003: '{by}', which replaces it"):
            load()
    finally:
        monkeypatch.undo()
        requirements._read.cache_clear()


def test_each_group_of_constants_is_shown_once() -> None:
    texts = "".join((ROOT / name).read_text("utf-8") for name in ("spec/SPEC.md", "spec/LINKS.md"))
    for group in {row.group for row in c.TABLE}:
        assert texts.count(f"<!-- table: {group.lower().replace(' ', '-')} -->") == 1, group
