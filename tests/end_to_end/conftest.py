"""Devices to talk to: the demo app on posix, on the simulated AVR at two rates, and in Python."""

import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import j2a_transports
import pytest

import j2a
from j2a.demo import DemoDevice

ROOT = Path(__file__).parents[2]


def _build(out: Path, port: str, **variables: object) -> None:
    settings = [f"{name}={value}" for name, value in variables.items()]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MAKE")}
    command = ["make", "-s", "-C", "firmware", f"PORT={port}", "APP=demo", f"OUT={out}", *settings]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)


def _need_avr() -> None:
    if shutil.which("avr-gcc") is None:
        missing = "avr-gcc is missing: install gcc-avr, avr-libc and libsimavr-dev"
        if os.environ.get("J2A_REQUIRE_AVR") == "1":
            pytest.fail(f"J2A_REQUIRE_AVR=1, but {missing}")
        pytest.skip(missing)


@pytest.fixture(scope="session")
def posix_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The posix firmware on pipes."""
    out = tmp_path_factory.mktemp("posix")
    _build(out, "posix")
    return f"exec:{out / 'demo'}"


@pytest.fixture(scope="session")
def avr_url(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], str]:
    """The AVR firmware in simavr, built for a baud rate, in simulated time."""
    built: dict[int, str] = {}

    def url(baud: int) -> str:
        _need_avr()
        if baud not in built:
            out = tmp_path_factory.mktemp(f"avr-{baud}")
            _build(out, "avr-serial", BAUD=baud)
            built[baud] = f"sim:{out / 'demo.elf'}"
        return built[baud]

    return url


@pytest.fixture(
    params=[
        "posix",
        pytest.param("avr-115200", marks=pytest.mark.avr),
        pytest.param("avr-1000000", marks=pytest.mark.avr),
        "python",
    ]
)
def client(request: pytest.FixtureRequest) -> Iterator[j2a.Client]:
    """A client of each kind of device."""
    kind: str = request.param
    if kind == "python":
        near, far = j2a_transports.pair()
        device = DemoDevice()
        server = threading.Thread(target=device.serve, args=(far,))
        server.start()
        with j2a.Client(near, timeout=10) as link:
            yield link
        server.join()
        return
    if kind == "posix":
        url = request.getfixturevalue("posix_url")
    else:
        url = request.getfixturevalue("avr_url")(int(kind.removeprefix("avr-")))
    with j2a.connect(url, timeout=10) as link:
        yield link
