"""`j2a view`, as a user runs it."""

import asyncio
import contextlib
import json
import signal
import struct
import subprocess
import sys
import threading

import aiohttp
import pytest
from j2a_bridge.replayed import replayed
from j2a_bridge.reports import read_reports, report_of

import j2a
from j2a.recording import Recorder
from j2a.replay import ReplayBoard
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, board_of, bridging, config_for, served, until


def view(*words, program=("-m", "j2a")):
    return subprocess.Popen(
        [sys.executable, *program, "view", "--no-browser", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


async def first_of(url, op, is_right):
    async with aiohttp.ClientSession() as session:
        origin = "/".join(url.split("/")[:3])
        async with session.ws_connect(url + "ws", headers={"Origin": origin}) as page:
            while True:
                about = json.loads((await page.receive(timeout=PATIENCE_S)).data)
                if about["op"] == op and is_right(about):
                    return about


def test_it_prints_the_address_of_the_page_and_ends_by_ctrl_c():
    device = board_of()
    with served(device) as url:
        process = view(url)
        page = process.stdout.readline().strip()
        assert page.startswith("http://127.0.0.1:")
        topics = asyncio.run(first_of(page, "topics", lambda about: len(about["topics"]) == 3))
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert "servo" in topics["topics"]
    assert process.returncode == 130
    assert "Traceback" not in err


def test_a_report_is_of_the_board_that_says_the_same_of_itself(tmp_path):
    path = tmp_path / "report.json"
    with served(board_of(serial="1")) as url, served(board_of(serial="2")) as other:
        command = [sys.executable, "-m", "j2a_conformance", "run", url, "--case", "frame.layout"]
        subprocess.run([*command, "--json", path], capture_output=True, timeout=900, check=False)
        runs = read_reports([path])
        found = []
        for one in (url, other):
            with j2a.connect(one, timeout=PATIENCE_S) as board:
                found.append(report_of(runs, board.properties))
    run = json.loads(path.read_text())
    assert run["conformant"] == (found[0]["tone"] == "ok")
    assert found[0]["text"].startswith("J2A ")
    assert found[0]["text"].endswith(f"tested {run['started'][:10]}")
    assert found[1] is None


def test_a_recording_is_played(tmp_path):
    path = tmp_path / "drive.mcap"

    async def record():
        device = board_of()
        with served(device) as url:
            async with bridging(config_for(url, sinks=(f"mcap:{path}", "kept"))) as bridge:
                await until(lambda: "quad" in bridge._flows)
                for value in range(20):
                    device.sense("quad", 0, value, raw=True)
                    await until(lambda count=value: bridge.runners[0].published > count)

    asyncio.run(record())
    process = view(path)
    page = process.stdout.readline().strip()
    data = asyncio.run(first_of(page, "data", lambda about: "quad" in about["d"]))
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert data["d"]["quad"]["v"][0].endswith(" deg")
    assert process.returncode == 143
    assert "Traceback" not in err


def test_boards_that_came_while_it_was_recorded_are_served(tmp_path):
    path = tmp_path / "drive.mcap"
    sensors = read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)")
    with Recorder(path) as recorder:
        for name in ("left", "right"):
            recorder.add_board(name, sensors, prefix=name)
            sample = j2a.Sample("b", "quad", 0, (), 0.0, payload=struct.pack("<QB", 1, 2))
            recorder.write(name, sample, 1)
            recorder.flush()
    with replayed(path) as urls:
        for url in urls:
            with j2a.connect(url, timeout=PATIENCE_S) as board:
                assert board.transducers["quad"].wait(PATIENCE_S).values == (2,)
    assert len(urls) == 2


def test_boards_of_a_recording_keep_their_common_time(tmp_path, monkeypatch):
    path, played, replay = tmp_path / "drive.mcap", [], ReplayBoard._replay

    def note(self, sample, local_us):
        played.append((sample.board, sample.payload[-1]))
        return replay(self, sample, local_us)

    monkeypatch.setattr(ReplayBoard, "_replay", note)
    sensors = read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)")
    recorded = [("left", 1), ("left", 2), ("left", 3), ("right", 4)]
    with Recorder(path) as recorder:
        for name in ("left", "right"):
            recorder.add_board(name, sensors, prefix=name)
        for name, value in recorded:
            sample = j2a.Sample("b", "quad", 0, (), 0.0, payload=struct.pack("<QB", value, value))
            recorder.write(name, sample, value * 50_000_000)
    with replayed(path) as urls, contextlib.ExitStack() as stack:
        boards = [stack.enter_context(j2a.connect(url, timeout=PATIENCE_S)) for url in urls]
        sensor = [board.transducers["quad"] for board in boards][1]
        sensor.wait(PATIENCE_S)
        sensor.wait(PATIENCE_S)  # it begins anew
    assert played[:8] == 2 * recorded


def test_a_recording_that_no_host_plays_ends_at_once(tmp_path):
    path = tmp_path / "drive.mcap"
    with Recorder(path) as recorder:
        recorder.add_board("b", read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)"))
    before = set(threading.enumerate())
    with replayed(path):
        pass
    for thread in set(threading.enumerate()) - before:
        thread.join(PATIENCE_S)  # it has been told to end
        assert not thread.is_alive()


def test_a_recording_of_too_many_boards_is_refused(tmp_path):
    path = tmp_path / "drive.mcap"
    sensors = read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)")
    with Recorder(path) as recorder:
        for number in range(256):
            recorder.add_board(f"b{number}", sensors)
    with pytest.raises(j2a.LocalError, match="has 256 boards"), replayed(path):
        pass


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "name a board or a recording"),
        (("missing.mcap",), "missing.mcap"),
        (("tcp://127.0.0.1:1", "--folder", "/nowhere/at/all"), "there is no folder"),
        (("tcp://127.0.0.1:1", "--port", "70000"), "70000"),
        (("nonsense://x",), "nonsense"),
        (
            ("drive",),
            "'drive' is neither the URL of a board, such as tcp://127.0.0.1:5000, nor a re",
        ),
        (("tcp://127.0.0.1:1", "--report", "/nowhere/at/all"), "cannot read /nowhere/at/all"),
        (("tcp://127.0.0.1:1", "--report", __file__), "is no report of j2a-conform"),
    ],
)
def test_what_is_wrong_is_told(words, told):
    process = view(*words)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2, err
    assert told in err
    assert "Traceback" not in out + err


def test_an_empty_recording_is_told(tmp_path):
    path = tmp_path / "empty.mcap"
    with Recorder(path):
        pass
    process = view(path)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "has no boards" in err


def test_a_port_that_is_taken_is_told():
    device = board_of()
    with served(device) as url:
        port = url.rsplit(":", 1)[1]
        process = view(url, "--port", port)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "cannot be served" in err
    assert err.count(f"port {port} is taken; choose another with --port, or leave it out\n") == 1
    assert err.count("\n") == 1


def test_it_tells_what_to_do_about_plots_that_are_missing():
    script = (
        "from j2a_bridge import web_server; from j2a.cli import main\n"
        "web_server._FILES['uplot.js'] = 'uplot/nothing.js', 'text/javascript'\n"
        "raise SystemExit(main())"
    )
    with served(board_of()) as url:
        process = view(url, program=("-c", script))
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        assert "run make page" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)


def test_the_list_of_commands_imports_nothing_that_only_a_bridge_needs():
    """The page, its server and the messages of ROS came with a summary."""
    script = (
        "import sys\n"
        "from j2a.cli import main\n"
        "main(['--help'])\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert "a live page of boards" in done.stdout
    loaded = set(done.stderr.split())
    assert "j2a_bridge.command_view" in loaded
    assert not {name for name in loaded if name.startswith("j2a_bridge.sinks")}
    heavy = {"j2a_bridge.bridge", "j2a_bridge.ros_messages", "j2a_bridge.web_server"}
    assert not loaded & (heavy | {"aiohttp", "numpy", "rosbags", "zenoh"})
