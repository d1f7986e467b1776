"""Payload words to bytes, and payloads to values and texts."""

import io
import json
import struct
import sys
from types import SimpleNamespace

import pytest
from j2a_spec.plural import counted

from j2a.cli._exit import UsageError
from j2a.cli._values import Decoder, dump, payload_of, short_hex, text_of


@pytest.mark.parametrize(
    ("words", "payload"),
    [
        ([], b""),
        ([""], b""),
        (["12", "ed"], b"\x12\xed"),
        (["12ED"], b"\x12\xed"),
        (["12 ed"], b"\x12\xed"),
        (["0x12,0XED"], b"\x12\xed"),
        (["12:ed:7d"], b"\x12\xed\x7d"),
        (["u8:255", "i8:-1"], b"\xff\xff"),
        (["u16:500"], b"\xf4\x01"),
        (["U16:0x1f4,0b1,0o7"], b"\xf4\x01\x01\x00\x07\x00"),
        (["i32:-4"], b"\xfc\xff\xff\xff"),
        (["u64:1"], b"\x01" + bytes(7)),
        (["i64:-1"], b"\xff" * 8),
        (["f32:1.5"], b"\x00\x00\xc0\x3f"),
        (["f64:-2"], b"\x00" * 7 + b"\xc0"),
        (["f64:-inf"], b"\x00" * 6 + b"\xf0\xff"),
        (["f32:Infinity"], b"\x00\x00\x80\x7f"),
        (["str:hello: you"], b"hello: you"),
        (["str:é", "00"], b"\xc3\xa9\x00"),
        (["str:"], b""),
        (["hex:12ed"], b"\x12\xed"),
    ],
)
def test_words_become_bytes(words, payload):
    assert payload_of(words) == payload


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("1", "two digits"),
        ("12e", "two digits"),
        ("100x20", "two digits"),  # is no 10 20
        ("0x", "two digits"),  # of a variable of a script that is empty
        ("0x0x12", "two digits"),
        ("hello", "str:hello"),
        ("hex:zz", "two digits"),
        ("u8:256", "from 0 to 255"),
        ("i8:-129", "from -128 to 127"),
        ("u32:-1", "from 0 to 4294967295"),
        ("u8:1.5", "whole number"),
        ("u8:", "whole number"),
        ("f32:x", "a number"),
        ("f32:1e99", "does not fit f32"),
        ("f32:1e400", "does not fit f32"),
        ("f64:-1e400", "does not fit f64"),
        ("u128:1", "known types: u8, i8"),
        ("@/no/such/file", "No such file"),
        ("@", "cannot read"),
        ("@\0", "cannot read"),
    ],
)
def test_a_word_that_cannot_be_read_says_what_can(word, says):
    with pytest.raises(UsageError, match=says):
        payload_of([word])


def test_files_and_standard_input(tmp_path, monkeypatch):
    file = tmp_path / "data"
    file.write_bytes(b"\x00\xff")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\x12\n")))
    assert payload_of([f"@{file}", "-", "01"]) == b"\x00\xff\x12\n\x01"


def test_the_name_of_a_file_without_its_sign_is_recognised(tmp_path, monkeypatch):
    (tmp_path / "firmware.bin").write_bytes(b"x")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="write @firmware"):
        payload_of(["firmware.bin"])


def test_f32_has_for_people_the_digits_that_matter():
    payload = struct.pack("<fd2f", 0.1, 0.1, 0.2, 3.4028234663852886e38)
    values = Decoder("f32,f64,f32*").values(payload)
    assert [str(value) for value in values] == ["0.1", "0.1", "0.2", "3.4028235e+38"]
    assert json.loads(json.dumps(values)) == list(struct.unpack("<fd2f", payload))


@pytest.mark.parametrize(
    ("types", "payload", "values"),
    [
        ("i32", b"\xfc\xff\xff\xff", [-4]),
        ("u8,U16", b"\x01\xf4\x01", [1, 500]),
        ("u16*", b"\x01\x00\x02\x00", [1, 2]),
        ("u16*", b"", []),
        ("u8,u16*", b"\x09\x01\x00", [9, 1]),
        ("f32", b"\x00\x00\xc0\x3f", [1.5]),
        ("u8,str", b"\x01hi\xff", [1, "hi\N{REPLACEMENT CHARACTER}"]),
        ("hex", b"\x12\xed", ["12ed"]),
    ],
)
def test_payloads_are_decoded(types, payload, values):
    assert Decoder(types).values(payload) == values


@pytest.mark.parametrize(
    ("types", "payload"), [("i32", b"123"), ("u8", b"12"), ("u16*", b"1"), ("u16,str", b"1")]
)
def test_a_payload_of_another_size_is_not_decoded(types, payload):
    length = counted(len(payload), "byte")
    with pytest.raises(ValueError, match=f"^{length} cannot be read as"):
        Decoder(types).values(payload)


@pytest.mark.parametrize("types", ["", "i31", "u8,", "str*", "str,u8", "u8*,u8", "*"])
def test_types_that_make_no_sense_are_refused(types):
    with pytest.raises(UsageError, match="--as"):
        Decoder(types)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"hello", '"hello"'),
        (b"a\0b\0", '"a\\0b\\0"'),
        (b"line\r\n\t\\", '"line\\r\\n\\t\\\\"'),
        ("é".encode(), '"é"'),
        (b"", ""),
        (b"A\0\0\0", ""),
        (b"\0A", ""),
        (b"\xff", ""),
        (b"\x1b[2J", ""),
    ],
)
def test_only_what_reads_as_text_is_shown_as_text(data, text):
    assert text_of(data) == text


def test_dump_and_short_hex():
    first, second = dump(bytes(range(0x38, 0x4A)))
    assert first == f"000000  {bytes(range(0x38, 0x48)).hex(' ')}  |89:;<=>?@ABCDEFG|"
    assert second.startswith("000010  48 49 ") and second.endswith("  |HI|")
    assert first.index("|") == second.index("|")
    assert dump(b"") == []
    assert short_hex(b"\x12\xed") == "12 ed"
    assert short_hex(bytes(17)) == " ".join(["00"] * 16) + " ... (17 bytes)"


def test_what_never_ends_is_refused_before_it_fills_the_memory(monkeypatch):
    monkeypatch.setattr("j2a.cli._values._MOST", 2**21)
    with pytest.raises(UsageError, match="'/dev/zero' has more than"):
        payload_of(["@/dev/zero"])


def test_what_does_not_fit_into_memory_is_refused(monkeypatch):
    class Endless:
        def read(self, size):
            raise MemoryError

    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=Endless()))
    with pytest.raises(UsageError, match="standard input does not fit"):
        payload_of(["-"])
