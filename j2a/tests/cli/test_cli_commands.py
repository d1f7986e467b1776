"""Every command, against the demo device in Python and the demo firmware."""

import io
import json
import struct
import sys

import pytest
from j2a_spec.constants import (
    BUILTINS,
    ECHO,
    FLAG_LAST,
    FLAG_WRITE,
    GET_INTERFACE,
    MAX_PAYLOAD,
)
from j2a_spec.plural import counted

import j2a
from j2a.cli import main

from .conftest import files_of

OWN = ["getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns"]
OWN += ["divide", "echoNumbers", "echoShapes", "echoWords", "echoFirst"]


def opcode_of(url, name):
    """Return the opcode of a function of a device."""
    with j2a.connect(url) as board:
        return int(board.functions[name])


@pytest.fixture(params=["demo", "firmware"])
def url(request):
    """A device with the demo functions, in Python and in C."""
    return request.getfixturevalue(request.param)


# ---------------------------------------------------------------------- info, props


def test_info(run, url):
    result = run("info", url)
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0].split(maxsplit=1) == ["name", "J2A demo"]
    line = f"{opcode_of(url, 'add'):5}  add"
    typed = "(a i32, b i32) i32 !idempotent # Adds two numbers."
    assert line in lines or (line + typed in lines and "  counter 32 (count u32)" in result.out)
    assert any(line.split() == ["j2a.spec", "1.1"] for line in lines)
    assert "frames received" in lines[-1]


def test_info_as_json(run, url):
    result = run("info", url, "--json")
    facts = json.loads(result.out)
    assert facts["url"] == url
    assert facts["name"] == "J2A demo"
    assert facts["spec"] == "1.1"
    assert facts["rxbuf"] == 4096
    assert facts["room"] == 255
    built_in = (*BUILTINS, GET_INTERFACE) if facts["interface"] else BUILTINS
    names = [*built_in, *OWN]
    assert facts["functions"] == {name: opcode for opcode, name in enumerate(names)}
    if facts["interface"]:
        functions = facts["interface"]["functions"]
        assert [(one["opcode"], one["name"]) for one in functions] == list(enumerate(names))
        add = functions[names.index("add")]
        assert (add["signature"], add["idempotent"]) == ("(a i32, b i32) i32", True)
        assert add["doc"] == "Adds two numbers."
    assert facts["properties"]["serial"]
    assert facts["counters"]["frames_sent"] == facts["counters"]["frames_received"] >= 2


def test_info_of_a_device_that_tells_nothing(run, fake, wire):
    reply, _ = wire
    url = fake(lambda request: reply(request.seq, 0xF0, b"\x01\x00"))
    result = run("info", url)
    assert result.code == 0
    assert "does not say" in result.out
    assert "it has no function map; call by opcode" in result.out
    facts = json.loads(run("info", url, "--json").out)
    assert facts["functions"] == facts["properties"] == {}
    assert (facts["name"], facts["spec"], facts["rxbuf"]) == (None, "1.0", None)
    assert facts["room"] == 255


def test_props(run, url):
    lines = run("props", url).out.splitlines()
    assert ["name", "J2A", "demo"] in [line.split() for line in lines]
    assert json.loads(run("props", url, "--json").out)["j2a.spec"] == "1.1"
    assert run("props", url, "name").out == "J2A demo\n"
    assert json.loads(run("props", url, "name", "--json").out) == "J2A demo"


def test_a_property_that_is_not_there(run, url):
    result = run("props", url, "colour")
    assert (result.code, result.out) == (2, "")
    assert "no property 'colour'" in result.err and "j2a.spec" in result.err


# ---------------------------------------------------------------------- call


def test_call_by_name_and_by_opcode(run, url):
    opcode = opcode_of(url, "add")
    for function in ("add", str(opcode), f"0x{opcode:02X}"):
        result = run("call", url, function, "i32:40", "i32:2")
        assert (result.code, result.err) == (0, "")
        assert result.out.splitlines() == ["code     0x00", "payload  2a 00 00 00"]


def test_values_go_to_a_described_function(run, demo):
    assert run("call", demo, "add", "40", "2").out == "42\n"
    assert run("call", demo, "add", "0x28", "-42").out == "-2\n"
    assert run("call", demo, "delay", "1").out == ""
    assert int(run("call", demo, "getTime").out) >= 0
    facts = json.loads(run("call", demo, "add", "40", "2", "--json").out)
    assert facts.pop("round_trip_s") >= 0
    assert facts == {"function": "add", "code": 0, "ok": True, "result": 42}
    raw = "code     0x00\npayload  2a 00 00 00\n"
    assert run("call", demo, "add", "28000000", "02000000", "--bytes").out == raw
    assert run("call", demo, "add", "i32:40", "02000000").out == raw
    assert run("call", demo, str(opcode_of(demo, "add")), "28000000", "02000000").out == raw


def test_a_time_limit_holds_whatever_the_device_says(run, demo):
    result = run("call", demo, "delay", "1500", "--timeout", "0.2")
    assert result.code == 4
    assert run("call", demo, "delay", "1100").code == 0  # which is slow, as the device says


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("40",), "add(a i32, b i32) i32 takes 2 values, not 1"),
        (("40", "x"), "'x' is no value of b i32: write a whole number"),
        (("40", "2147483648"), "b is an integer of -2147483648 to 2147483647"),
    ],
)
def test_values_that_do_not_fit(run, demo, words, message):
    result = run("call", demo, "add", *words)
    assert (result.code, result.out) == (2, "")
    assert message in result.err


def test_elements_of_an_array_as_words_of_their_own(run, demo):
    result = run("call", demo, "echoShapes", "slow", "1,2", "1", "2", "3", "note")
    assert result.code == 2
    assert "takes 4 values, not 6; an array is one word, such as 1,2,3" in result.err
    result = run("call", demo, "add", "1", "2", "3")
    assert result.err.endswith("takes 2 values, not 3\n")


@pytest.mark.parametrize("words", [(), ("40", "2"), ("hello",)])
def test_a_name_that_is_not_known_is_told_first(run, demo, words):
    result = run("call", demo, "ad", *words)
    assert (result.code, result.out) == (2, "")
    assert "no function 'ad'" in result.err and "add" in result.err


def test_values_of_structures_and_numbers_that_do_not_fit(run, demo):
    result = run("call", demo, "echoShapes", "slow", "1", "1,2,3", "note")
    assert "write its fields, x,y" in result.err
    result = run("call", demo, "echoShapes", "slow", "abc,2", "1,2,3", "note")
    assert "write a number, such as 1.5" in result.err
    assert run("call", demo, "echoShapes", "slow", "--", "-1,2", "-1,2,3", "note").code == 0
    result = run("call", demo, "echoShapes", "-2", "-1e2,-2", "-1,2,3", "note", "--json")
    assert json.loads(result.out)["result"]["place"] == {"x": -100.0, "y": -2}


def test_options_may_stand_between_the_words(run, url):
    assert run("call", url, "add", "i32:-4", "--as", "i32", "i32:1").out == "-3\n"
    assert run("call", url, "--as", "i32", "add", "i32:-4,1").out == "-3\n"


def test_call_as_json(run, url):
    facts = json.loads(run("call", url, "a2jEcho", "str:hi", "--json", "--as", "u8*").out)
    assert facts.pop("round_trip_s") > 0
    assert facts == {
        "function": "a2jEcho",
        "code": ECHO,
        "ok": True,
        "payload": "6869",
        "text": "hi",
        "values": [0x68, 0x69],
    }


def test_a_long_reply_is_dumped(run, url):
    out = run("call", url, "a2jEcho", "str:" + "a" * MAX_PAYLOAD).out.splitlines()
    assert out[1] == "payload  255 bytes"
    assert len(out) == 2 + 16
    assert out[-1].endswith("|" + "a" * 15 + "|")


def test_raw_output_is_the_payload_alone(url, capsysbinary):
    assert main(["call", url, "a2jEcho", "12ed7d00ff", "--raw"]) == 0
    assert capsysbinary.readouterr().out == b"\x12\xed\x7d\x00\xff"


def test_payload_from_standard_input(run, url, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(struct.pack("<ii", 5, 6))))
    assert run("call", url, "add", "-", "--as", "i32").out == "11\n"


def test_a_function_that_fails(run, url):
    result = run("call", url, "add", "i32:1")
    assert (result.code, result.out) == (1, "code     0xFF\n")
    assert result.err == "j2a: add failed (code 0xFF)\n"
    result = run("call", url, "ret", "ff", "--json")
    assert result.code == 1
    assert json.loads(result.out)["ok"] is False


def test_a_code_of_the_functions_own_is_no_failure(run, url):
    result = run("call", url, "ret", "ef")
    assert (result.code, result.out) == (0, "code     0xEF\n")


def test_a_reply_that_cannot_be_decoded_is_still_shown(run, url):
    result = run("call", url, "a2jEcho", "010203", "--as", "u16")
    assert result.code == 1
    assert "01 02 03" in result.out
    assert "3 bytes cannot be read as u16" in result.err
    result = run("call", url, "a2jEcho", "010203", "--as", "u16", "--json")
    assert result.code == 1
    assert "values" not in json.loads(result.out)


def test_what_the_device_refuses(run, url):
    result = run("call", url, "99")
    assert (result.code, result.out) == (5, "")
    assert "0xF0" in result.err
    result = run("call", url, "store")
    assert result.code == 5
    assert "j2a write" in result.err


def test_an_unknown_name_brings_the_ones_near_it(run, url):
    result = run("call", url, "getime")
    assert (result.code, result.out) == (2, "")
    assert "getTime" in result.err


def test_no_reply_in_time(run, url):
    result = run("call", url, "delay", "u16:1500", "--timeout", "0.2")
    assert result.code == 4
    assert "within 0.2 s" in result.err


# ---------------------------------------------------------------------- read, write


@pytest.mark.parametrize("size", [0, 1, 249, 250, 70_000])
def test_write_and_read_back(run, url, tmp_path, size):
    # The firmware is a process of its own for each command, so it has to be one command.
    source = tmp_path / "source"
    source.write_bytes(bytes(index * 7 & 0xFF for index in range(size)))
    result = run("write", url, "store", f"@{source}", "--verify")
    assert (result.code, result.out) == (0, "")
    assert f"{counted(size, 'byte')} written to store" in result.err
    assert result.err.endswith("verified\n")
    assert "\r" not in result.err, "a progress bar without a terminal"


def test_read_into_a_file_and_to_standard_output(demo, tmp_path, capsysbinary):
    target = tmp_path / "target"
    data = bytes(range(256)) * 3
    (tmp_path / "source").write_bytes(data)
    assert main(["write", demo, "store", f"@{tmp_path / 'source'}"]) == 0
    assert main(["read", demo, "store", "-o", str(target)]) == 0
    assert target.read_bytes() == data
    capsysbinary.readouterr()
    assert main(["read", demo, str(opcode_of(demo, "store"))]) == 0
    out, err = capsysbinary.readouterr()
    assert (out, err) == (data, b"")


def test_a_write_of_what_was_read_that_fails_leaves_the_file(run, demo, tmp_path, monkeypatch):
    target = tmp_path / "target"
    target.write_bytes(b"old")
    target.chmod(0o640)
    assert run("write", demo, "store", "str:hello").code == 0
    with files_of(2):
        result = run("read", demo, "store", "-o", target)
    assert (result.code, result.out, target.read_bytes()) == (2, "", b"old")
    assert f"cannot write {target}: File too large" in result.err
    assert [one.name for one in tmp_path.iterdir()] == ["target"]
    assert run("read", demo, "store", "-o", target).code == 0
    assert target.read_bytes() == b"hello"
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(("kept", "where"), [(b"hxllo", 1), (b"hel", 3), (b"hello!", 5)])
def test_data_that_comes_back_different(run, fake, wire, kept, where):
    reply, _ = wire

    def answer(request):
        if request.opcode != 1:
            return reply(request.seq, 0xF0)
        is_write = request.payload[1] & FLAG_WRITE
        header = bytes([0, FLAG_LAST, 0, 0, 0, 0])
        return reply(request.seq, 0, header if is_write else header + kept)

    result = run("write", fake(answer), "8", "str:hello", "--verify")
    assert result.code == 1
    assert f"differs from byte {where} on" in result.err
    assert "verified" not in result.err


def test_a_write_that_the_function_refuses(run, url):
    result = run("write", url, "a2jGetProperties", "str:x")
    assert result.code == 1
    assert "0xFF" in result.err


def test_a_read_that_fails_leaves_the_file(run, url, tmp_path):
    target = tmp_path / "target"
    target.write_bytes(b"old")
    assert run("read", url, "add", "-o", str(target)).code == 5
    assert run("read", url, "nope", "-o", str(target)).code == 2
    result = run("read", url, "a2jGetProperties", "--max-bytes", "3", "-o", str(target))
    assert result.code == 5
    assert result.err == (
        "j2a: a2jGetProperties: the device sends more than 3 bytes; --max-bytes takes more\n"
    )
    assert target.read_bytes() == b"old"


def test_a_file_that_cannot_be_written_is_refused_first(run, tmp_path):
    for target in (tmp_path, tmp_path / "no" / "file"):
        result = run("read", "tcp://127.0.0.1:1", "store", "-o", str(target))
        assert result.code == 2
        assert "cannot write" in result.err


# ---------------------------------------------------------------------- echo


def test_echo(run, url):
    result = run("echo", url, "--count", "20", "--size", "255")
    assert result.code == 0
    assert "20 of 20 echoes correct" in result.out
    assert "5100 bytes each way" in result.out
    assert "median" in result.out


def test_echo_of_all_lengths(run, url):
    result = run("echo", url, "--all-lengths", "--json", "--timeout", "20")
    facts = json.loads(result.out)
    assert result.code == 0
    assert facts["sent"] == facts["wanted"] == facts["correct"] == 2048
    assert facts["payload_bytes"] == 8 * sum(range(256))
    times = facts["round_trip_s"]
    assert 0 < times["min"] <= times["median"] <= times["p99"] <= times["max"]
    assert facts["counters"]["checksum_errors"] == 0


def test_a_device_with_little_room(run, small):
    lines = [line.split()[:2] for line in run("info", small).out.splitlines()]
    assert ["room", "48"] in lines
    facts = json.loads(run("echo", small, "--count", "8", "--json").out)
    assert (facts["correct"], facts["payload_bytes"]) == (8, 8 * 48)
    facts = json.loads(run("echo", small, "--all-lengths", "--json").out)
    assert facts["wanted"] == facts["correct"] == 49 * 8
    assert json.loads(run("echo", small, "--many", "1000", "--json").out)["correct"] == 1
    result = run("echo", small, "--size", "49")
    assert result.code == 2
    assert "the payload has 49 bytes, but the device has room for 48 (j2a.room)" in result.err


@pytest.mark.parametrize("size", [0, 1000])
def test_echo_of_one_long_transfer(run, url, size):
    facts = json.loads(run("echo", url, "--many", str(size), "--json").out)
    assert (facts["correct"], facts["payload_bytes"], facts["round_trip_s"]) == (1, size, None)


def test_a_lossy_link_is_reported_and_not_hidden(run, demo):
    lossy = f"faults:seed=5,flip=0.002:{demo}"
    result = run("echo", lossy, "--count", "30", "--timeout", "0.2", "--json")
    facts = json.loads(result.out)
    assert result.code in (4, 5)
    assert 0 < facts["correct"] < facts["sent"]
    assert facts["sent"] - facts["correct"] == sum(facts["failures"].values())


def test_a_wrong_echo_is_a_mismatch(run, fake, wire):
    reply, _ = wire
    names = b"".join(name.encode() + b"\0" for name in BUILTINS)

    def answer(request):
        if request.opcode == 0:
            return reply(request.seq, 0, names)
        return reply(request.seq, ECHO, request.payload[:-1] + b"\0")

    result = run("echo", fake(answer), "--count", "8", "--size", "3")
    assert result.code == 1
    assert "0 of 8 echoes correct" in result.out
    assert "8 failed: came back different" in result.out


def test_a_silent_device_ends_the_test_early(run, fake, wire):
    reply, _ = wire
    names = b"".join(name.encode() + b"\0" for name in BUILTINS)
    url = fake(lambda request: reply(request.seq, 0, names) if request.opcode == 0 else b"")
    result = run("echo", url, "--timeout", "0.05")
    assert result.code == 4
    assert "0 of 5 echoes correct" in result.out
    assert "95 of 100 were not sent" in result.out
    assert "5 failures in a row" in result.err


# ---------------------------------------------------------------------- watch, debug


def test_watch(run, url):
    result = run("watch", url, "--call", "sifPeriod u16:5", "--count", "3")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert [line.split()[1:5] for line in lines] == [
        ["opcode", "32", "seq", str(seq)] for seq in range(3)
    ]
    assert lines[2].endswith("  counter(count=2)")


def test_watch_takes_values_and_names(run, url):
    calls = ["--call", "sif 21 07", "--call", "sifPeriod 5"]
    result = run("watch", url, "counter", *calls, "--count", "2", "--json")
    sifs = [json.loads(line) for line in result.out.splitlines()]
    assert [sif["sif"] for sif in sifs] == ["counter"] * 2
    assert [sif["values"] for sif in sifs] == [{"count": 0}, {"count": 1}]
    assert run("watch", url, "--call", "sifPeriod soon").code == 2
    assert run("watch", url, "--call", "divide 1 0").code == 1
    result = run("watch", url, "--call", "sifPriod 500")
    assert (result.code, result.out) == (2, "")
    assert "no function 'sifPriod'; did you mean sifPeriod or sif?" in result.err
    result = run("watch", url, "timer")
    assert (result.code, result.out) == (2, "")
    assert "describes no SIF or sensor 'timer'; it has: counter; give its opcode" in result.err
    assert "sensor 'countr'; did you mean counter?" in run("watch", url, "countr").err


def test_watch_shows_bytes_that_are_not_as_described(run, url):
    result = run("watch", url, "--call", "sif 20 07", "--count", "1")
    assert result.code == 0
    assert result.out.rstrip().endswith("  07")
    assert "SIF 0: " in result.err
    facts = json.loads(run("watch", url, "--call", "sif 20 07", "--count", "1", "--json").out)
    assert (facts["payload"], facts["error"]["type"]) == ("07", "PayloadMismatchError")
    assert "values" not in facts


def test_watch_as_json_is_one_object_per_line(run, url):
    result = run(
        *("watch", url, "0x20", "--call", "sif 07 str:hello", "--call", "sifPeriod u16:5"),
        *("--count", "3", "--json", "--as", "u32"),
    )
    sifs = [json.loads(line) for line in result.out.splitlines()]
    assert [sif["opcode"] for sif in sifs] == [0x20] * 3
    assert [sif["values"] for sif in sifs] == [[0], [1], [2]]
    assert [sif["missed"] for sif in sifs] == [0, 0, 0]
    assert sifs[0]["payload"] == "00000000"
    assert sifs[0]["time"] <= sifs[1]["time"] <= sifs[2]["time"]


def test_watch_shows_text_and_any_opcode(run, url):
    result = run("watch", url, "--call", "sif ff str:hello", "--count", "1")
    assert result.out.rstrip().endswith('68 65 6c 6c 6f  "hello"')
    assert "opcode 255" in result.out


def test_watch_reports_gaps(run, fake, wire):
    reply, sif = wire
    burst = sif(250, 1) + sif(2, 1, b"\x12\xed") + sif(3, 1) + sif(5, 1)

    def answer(request):
        return reply(request.seq, 0) + burst if request.opcode == 9 else reply(request.seq, 0xF0)

    url = fake(answer)
    result = run("watch", url, "--call", "9", "--count", "4")
    assert [line.strip() for line in result.out.splitlines() if "missed" in line] == [
        "7 SIFs missed",
        "1 SIF missed",
    ]
    out = run("watch", url, "--call", "9", "--count", "4", "--json").out
    assert [json.loads(line)["missed"] for line in out.splitlines()] == [0, 7, 0, 1]


def test_watch_that_sees_too_few(run, url):
    result = run("watch", url, "--count", "2", "--duration", "0.2")
    assert (result.code, result.out) == (4, "")
    assert "0 of 2 SIFs" in result.err
    assert run("watch", url, "--duration", "0.2").code == 0


def test_watch_whose_call_fails(run, url):
    assert run("watch", url, "--call", "sif").code == 1
    assert run("watch", url, "--call", "nope").code == 2
    assert run("watch", url, "--call", "'").code == 2


def test_watch_calls_the_last_function_at_the_end(run, demo):
    sending, stop = ("--call", "sifPeriod u16:5"), ("--then", "sifPeriod u16:0")
    assert run("watch", demo, *sending, "--count", "2").code == 0
    assert run("watch", demo, "--count", "2").code == 0, "the device goes on without --then"
    for ending in (("--count", "2"), ("--call", "sif")):
        assert run("watch", demo, *sending, *ending, *stop).code == (ending[0] == "--call")
        assert run("watch", demo, "--duration", "0.2").out == ""


def test_watch_whose_last_function_fails(run, demo):
    result = run("watch", demo, "--duration", "0.1", "--then", "sif")
    assert (result.code, result.err) == (1, "j2a: sif failed (code 0xFF)\n")
    assert "as in --then" in run("watch", demo, "--then", "'").err


def test_debug(run, demo):
    run("call", demo, "ret", "07")
    run("call", demo, "ret", "2a")
    assert run("debug", demo).out == "ret 0x07\nret 0x2A\n"
    assert run("debug", demo).out == ""
