"""The programs that the documentation shows do what it says."""

import contextlib
import csv
import functools
import importlib
import os
import re
import shlex
import signal
import struct
import subprocess
import sys
import threading
import time
import tomllib

import j2a_transports
import pytest
from j2a_spec.constants import BUILTINS, SOF, SOS
from j2a_spec.oracle import Frame, decode

import j2a
from docs.tests.repeat import EXAMPLES, LIMIT_S, ROOT, SHOWN_URL, shown
from j2a.cli.plugin import LINK, USAGE
from j2a.demo import DemoDevice
from j2a.virtual import VirtualBoard
from transports.tests.fake_gadget import Host, installed  # noqa: TID251 - not installed


@contextlib.contextmanager
def served(device):
    """Serve a device, and give its URL."""
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        thread = threading.Thread(target=device.serve_forever, args=(listener,))
        thread.start()
        yield listener.url
        device.stop()
        thread.join(LIMIT_S)
        assert not thread.is_alive()


@pytest.fixture
def url():
    """A device with the demo functions."""
    with served(DemoDevice()) as found:
        yield found


def run(*arguments):
    """Run a Python program that must end well, and return what it printed."""
    result = subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_program_of_a_page_runs(page, url):
    program = shown(page)
    assert SHOWN_URL in program
    printed = run("-c", program.replace(SHOWN_URL, url))
    assert printed.startswith("J2A demo ['a2jGetMapping', ")


def test_the_first_program_of_the_readme_runs():
    """With the sketch beside it in a simulated Uno: firmware/tests/test_arduino.py."""
    device, levels = j2a.Device({"name": "My Uno"}), []

    @device.function
    def led(on: bool) -> None:
        levels.append(on)

    @device.function
    def add(a: j2a.i32, b: j2a.i32) -> j2a.i32:
        return a + b

    program = shown("README.md", 0)
    with served(device) as found:
        printed = run("-c", program.replace(SHOWN_URL, found))
    assert SHOWN_URL in program
    assert printed == "My Uno 42\n"
    assert levels == [True]


def test_the_frames_of_the_picture_are_valid():
    picture = (ROOT / "docs/_static/j2a.svg").read_text()
    drawn = [
        bytes.fromhex("".join(re.findall(r"<text[^>]*>(.*?)</text>", row)))
        for row in re.findall(r'<g class="frame.*?</g>', picture, re.DOTALL)
    ]
    led = len(BUILTINS) + 1  # the first function of a sketch, behind a2jGetInterface
    assert [decode(frame) for frame in drawn] == [
        [Frame(SOF, 1, led, b"\x01")],
        [Frame(SOF, 1, 0, b"")],
        [Frame(SOS, 0, 0x20, (511).to_bytes(2, "little"))],
    ]


def test_the_readme_shows_what_the_board_sends_unasked(url):
    # It comes at the very end of the program.
    assert run("-c", shown("README.md").replace(SHOWN_URL, url)).endswith("\n0\n")


def test_the_readme_adds(url):
    assert "\n42\n" in run("-c", shown("README.md").replace(SHOWN_URL, url))


WITH_ARGUMENT = sorted(path for path in EXAMPLES.glob("*.py") if "sys.argv[1]" in path.read_text())


@pytest.mark.parametrize("path", WITH_ARGUMENT, ids=lambda path: path.stem)
def test_an_example_without_its_argument_says_how_to_run_it(path):
    result = subprocess.run(
        [sys.executable, path], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert (result.returncode, result.stdout) == (1, "")
    assert re.fullmatch(rf"usage: python {re.escape(str(path))} (URL|IMAGE)\n", result.stderr)


@pytest.mark.parametrize("path", WITH_ARGUMENT, ids=lambda path: path.stem)
def test_the_documentation_gives_the_command_of_an_example(path):
    pages = [page.read_text() for page in (ROOT / "docs").glob("*.md")]
    shown = [page for page in pages if f"```{{literalinclude}} examples/{path.name}\n" in page]
    for page in shown or ["".join(pages)]:
        assert re.search(rf"\bpython docs/examples/{path.name} \S", page)


def test_tour(url):
    printed = run(EXAMPLES / "tour.py", url)
    assert "40 + 2 = 42" in printed
    assert "stored 240 bytes" in printed
    assert printed.endswith("the board counts [0, 1, 2]\n")


def test_clock():
    with served(j2a.Device(clock=30)) as found:
        printed = run(EXAMPLES / "clock.py", found).splitlines()
    assert len(printed) == 3
    for line in printed:
        assert re.fullmatch(r"(settling|locked|free): off by [+-]\d+ us, known to \d+ us", line)


def test_asynchronous(url):
    assert run(EXAMPLES / "asynchronous.py", url) == "[None, 42]\n"


def test_thermometer():
    program = [sys.executable, EXAMPLES / "thermometer.py", "tcp://127.0.0.1:0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            found = process.stdout.readline().split()[-1]
            with j2a.connect(found) as board:
                assert board.properties["name"] == "thermometer"
                assert board.functions.temperature() == 21.5
                assert str(board.functions["temperature"].signature) == "() f32 Cel"
                assert board.read_many("history") == struct.pack("<200f", *range(200))
        finally:
            process.terminate()


@pytest.fixture
def installed_by_the_page(tmp_path):
    """Install what a page says of entry points, and give the environment of such programs."""

    def install(page):
        text = (ROOT / page).read_text("utf-8")
        (lines,) = re.findall(r"```toml\n(\[project\.entry-points\..*?)```", text, re.DOTALL)
        (group, points) = next(iter(tomllib.loads(lines)["project"]["entry-points"].items()))
        folder = tmp_path / "example-1.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: example\nVersion: 1\n")
        (folder / "entry_points.txt").write_text(
            f"[{group}]\n" + "".join(f"{name} = {module}\n" for name, module in points.items())
        )
        return os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(EXAMPLES)])}

    return install


def test_a_command_of_another_package(installed_by_the_page):
    """The lines of the page make it a command."""
    environment = installed_by_the_page("docs/cli.md")

    def j2a_temperature(url):
        return subprocess.run(
            [sys.executable, "-m", "j2a", "temperature", url],
            env=environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )

    device = j2a.Device()

    @device.function
    def temperature() -> j2a.f32:
        return 21.5

    with served(device) as url:
        done = j2a_temperature(url)
        assert (done.returncode, done.stdout, done.stderr) == (0, "21.5 °C\n", "")
    with served(DemoDevice()) as url:
        done = j2a_temperature(url)
        assert (done.returncode, done.stdout) == (USAGE, "")
        assert "temperature" in done.stderr
        assert "Traceback" not in done.stderr
    done = j2a_temperature("tcp://127.0.0.1:1")
    assert (done.returncode, done.stdout) == (LINK, "")


def test_a_sink_of_another_package(installed_by_the_page, tmp_path):
    """The lines of the page make it a sink, which writes what a board measures."""
    environment = installed_by_the_page("docs/bridge.md")
    file = tmp_path / "drive.csv"
    board = VirtualBoard(EXAMPLES / "sensors/transds.def")
    board.measure()
    words = [sys.executable, "-m", "j2a", "bridge", "--sink", f"csv:{file}"]
    with served(board) as url, subprocess.Popen([*words, url], env=environment) as bridge:
        try:
            deadline = time.monotonic() + LIMIT_S
            while not (file.exists() and file.read_text("utf-8").count("\n") > 3):
                assert bridge.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
        finally:
            bridge.terminate()
    lines = list(csv.reader(file.read_text("utf-8").splitlines()))
    assert {(name, channel) for name, _, channel, _ in lines} >= {("quad", "0"), ("quad", "1")}
    now_ns = time.time_ns()
    for _, stamp_ns, _, value in lines[-3:]:
        assert now_ns - LIMIT_S * 1e9 < int(stamp_ns) < now_ns
        assert -1e6 < float(value) < 1e6


def test_the_sink_ends_also_where_it_could_not_open(tmp_path, monkeypatch):
    """As `Sink.close` asks: after a failure, and twice."""
    monkeypatch.syspath_prepend(EXAMPLES)
    sink = importlib.import_module("csv_sink").CsvSink(str(tmp_path / "none/x.csv"), {}, None)
    with pytest.raises(FileNotFoundError):
        sink.open()
    sink.close()
    sink.close()


@pytest.mark.parametrize("name", ["thermometer", "typed_device"])
def test_a_served_example_ends_by_ctrl_c(name):
    program = [sys.executable, EXAMPLES / f"{name}.py", "tcp://127.0.0.1:0"]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline()
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")


def test_types():
    program = [sys.executable, EXAMPLES / "typed_device.py", "tcp://127.0.0.1:0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            found = process.stdout.readline().split()[-1]
            printed = run(EXAMPLES / "typed_host.py", found)
            assert f"```text\n{printed}```" in (ROOT / "docs/types.md").read_text()
        finally:
            process.terminate()


@pytest.mark.avr
def test_simulated_usb(build_firmware):
    elf = build_firmware("demo", port="avr-usb", MCU="atmega32u4", SERIAL="0042")
    first, second, third = run(EXAMPLES / "simulated_usb.py", elf).splitlines()
    assert first == "J2A atmega32u4 0042"
    assert second == "usb://0042 at 12 Mbit/s"
    assert third.startswith("J2A demo has a2jGetMapping, ")


@pytest.mark.skipif(sys.platform != "linux", reason="gadgets exist on Linux only")
def test_linux_board(tmp_path, monkeypatch):
    """With a device port in memory; transports/tests/guest have gadgets at the kernel's."""
    kernel = installed(tmp_path, monkeypatch)
    # A name of its own, because the lock that goes by it is the real one.
    gadget = functools.partial(j2a_transports.UsbGadget, name=f"docs-{os.getpid()}")
    monkeypatch.setattr(j2a_transports, "UsbGadget", gadget)
    names = {"__name__": "__main__"}
    program = compile((EXAMPLES / "linux_board.py").read_text(), "linux_board.py", "exec")
    thread = threading.Thread(target=exec, args=(program, names))
    thread.start()
    try:
        until(lambda: kernel.bus.session is not None or not thread.is_alive())
        with j2a.Client(Host(kernel.bus), timeout=LIMIT_S) as board:
            assert board.properties["name"] == "linux board"
            with kernel.bus.changed:
                kernel.bus.sync.packets.append(struct.pack("<QH", 5_000_000, 7))
                kernel.bus.changed.notify_all()
            until(lambda: names["clock"]["ahead_us"])
            host_us = board.functions.host_time()
            assert 5_000_000 <= host_us < 5_000_000 + LIMIT_S * 1_000_000
    finally:
        until(lambda: "device" in names or not thread.is_alive())
        names["device"].stop()
        thread.join(LIMIT_S)
    assert not thread.is_alive()
    assert not list((kernel.config / "usb_gadget").iterdir())


def until(condition):
    """Wait for what another thread does."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture(scope="module")
def firmware(build_firmware):
    """The application that the documentation shows, built for this machine."""
    return build_firmware("first", APP_DIR=EXAMPLES / "first")


def test_the_first_application_works(firmware):
    with j2a.connect(f"exec:{shlex.quote(str(firmware))}") as board:
        assert board.properties["name"] == "my first board"
        assert board.call("add", struct.pack("<ii", 40, 2)) == (0, struct.pack("<i", 42))
        assert board.call("add", b"short") == (0xFF, b"")


def test_the_readme_shows_the_first_application():
    readme = (ROOT / "README.md").read_text()
    [function] = re.findall(r"^int32_t app_add.*?^}\n", readme, re.DOTALL | re.MULTILINE)
    assert function in (EXAMPLES / "first/app.c").read_text()
    assert (EXAMPLES / "first/functions.def").read_text().strip() in readme


def test_the_reference_has_every_public_name_of_the_library():
    page = (ROOT / "docs/api/j2a.md").read_text()
    parts = re.split(r"\.\. currentmodule:: j2a$|^\.\. automodule:: j2a\.types", page, flags=re.M)
    own = "".join(part for part in parts if not part.startswith(".model"))
    listed = set(re.findall(r"\.\. auto(?:class|function|exception|data):: (\w+)$", own, re.M))
    assert listed == set(j2a.__all__)


@contextlib.contextmanager
def listening(*command):
    """Run a j2a command that serves, and give its URL."""
    program = [sys.executable, "-m", "j2a", *command, "--listen", "tcp://127.0.0.1:0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


def test_the_commands_of_the_quick_start():
    text = (ROOT / "docs/quickstart.md").read_text()
    assert "j2a call URL a2jEcho 01 02 03" in text
    with listening("serve") as found:
        assert "J2A demo" in run("-m", "j2a", "info", found)
        assert "01 02 03" in run("-m", "j2a", "call", found, "a2jEcho", "01", "02", "03")
        assert "serial" in run("-m", "j2a", "props", found)
        [watch] = re.findall(r"^j2a (watch URL .*)$", text, re.MULTILINE)
        words = [found if word == "URL" else word for word in shlex.split(watch, comments=True)]
        assert "opcode  32" in run("-m", "j2a", *words, "--count", "2")


class TestFewLines:
    """What a user writes for two functions and a stream."""

    FOLDER = ROOT / "docs/examples/few_lines"

    @staticmethod
    def counted(text, first):
        """The lines from the first function on, without blank lines and comments."""
        lines = [line.strip() for line in text[text.index(first) :].splitlines()]
        return len([line for line in lines if line and not line.startswith(("#", "//"))])

    def test_in_c(self, build_firmware):
        functions = (self.FOLDER / "functions.def").read_text()
        code = (self.FOLDER / "app.c").read_text()
        assert self.counted(functions, "J2A") + self.counted(code, "int32_t app_add") <= 6
        program = build_firmware("few_lines", APP_DIR=self.FOLDER)
        with j2a.connect(f"exec:{program}") as board:
            assert board.functions.add(40, 2) == 42
            board.functions.led(True)
            with board.sifs("counter") as stream:
                first, second = stream.wait(LIMIT_S), stream.wait(LIMIT_S)
        assert second.values.count == first.values.count + 1

    def test_in_python(self):
        text = (ROOT / "docs/examples/few_lines.py").read_text()
        assert self.counted(text, "@device.function") <= 5
        made = {}
        exec(compile(text, "few_lines.py", "exec"), made)
        with served(made["device"]) as found, j2a.connect(found) as board:
            assert board.functions.add(40, 2) == 42
            board.functions.led(True)
            assert made["lights"] == [True]
            with board.sifs("counter") as stream:
                made["counter"](7)
                assert stream.wait(LIMIT_S).values.count == 7
