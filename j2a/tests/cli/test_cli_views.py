"""What a link looks like to people: the wire trace and the progress bar."""

import io
import os
import re
import sys
import threading
import time

import j2a_transports
import pytest
from j2a_spec.constants import BUILTINS, SOF, SOS
from j2a_spec.oracle import Frame, encode

import j2a
from j2a.cli._progress import Progress, size_text
from j2a.cli._trace import TracePrinter

WAIT_S = 300  # of a hang: beside other programs some steps took nearly 60 s
MAP = b"a2jGetMapping\0a2jMany\0add\0store\0"


@pytest.fixture
def trace():
    """trace(direction, item) returns the line without its time, "" if nothing is printed."""

    def make(**options):
        stream = io.StringIO()
        printer = TracePrinter(stream=stream, **options)

        def show(direction, item):
            stream.seek(0)
            stream.truncate()
            printer(direction, item)
            return re.sub(r"^ *\d+\.\d{4} ", "", stream.getvalue()).rstrip("\n")

        return show

    return make


def test_frames_are_named_once_the_map_has_passed(trace):
    show = trace()
    add = j2a.Frame(SOF, 5, 2, b"\x01\x02")
    assert show("tx", add) == "> request seq=5   opcode 2 01 02"
    assert show("tx", j2a.Frame(SOF, 6, 0, b"")) == "> request seq=6   a2jGetMapping -"
    assert show("rx", j2a.Frame(SOF, 6, 0, MAP)).startswith("< reply   seq=6   a2jGetMapping code")
    assert show("tx", add) == "> request seq=5   add 01 02"
    assert show("rx", j2a.Frame(SOF, 5, 0xBA, b"hi")) == (
        '< reply   seq=5   add code=0xBA 68 69  "hi"'
    )


def test_replies_that_report_trouble(trace):
    show = trace()
    show("tx", j2a.Frame(SOF, 1, 9, b""))
    assert show("rx", j2a.Frame(SOF, 1, 0xFF, b"")) == (
        "< reply   seq=1   opcode 9 code=0xFF (failed) -"
    )
    show("tx", j2a.Frame(SOF, 2, 9, b""))
    assert show("rx", j2a.Frame(SOF, 2, 0xF3, b"\x04\x00")) == (
        "< error   seq=2   opcode 9 0xF3 wrong checksum, details 04 00"
    )
    assert "(not asked)" in show("rx", j2a.Frame(SOF, 3, 0, b""))


def test_sifs_and_refused_frames(trace):
    show = trace()
    assert show("rx", j2a.Frame(SOS, 7, 32, bytes(20))) == (
        f"< SIF     seq=7   opcode=32  {' '.join(['00'] * 16)} ... (20 bytes)"
    )
    assert show("rx", j2a.FrameError("checksum", SOF, 7)) == (
        "< refused seq=7   frame: wrong checksum"
    )
    assert show("rx", j2a.FrameError("marker", SOS, None)) == (
        "< refused SIF: cut off by the start of another"
    )
    for reason in ("escape", "timeout", "lost"):
        assert "refused" in show("rx", j2a.FrameError(reason, SOF, None))


def test_chunks_are_decoded(trace):
    show = trace()
    show("tx", j2a.Frame(SOF, 0, 0, b""))
    show("rx", j2a.Frame(SOF, 0, 0, MAP))
    write = bytes([3, 3, 249, 0, 0, 0]) + b"abc"
    assert show("tx", j2a.Frame(SOF, 1, 1, write)) == (
        '> request seq=1   a2jMany write store offset=249 last 61 62 63  "abc"'
    )
    assert show("rx", j2a.Frame(SOF, 1, 0, bytes([0xFF, 0, 249, 0, 0, 0]))) == (
        "< reply   seq=1   a2jMany code=0xFF (failed) offset=249 -"
    )
    assert show("tx", j2a.Frame(SOF, 2, 1, bytes([3, 0, 0, 0, 0, 0]))) == (
        "> request seq=2   a2jMany read store offset=0 -"
    )
    assert show("rx", j2a.Frame(SOF, 2, 0xFF, b"")) == (
        "< reply   seq=2   a2jMany code=0xFF (failed) -"
    )


def test_bytes_are_shown_only_when_asked_for(trace):
    assert trace()("tx", b"\x12\x00") == ""
    assert trace(raw=True)("tx", b"\x12\x00") == "> bytes   12 00"
    assert trace(raw=True, is_device=True)("tx", b"\x12\x00") == "< bytes   12 00"


def test_verbose_shows_both_directions(run, demo):
    result = run("call", demo, "add", "i32:1,2", "-v")
    assert result.out == "code     0x00\npayload  03 00 00 00\n"
    assert re.search(r"> request seq=\d+ +add 01 00 00 00 02 00 00 00\n", result.err)
    assert re.search(r"< reply   seq=\d+ +add code=0x00 03 00 00 00\n", result.err)
    assert "bytes" not in re.sub(r"\(\d+ bytes\)", "", result.err)
    assert re.search(r"> bytes   12 ", run("call", demo, "add", "-vv").err)


def test_hosts_of_a_device_that_use_the_same_seq_are_told_apart():
    stream = io.StringIO()
    held, go_on = threading.Event(), threading.Event()
    slow, quick = len(BUILTINS) + 1, len(BUILTINS) + 2  # behind a2jGetInterface
    with j2a.Device(trace=TracePrinter(stream=stream, is_device=True)) as device:

        @device.function
        def hold(payload):
            held.set()
            assert go_on.wait(WAIT_S)

        device.function("quick")(lambda payload: None)
        links = [j2a_transports.pair() for _ in range(2)]
        servers = [threading.Thread(target=device.serve, args=(far,)) for _, far in links]
        for server in servers:
            server.start()
        (first, _), (second, _) = links
        first.write(encode(Frame(SOF, 5, slow, b"")))
        assert held.wait(WAIT_S)
        second.write(encode(Frame(SOF, 5, quick, b"")))
        end = time.monotonic() + WAIT_S
        while f"opcode {quick}" not in stream.getvalue():
            assert time.monotonic() < end
            time.sleep(0.01)
        go_on.set()
        for host in (first, second):
            assert host.read(WAIT_S)
    for server in servers:
        server.join(WAIT_S)
    replies = re.findall(r"< reply   seq=5   (.*) code", stream.getvalue())
    assert sorted(replies) == [f"opcode {slow}", f"opcode {quick}"]


def test_verbose_shows_what_is_refused(run, fake, wire):
    reply, _ = wire
    broken = bytearray(reply(0, 0, b"x"))
    broken[-1] ^= 1
    url = fake(lambda request: bytes(broken) + reply(request.seq, 0xF0, b"\x01\x00"))
    assert "< refused seq=0   frame: wrong checksum\n" in run("info", url, "-v").err


class Terminal(io.StringIO):
    """A standard error that says it is a terminal."""

    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """The time that the progress bar sees; a list with one number."""
    now = [100.0]
    monkeypatch.setattr("j2a.cli._progress.time.monotonic", lambda: now[0])
    return now


def test_progress_on_a_terminal(monkeypatch, clock):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("write store") as progress:
        progress(10, 4096)
        assert sys.stderr.getvalue() == "", "a short transfer draws nothing"
        clock[0] += 1
        progress(1024, 4096)
        assert "write store  [#######......................." in sys.stderr.getvalue()
        assert "25 %  1.0 KiB  1.0 KiB/s  3 s left" in sys.stderr.getvalue()
        drawn = len(sys.stderr.getvalue())
        progress(1025, 4096)
        assert len(sys.stderr.getvalue()) == drawn, "not more often than ten times a second"
        clock[0] += 1
        progress(3 * 2**20)
        assert sys.stderr.getvalue().endswith("\rwrite store  3.0 MiB  1.5 MiB/s\x1b[K")
    assert sys.stderr.getvalue().endswith("\r\x1b[K"), "the line is wiped"


def test_progress_in_time(monkeypatch, clock):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("record", in_seconds=True) as progress:
        clock[0] += 2
        progress(2.4, 8.0, "7 samples")
        drawn = sys.stderr.getvalue()
        assert "record  [#########.....................]  30 %  2 s  7 samples  5 s left" in drawn
        clock[0] += 1
        progress(9.0, 8.0)
        assert "100 %  8 s  0 s left" in sys.stderr.getvalue()
        clock[0] += 1
        progress(9.0)
        assert sys.stderr.getvalue().endswith("\rrecord  9 s\x1b[K")


@pytest.mark.parametrize(
    ("columns", "drawn"),
    [
        (0, "write store  [#######.......................]  25 %  1.0 KiB  1.0 KiB/s  3 s left"),
        (82, "write store  [#######.......................]  25 %  1.0 KiB  1.0 KiB/s  3 s left"),
        (81, "write store  [#######......................]  25 %  1.0 KiB  1.0 KiB/s  3 s left"),
        (53, "write store  [.]  25 %  1.0 KiB  1.0 KiB/s  3 s left"),
        (52, "write store   25 %  1.0 KiB  1.0 KiB/s  3 s left"),
        (30, "write store   25 %  1.0 KiB  "),
        (1, ""),
    ],
)
def test_progress_stays_in_one_line(monkeypatch, clock, columns, drawn):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(sys.stderr, "fileno", lambda: 2)
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((columns, 24)))
    with Progress("write store") as progress:
        clock[0] += 1
        progress(1024, 4096)
        assert sys.stderr.getvalue() == f"\r{drawn}\x1b[K"


def test_progress_at_odd_totals(monkeypatch, clock):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("read") as progress:
        for done, total in ((0, 0), (0, 10), (20, 10)):
            clock[0] += 1
            progress(done, total)
    assert "0 %" in sys.stderr.getvalue()


def test_no_progress(monkeypatch, clock):
    for stream, enabled in ((io.StringIO(), True), (Terminal(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with Progress("read", enabled=enabled) as progress:
            clock[0] += 1
            progress(1, 2)
        assert stream.getvalue() == ""


def test_sizes():
    assert [size_text(size) for size in (0, 1023, 1024, 2**20, 2**31)] == [
        *("0 B", "1023 B", "1.0 KiB", "1.0 MiB", "2048.0 MiB")
    ]
