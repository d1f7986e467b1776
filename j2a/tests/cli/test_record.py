"""`j2a record` and `j2a replay`, as a user runs them."""

import contextlib
import itertools
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from j2a_spec.constants import BOOT
from mcap import reader as mcap_reader

import j2a
from j2a.cli._record import _Session
from j2a.recording import Recorder, Recording
from j2a.replay import ReplayBoard
from j2a.tests.library import support
from j2a.tests.library.support import linked
from j2a.types.transds_file import read_transds
from j2a.virtual import VirtualBoard

from .conftest import files_of, served

FILE = Path(__file__).parents[3] / "firmware/apps/transducers/transds.def"


def board_file():
    """Return the transducers of the file, without those that some ports have only."""
    return j2a.load_transds(FILE, {"TRANSDUCERS_NUMBERS": None})


FILE_BEFORE = "SENSOR(quad, 0, quad, X, 1, i16, none)\nSENSOR(same, 1, same, X, 1, u8, none)\n"
FILE_AFTER = FILE_BEFORE.replace("i16", "u16")
FILE_OTHER = FILE_BEFORE.replace("quad", "added")
SAME = struct.pack("<QB", 2, 9)
BURST = struct.pack("<QB", 3, 9)


@pytest.fixture
def board():
    device = VirtualBoard(board_file())
    device.measure()
    yield from served(device)


def payloads(path, board=None):
    return [
        (one.sensor.name, one.payload)
        for one in Recording(path)
        if board is None or one.board == board
    ]


def payloads_or_none(path):
    try:
        return payloads(path)
    except j2a.LocalError:  # its first bytes are on the way
        return []


def record(*words):
    command = [sys.executable, "-m", "j2a", "record", *map(str, words)]
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
    try:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(signal.SIGHUP, before)


def wait_for(path, count, process):
    """Wait until so many samples are in a file."""
    while process.poll() is None:
        with contextlib.suppress(j2a.LocalError):  # its first bytes may be on the way
            if path.exists() and len(payloads(path)) >= count:
                return
    raise AssertionError(process.communicate())


def test_for_so_many_seconds(run, board, tmp_path):
    path = tmp_path / "a.mcap"
    result = run("record", board, "-o", path, "--seconds", "2.5")
    assert (result.code, result.err) == (0, "")
    found = payloads(path)
    assert f"wrote {path}: {len(found)} samples, 0 lost on the way" in result.out
    assert {name for name, _ in found} == {"plain", "queued", "tuned", "imu", "slow", "wide"}


@pytest.mark.parametrize(
    ("number", "code", "is_whole"),
    [
        (signal.SIGINT, 130, True),
        (signal.SIGTERM, 143, True),
        (signal.SIGHUP, 129, True),
        (signal.SIGKILL, -9, False),
    ],
)
def test_a_program_that_is_ended_leaves_its_samples(board, tmp_path, number, code, is_whole):
    path = tmp_path / "a.mcap"
    process = record(board, "-o", path)
    wait_for(path, 30, process)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert "Traceback" not in err
    recording = Recording(path)
    found = list(recording)
    assert len(found) >= 30
    assert recording.is_whole == is_whole
    assert is_whole == (f"wrote {path}: {len(found)} samples" in out)


def test_a_board_that_is_lost_ends_it(tmp_path):
    device = VirtualBoard(board_file())
    device.measure()
    serving = served(device)
    path = tmp_path / "a.mcap"
    process = record(next(serving), "-o", path, "--wait", "0")
    wait_for(path, 10, process)
    next(serving, None)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "lost tcp://" in err
    assert f"wrote {path}" in out


def at(url, properties):
    """Serve a board that measures; yields its URL."""
    device = VirtualBoard(board_file(), properties)
    device.measure()
    return support.served(device, url)


def test_a_board_that_comes_back_is_taken_in_again(tmp_path):
    path = tmp_path / "a.mcap"
    with at("tcp://127.0.0.1:0", {"serial": "A3"}) as url:
        process = record(url, "-o", path, "--boot-time", "1")
        wait_for(path, 10, process)
    try:
        assert "lost tcp://" in process.stderr.readline()
        with at(url, {"serial": "B7"}):
            assert f"{url} is another board now: J2A virtual board B7" in process.stderr.readline()
        with at(url, {"serial": "A3"}):
            assert f"{url} is here again, after" in process.stderr.readline()
            before = len(payloads(path))
            wait_for(path, before + 100, process)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert re.search(r"lost on the way, and a board was away 1 time, [0-9.]+ s", out)
    times = [one.time_ns for one in Recording(path)]
    assert max(b - a for a, b in itertools.pairwise(times)) > 1e9


class Losing:
    """A sample whose loss is asked for while that of another board is counted."""

    missed = 0

    def __init__(self, lost, meanwhile=lambda: None):
        self._lost = lost
        self._meanwhile = meanwhile

    @property
    def lost(self):
        self._meanwhile()
        return self._lost


def test_losses_of_several_boards_are_all_counted():
    sensors = read_transds(FILE_BEFORE)
    [quad, _] = sensors.transducers
    session = _Session(SimpleNamespace(write=lambda *_: None))
    keep = session.keep("a", SimpleNamespace(descriptor=quad), quad)

    def other():
        thread = threading.Thread(target=keep, args=(Losing(5),))
        thread.start()
        thread.join()

    keep(Losing(1, other))
    assert session.lost == 6


def test_losses_are_counted_that_only_a_sif_of_another_kind_tells(run, tmp_path, monkeypatch):
    device = j2a.Device(transducers=read_transds(FILE_BEFORE))
    write, is_written = Recorder.write, threading.Event()

    def write_and_tell(*words):
        is_written.set()
        write(*words)

    def send():
        while not is_written.wait(0.05):
            device.send_sif(1, SAME)
        [connection] = device._connections
        for _ in range(3):
            connection._server.skip_sif()
        device.send_sif(200)
        device.send_sif(1, BURST)

    monkeypatch.setattr(Recorder, "write", write_and_tell)
    thread = threading.Thread(target=send)
    thread.start()
    for url in served(device):
        result = run("record", url, "-o", tmp_path / "a.mcap", "--seconds", "1")
    thread.join()
    assert payloads(tmp_path / "a.mcap").count(("same", BURST)) == 1
    assert " samples, 3 lost on the way" in result.out


def test_a_sensor_that_is_another_one_after_a_restart_is_left_out(tmp_path):
    device = j2a.Device(transducers=read_transds(FILE_BEFORE), boot=True)
    path = tmp_path / "a.mcap"
    serving = served(device)
    try:
        process = record(next(serving), "-o", path)
        while not device._connections:
            time.sleep(0.01)
        deadline = time.monotonic() + 60
        while not (path.exists() and payloads_or_none(path)):
            device.sense("quad", 0, -1)
            device.sense("same", 0, 7)
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        device._runner._server.content = str(read_transds(FILE_AFTER)).encode()
        [connection] = device._connections
        connection.send_sif(BOOT, struct.pack("<BHI", 0, 1, 0))
        while not payloads_or_none(path).count(("same", SAME)):
            device.send_sif(0, struct.pack("<QH", 1, 0xFFFF))
            device.send_sif(1, SAME)
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        next(serving, None)
    assert "quad of board is another one since the board restarted" in err
    assert "times fit" not in err
    assert {payload[8:] for name, payload in payloads(path) if name == "quad"} == {b"\xff\xff"}
    assert struct.pack("<QH", 1, 0xFFFF) not in {payload for _, payload in payloads(path)}


@pytest.mark.parametrize("is_lost", [False, True])
def test_sensors_that_come_and_go_are_told(tmp_path, is_lost):
    path = tmp_path / "a.mcap"
    device = j2a.Device({"serial": "A3"}, transducers=read_transds(FILE_BEFORE), boot=True)
    serving = served(device)
    url = next(serving)
    with contextlib.ExitStack() as stack:
        stack.callback(next, serving, None)
        process = record(url, "-o", path)
        stack.callback(process.kill)
        while not payloads_or_none(path) if path.exists() else True:
            device.sense("same", 0, 7)
            assert process.poll() is None
            time.sleep(0.05)
        if is_lost:
            next(serving, None)
            device = j2a.Device({"serial": "A3"}, transducers=read_transds(FILE_OTHER), boot=True)
            stack.enter_context(support.served(device, url))
            assert "lost" in process.stderr.readline()
            assert "is here again" in process.stderr.readline()
        else:
            device._runner._server.content = str(read_transds(FILE_OTHER)).encode()
            [connection] = device._connections
            connection.send_sif(BOOT, struct.pack("<BHI", 0, 1, 0))
        while not payloads(path).count(("same", SAME)):
            device.send_sif(0, struct.pack("<Qh", 1, 5))
            device.send_sif(1, SAME)
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert "added of board is new: its samples were left out" in err
    assert "quad of board is gone since the board restarted" in err


def test_a_board_that_comes_back_is_taken_in_when_it_tells_its_sensors(tmp_path):
    path = tmp_path / "a.mcap"
    with at("tcp://127.0.0.1:0", {"serial": "A3"}) as url:
        process = record(url, "-o", path)
        wait_for(path, 10, process)
    try:
        assert "lost tcp://" in process.stderr.readline()
        device = VirtualBoard(board_file(), {"serial": "A3"})
        server = device._runner._server
        server.content, content = b"", server.content
        device.measure()
        with support.served(device, url):
            assert f"{url} has no sensors now: " in process.stderr.readline()
            server.content = content
            assert "is here again" in process.stderr.readline()
            wait_for(path, len(payloads(path)) + 30, process)
    finally:
        process.kill()
        process.communicate()


def test_two_boards_of_one_name_are_told_apart(run, board, tmp_path):
    path = tmp_path / "a.mcap"
    other = board.replace("127.0.0.1", "localhost")
    assert run("record", board, other, "-o", path, "--seconds", "1.5").code == 0
    recording = Recording(path)
    assert {one.board for one in recording} == {"J2A virtual board", "J2A virtual board_2"}
    result = run("replay", path)
    assert result.code == 2
    assert "choose one: J2A virtual board, J2A virtual board_2 (" in result.err
    assert "--board NAME" in result.err


def test_boards_of_one_name_are_told_apart_by_their_serial_numbers(run, tmp_path):
    path = tmp_path / "a.mcap"
    with contextlib.ExitStack() as stack:
        urls = []
        for serial in ("B7", "A3"):
            device = VirtualBoard(
                j2a.load_transds(FILE, {"TRANSDUCERS_NUMBERS": None}),
                {"serial": serial, "name": "cart"},
            )
            device.measure()
            serving = served(device)
            urls.append(next(serving))
            stack.callback(next, serving, None)
        assert run("record", *urls, "-o", path, "--seconds", "1.5").code == 0
    assert {one.board for one in Recording(path)} == {"cart_B7", "cart_A3"}


def test_topics_and_settings_are_those_of_the_board_at_run_time(run, tmp_path):
    lines = "".join(
        f"SENSOR({name}, {n}, {name}, X, 1, u8, none, (topic, {name}), (period, 500000))\n"
        for n, name in enumerate(("quad", "other", "third"))
    )
    device, path = VirtualBoard(read_transds(lines)), tmp_path / "a.mcap"
    device.measure()
    serving = served(device)
    try:
        url = next(serving)
        with j2a.connect(url) as client:
            client.transducers["quad"].configure(topic="left/wheel", period=0.01)
            client.transducers["other"].topic = "third"
        assert run("record", url, "-o", path, "--seconds", "1.5").code == 0
    finally:
        next(serving, None)
    with path.open("rb") as file:
        channels = mcap_reader.make_reader(file).get_summary().channels.values()
    topics = {one.metadata["sensor"]: one.topic for one in channels}
    assert topics == {"quad": "/left/wheel", "other": "/third", "third": "/third2"}
    replayed = ReplayBoard(path)
    with replayed, linked(replayed) as board:
        quad = board.transducers["quad"]
        assert (quad.topic, quad.period) == ("left/wheel", 0.01)
        quad.period = 0.02
        with pytest.raises(j2a.FunctionFailed, match="out of range"):
            quad.period = 0.005


def test_names_that_make_the_same_topics(run, tmp_path):
    path = tmp_path / "a.mcap"
    with contextlib.ExitStack() as stack:
        urls = []
        for name in ("my cart", "my-cart"):
            device = VirtualBoard(read_transds(FILE_BEFORE), {"name": name})
            device.measure()
            serving = served(device)
            urls.append(next(serving))
            stack.callback(next, serving, None)
        assert run("record", *urls, "-o", path, "--seconds", "1.5").code == 0
    with path.open("rb") as file:
        channels = mcap_reader.make_reader(file).get_summary().channels.values()
    assert len({one.topic for one in channels}) == 4


def test_there_and_back(board, run, start, tmp_path):
    first, again = tmp_path / "a.mcap", tmp_path / "b.mcap"
    assert run("record", board, "-o", first, "--seconds", "2").code == 0
    player = start("replay", str(first), "--speed", "2")
    process = record(player.line_with("listening").split()[-1], "-o", again, "--wait", "0")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 3, err
    assert f"replayed {len(payloads(first))} samples" in player.end().out
    assert payloads(again) == payloads(first)


def test_both_show_on_a_terminal_how_far_they_are(board, tmp_path):
    path = tmp_path / "a.mcap"
    code, shown = on_terminal(("record", board, "-o", path, "--seconds", "2.5"))
    assert code == 0
    assert re.search(r"record  \[#+\.+\] +\d+ %  \d+ s  \d+ samples", shown)
    process, terminal = begun_on_terminal(("replay", path, "--listen", "tcp://127.0.0.1:0"))
    with process:
        url = process.stdout.readline().split()[-1]
        with j2a.connect(url) as host:
            host.transducers.values()
            shown = all_of(terminal)
        assert process.wait(60) == 0
    assert re.search(r"replay .*a\.mcap  \[#+\.*\] +\d+ %  \d s", shown)


def begun_on_terminal(words):
    """Start a command whose standard error is a terminal; returns it and the other end of that."""
    ours, its = pty.openpty()
    command = [sys.executable, "-m", "j2a", *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=its, text=True)
    os.close(its)
    return process, ours


def all_of(terminal):
    """Return what comes from a terminal until nobody has it open."""
    shown = b""
    with contextlib.suppress(OSError):
        while piece := os.read(terminal, 4096):
            shown += piece
    os.close(terminal)
    return shown.decode()


def on_terminal(words):
    """Run a command; returns its exit code and what a terminal shows of its standard error."""
    process, terminal = begun_on_terminal(words)
    shown = all_of(terminal)
    process.communicate(timeout=60)
    return process.returncode, shown


def test_a_disk_that_is_full_before_the_first_byte_leaves_the_name_free(run, board, tmp_path):
    path = tmp_path / "a.mcap"
    with files_of(0):
        result = run("record", board, "-o", path, "--seconds", "2.5")
    assert (result.code, result.out) == (1, "")
    assert result.err.startswith(f"j2a: cannot write {path}: ")
    assert not path.exists()


def test_a_disk_that_becomes_full_leaves_what_was_written(run, board, tmp_path):
    path = tmp_path / "a.mcap"
    with files_of(5000):
        result = run("record", board, "-o", path, "--seconds", "60")
    assert (result.code, result.out) == (1, "")
    assert result.err.endswith(f": what was written before is in {path}\n")
    assert Recording(path).read_boards()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("record", "URL", "-o", "a.csv"), "ends in .mcap; j2a export makes tables of it"),
        (("record", "URL", "-o", "there.mcap"), "is there already"),
        (("record", "URL", "-o", "none/a.mcap"), "cannot write"),
        (("record", "DEMO", "DEMO", "-o", "a.mcap"), "stands there twice"),
        (("record", "DEMO", "-o", "a.mcap"), "has no sensors: the device describes no transducers"),
        (("record", "URL"), "-o"),
        (("record", "URL", "-o", "a.mcap", "--seconds", "0"), "must be greater than 0, not 0"),
        (("replay", "gone.mcap"), "cannot read"),
        (("replay", "there.mcap"), "is no MCAP file"),
        (("replay", "there.mcap", "--speed", "0"), "must be greater than 0, not 0"),
        (("replay", "there.mcap", "--speed", "1e308"), "above 0 and at most 1e+06, not 1e+308"),
    ],
)
def test_mistakes(run, board, demo, tmp_path, monkeypatch, words, why):
    monkeypatch.chdir(tmp_path)
    Path("there.mcap").write_text("this is a text, and no recording")
    urls = {"URL": board, "DEMO": demo}
    result = run(*(urls.get(word, word) for word in words))
    assert result.code == 2
    assert why in result.err
    assert not Path("a.mcap").exists()


def test_without_the_package(run, board, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    result = run("record", board, "-o", tmp_path / "a.mcap")
    assert result.code == 2
    assert 'pip install "j2a[record]"' in result.err


def test_a_sample_has_its_payload(board):
    with j2a.connect(board) as client:
        sample = client.transducers["plain"].wait(30)
    assert len(sample.payload) == 20
    assert "payload" not in repr(sample)


@pytest.fixture
def slow(monkeypatch):
    """A board that sends 100 samples at once to a recorder that needs a moment for each."""
    device = j2a.Device(transducers=read_transds(FILE_BEFORE))
    write, is_written = Recorder.write, threading.Event()

    def write_slowly(*words):
        is_written.set()
        time.sleep(0.02)
        write(*words)

    def send():
        while not is_written.wait(0.05):
            device.send_sif(1, SAME)
        for _ in range(100):
            device.send_sif(1, BURST)

    monkeypatch.setattr(Recorder, "write", write_slowly)
    thread = threading.Thread(target=send)
    thread.start()
    yield from served(device)
    thread.join()


def test_samples_that_wait_at_the_end_are_written(run, slow, tmp_path):
    path = tmp_path / "a.mcap"
    result = run("record", slow, "-o", path, "--seconds", "1")
    assert (result.code, result.err) == (0, "")
    assert payloads(path).count(("same", BURST)) == 100


def test_samples_for_which_the_computer_is_too_slow_are_told(run, slow, tmp_path, monkeypatch):
    monkeypatch.setattr("j2a.io.blocking.MAX_SIFS_WAITING", 3)
    path = tmp_path / "a.mcap"
    result = run("record", slow, "-o", path, "--seconds", "1")
    assert result.code == 0
    left_out = 100 - payloads(path).count(("same", BURST))
    assert left_out > 50
    assert f"{left_out} SIFs were left out: this computer is too slow" in result.err
