"""Messages of the suite for hosts name what differs."""

import pytest
from j2a_conformance.host._outcomes import Outcome, difference, explain, explain_sifs, spell

LONG = bytes(range(200))
SIFS = [(n, bytes((n,)) * (n % 7)) for n in range(200)]


def joined(sifs):
    return spell(b"".join(bytes((opcode, len(payload))) + payload for opcode, payload in sifs))


@pytest.mark.parametrize(
    ("came", "due", "words"),
    [
        (b"abc", b"abc", ""),
        (b"abd", b"abc", "byte 2 is 0x64, not 0x63"),
        (b"ab", b"abc", "it has 2 bytes, not 3"),
        (LONG[:150] + b"\xff" + LONG[151:], LONG, "byte 150 is 0xFF, not 0x96"),
    ],
)
def test_the_first_byte_that_differs(came, due, words):
    assert difference(came, due).startswith(words)
    assert bool(difference(came, due)) == bool(words)


@pytest.mark.parametrize(
    ("came", "words"),
    [
        (LONG[:7] + b"\x00" + LONG[8:], "byte 7 is 0x00, not 0x07"),
        (LONG[:-1] + b"\x12", "byte 199 is 0x12, not 0xC7"),
        (LONG[:130], "it has 130 bytes, not 200: the end is missing"),
        (LONG[70:], "it has 130 bytes, not 200: the beginning is missing"),
        (LONG[::-1], "more than one byte is another"),
        (LONG + b"x", "it has 201 bytes, not 200"),
        (b"\x00\x02", "byte 1 is 0x02, not 0x01"),
    ],
)
def test_of_long_data_the_byte_is_found_by_its_sum(came, words):
    assert explain(spell(came), LONG).startswith(words)


@pytest.mark.parametrize(
    ("reported", "words"),
    [
        ([], "none was handed over"),
        (SIFS[:17] + SIFS[18:], "SIF 17 of 200 (opcode 0x11, 3 bytes) is missing"),
        (SIFS[:18] + SIFS[17:], "SIF 17 of 200 (opcode 0x11, 3 bytes) came twice"),
        (SIFS[:50], "SIF 50 of 200 (opcode 0x32, 1 bytes) and all behind it are missing"),
        ([SIFS[1], SIFS[0], *SIFS[2:]], "SIF 0 of 200 (opcode 0x00, 0 bytes) came behind"),
        ([*SIFS, (0x77, b"broken")], "a broken SIF was handed over: opcode 0x77, 6 bytes"),
        ([(0, b"x"), (0, b"y")], "byte 1 is 0x01, not 0x00"),
        (SIFS + SIFS, "994 bytes more than are due"),
    ],
)
def test_the_sif_in_question_is_named(reported, words):
    assert explain_sifs(joined(reported), SIFS, [(200, (0x77, b"broken"))]).startswith(words)


@pytest.mark.parametrize(
    ("text", "word", "rest", "fate"),
    [
        ("reply 1 -", "reply", "1 -", ""),
        ("error 243 maybe-executed", "error", "243", "maybe-executed"),
        ("timeout not-sent", "timeout", "", "not-sent"),
        ("lost", "lost", "", ""),
        ("refused it was not-sent", "refused", "it was", "not-sent"),
    ],
)
def test_outcomes_are_taken_apart(text, word, rest, fate):
    outcome = Outcome.parse(text)
    assert (outcome.whole, outcome.word, outcome.rest, outcome.fate) == (text, word, rest, fate)
