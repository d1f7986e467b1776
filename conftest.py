"""What the tests of all parts share: building firmware, missing tools, order, Hypothesis.

J2A_REQUIRE_AVR=1, which tools/check.sh sets in CI, is all that decides whether a test whose tools
are missing is skipped or fails.
"""

import contextlib
import gc
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import NoReturn

import pytest

from firmware.verify.one_file import write_one_file
from firmware.verify.packages import advice

if os.environ.get("J2A_GUEST") != "1":  # an emulated processor takes seconds to import it
    from hypothesis import HealthCheck, settings

    # Every run tries the same. Wall time on a busy machine says nothing about the code. A fixture
    # that the examples of one test share is one that they may share. `make exhaustive` tries more.
    settings.register_profile(
        "j2a",
        max_examples=50,
        derandomize=True,
        deadline=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )
    # For another interpreter, after ours has tried all of them.
    settings.register_profile("few", settings.get_profile("j2a"), max_examples=10)
    settings.register_profile("many", settings.get_profile("j2a"), max_examples=400)
    settings.load_profile("j2a")

# What programs print is buffered, as at a user's.
os.environ.pop("PYTHONUNBUFFERED", None)

# Some tests hold a thousand connections, and many a shell allows 1024 files.
_FILES = 4096
_soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
if 0 <= _soft < _FILES:
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(_FILES, _hard) if _hard > 0 else _FILES, _hard))

# A shell without job control starts its background with Ctrl-C ignored, and programs inherit that.
if (
    threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).parent
_GONE_S = 30
# The sources of the Makefile, those of the core but the tables replaced by one file.
WITH_ONE_CORE = (
    "{} $(TABLES) $(wildcard $(PORT_DIR)/*.[cS]) $(PORT_SOURCES) $(if $(OWN_MAIN),,apps/main.c)"
    " $(wildcard $(APP_DIR)/*.c)"
)
COMPILERS = {
    "avr-serial": "avr-gcc",
    "avr-usb": "avr-gcc",
    "cortex-m": "arm-none-eabi-gcc",
    "rp2040": "arm-none-eabi-gcc",
    "riscv": "riscv64-unknown-elf-gcc",
}
# What takes longest is `slow`, and starts first, so that no worker is alone with it at the end;
# what boots a guest stands in between, so that seldom two of them share the machine.
LONGEST = (
    *("guest/test_links.py", "tests/test_proof.py", "guest/test_gadget.py", "tests/test_legacy.py"),
    *("tests/test_two_links.py", "guest/test_usbip.py", "tests/test_porting.py"),
    *("faults/test_faults.py", "guest/test_bluetooth.py", "tests/test_mutants.py"),
    *("guest/test_guest.py", "tests/test_budget.py", "host/test_host_suite.py"),
    *("guest/test_conformance.py", "tests/test_naive_port.py", "tests/test_links.py"),
)
Make = Callable[..., subprocess.CompletedProcess[str]]
Build = Callable[..., Path]


def _file(item: pytest.Item) -> str:
    return "/".join(item.path.parts[-2:])


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the longest files, and sort them to the front; all others stay in order.

    Of the parameters of a test that is `sampled(n)` the first, the n-th behind it and so on are the
    sample; all others are `exhaustive`.
    """
    rank = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(_file(item), len(rank)))
    seen: Counter[str] = Counter()
    for item in items:
        if sampled := item.get_closest_marker("sampled"):
            test = item.nodeid.partition("[")[0]
            if seen[test] % sampled.args[0]:
                item.add_marker("exhaustive")
            seen[test] += 1
        if _file(item) in rank:
            item.add_marker("slow")
        if item.get_closest_marker("guest"):  # an emulated processor waits for a busy machine
            item.add_marker(pytest.mark.timeout(1200))


@contextlib.contextmanager
def alone_with(path: Path) -> Iterator[None]:
    """Wait until no other process is in this block with the same file."""
    try:
        import fcntl  # noqa: PLC0415 - not on every system
    except ImportError:
        yield
        return
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Let one of the workers of pytest-xdist compile a new module, and the others take that.

    Asserting takes as long to compile as all else of the collection.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ or not isinstance(collector, pytest.Module):
        return (yield)
    with alone_with(collector.path):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without the garbage collector, which would look at what stays again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Keep what was collected from the garbage collector, which would look at all of it each time.

    It stays until the end, and tests that call `gc.collect()` would wait a second for it.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture
def signal_at() -> Callable[..., contextlib.AbstractContextManager[Callable[[], bool]]]:
    """A context manager that has a signal handler called at a line, counted from 0, of its block.

    It counts the lines of what the block calls. Where there are not as many, because one of them
    waits, the handler is called amid that wait. What waits for ever after that fails. It yields
    what tells whether the handler was called.
    """
    return _signal_at


@contextlib.contextmanager
def _signal_at(line: int, handler: Callable[[], object]) -> Iterator[Callable[[], bool]]:
    left, was_called = line, False

    def handle(*_: object) -> None:
        nonlocal was_called
        if not was_called:
            was_called = True
            handler()

    def trace(_frame: object, event: str, _argument: object) -> object:
        nonlocal left
        if event == "line":
            left -= 1
            if left == -1:
                signal.raise_signal(signal.SIGUSR1)
        return trace

    def fail(*_: object) -> NoReturn:
        raise AssertionError("it waits for ever")

    befores = {
        signal.SIGUSR1: signal.signal(signal.SIGUSR1, handle),
        signal.SIGUSR2: signal.signal(signal.SIGUSR2, fail),
    }
    thread = threading.get_ident()
    timers = [
        threading.Timer(after_s, signal.pthread_kill, (thread, number))
        for after_s, number in ((0.05, signal.SIGUSR1), (60, signal.SIGUSR2))
    ]
    for timer in timers:
        timer.start()
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield lambda: was_called
    finally:
        sys.settrace(before)
        for timer in timers:
            timer.cancel()
            timer.join()
        for number, former in befores.items():
            signal.signal(number, former)


def _missing(what: str) -> NoReturn:
    if os.environ.get("J2A_REQUIRE_AVR") == "1":
        pytest.fail(f"J2A_REQUIRE_AVR=1, but {what}")
    pytest.skip(what)


@pytest.fixture(scope="session")
def missing() -> Callable[[str], NoReturn]:
    """missing("cc is missing: install ...") skips the test, or fails it where tools must be."""
    return _missing


def _runs(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


@pytest.fixture(scope="session")
def gone() -> Callable[[int], None]:
    """gone(pid) waits until a process has ended.

    Where nobody waits for it, its entry stays until init looks, on a busy machine for seconds.
    """

    def check(pid: int) -> None:
        deadline = time.monotonic() + _GONE_S
        while _runs(pid):
            assert time.monotonic() < deadline, f"process {pid} is still there"
            time.sleep(0.01)

    return check


@pytest.fixture(scope="session")
def need() -> Callable[[str], None]:
    """need("avr-gcc") is for tests that cannot run without that tool."""

    def check(tool: str) -> None:
        if shutil.which(tool) is None:
            _missing(advice(tool))

    return check


@pytest.fixture(scope="session")
def make(need: Callable[[str], None]) -> Make:
    """Run make in firmware/ with targets and variables; returns what it printed and its status.

    With `core_as_one` as `build_firmware` does it, where no object of the core is a goal.
    """

    def run(
        *targets: str, core_as_one: bool = False, **variables: object
    ) -> subprocess.CompletedProcess[str]:
        need("make")
        if core_as_one:
            variables = {**_core_as_one(Path(str(variables["OUT"]))), **variables}
        settings = [f"{name}={value}" for name, value in variables.items()]
        return subprocess.run(
            ["make", "-s", "-C", ROOT / "firmware", *targets, *settings],
            capture_output=True,
            text=True,
            check=False,
            # What was given to the make that runs the tests is not meant for this one.
            env={name: value for name, value in os.environ.items() if not name.startswith("MAKE")},
        )

    return run


def _core_as_one(folder: Path) -> dict[str, str]:
    """Write one file that includes the core; return the variables of make that compile it."""
    core = ROOT / "firmware/core"
    sources = {*core.glob("*.c"), *core.glob("ext/*.c")} - {*core.glob("*_table.c")}
    one = folder / "j2a_core.c"
    folder.mkdir(parents=True, exist_ok=True)
    if not one.exists():  # make goes by its time
        write_one_file(one, sources)
    return {"SOURCES": WITH_ONE_CORE.format(one), "VPATH": str(folder)}


@pytest.fixture(scope="session")
def build_firmware(
    make: Make, need: Callable[[str], None], tmp_path_factory: pytest.TempPathFactory
) -> Build:
    """Build an app, each set of variables once and in a folder of its own; returns the program.

    The workers of pytest-xdist share the folders: what one has built, make only looks at again.
    By itself the core is compiled as one file, as that of the amalgamation: for tests of what a
    device does. With `core_as_one=False` it is compiled file by file, as it is for the suite: where
    warnings, sizes or cycles are looked at.
    """
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "firmware"
    done: dict[tuple[object, ...], Path] = {}

    def run(
        app: str = "demo",
        port: str = "posix",
        core_as_one: bool = True,
        **variables: object,
    ) -> Path:
        need(str(variables.get("CC", COMPILERS.get(port, "cc"))))
        # What it does is asked; test_compilers.py has each level. For each Zig makes a C library.
        if port == "posix" and "CC" not in variables:
            variables = {"CFLAGS": "-O0", **variables}
        key = (
            app,
            port,
            core_as_one,
            *sorted((name, str(value)) for name, value in variables.items()),
        )
        if key not in done:
            out = shared / f"{port}-{app}-{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}"
            out.mkdir(parents=True, exist_ok=True)
            lock = out.with_suffix(".lock")
            lock.touch()
            with alone_with(lock):
                result = make(core_as_one=core_as_one, APP=app, PORT=port, OUT=out, **variables)
            assert result.returncode == 0, result.stderr
            done[key] = out / (f"{app}.elf" if port in COMPILERS else app)
        return done[key]

    return run
