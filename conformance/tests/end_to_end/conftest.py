"""Devices to talk to: the demo app on posix, on the simulated AVR at two rates, and in Python.

The lower rate is exhaustive here: with it each byte takes nine times as many cycles, most of them
idle. The suite runs on testees of both.
"""

import shlex
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import j2a_transports
import pytest

import j2a
from j2a.demo import DemoDevice

Build = Callable[..., Path]


@pytest.fixture(scope="session")
def posix_url(build_firmware: Build) -> str:
    """The posix firmware on pipes."""
    return f"exec:{shlex.quote(str(build_firmware()))}"


@pytest.fixture(scope="session")
def avr_url(build_firmware: Build) -> Callable[[int], str]:
    """The AVR firmware in simavr, built for a baud rate, in simulated time."""
    return lambda baud: f"sim:{build_firmware(port='avr-serial', BAUD=baud)}"


@pytest.fixture(
    params=[
        "posix",
        pytest.param("avr-115200", marks=[pytest.mark.avr, pytest.mark.exhaustive]),
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
