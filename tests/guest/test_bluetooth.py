"""RFCOMM over the kernel's Bluetooth, with BlueZ: what inside_bluetooth.py asks, in the guest."""

import sysconfig

import pytest

from .conftest import ROOT

pytestmark = pytest.mark.guest
INSIDE = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/guest/inside_bluetooth.py"]
# Debian's own, whose socket module knows Bluetooth; that of the virtual environment may not, and
# reaches the kernel through the C library.
SYSTEM_PYTHON = "/usr/bin/python3"
# A loaded machine leaves an emulated one little.
PATIENCE_S = 280
NATIVE = "import socket; print(hasattr(socket, 'AF_BLUETOOTH'))"
CONFORMANCE = """
import subprocess, sys
from tests.guest import bluetooth

with (
    bluetooth.controllers(),
    subprocess.Popen(
        ["j2a", "serve", "--listen", "bt://hci0/"], stdout=subprocess.PIPE, text=True
    ) as device,
):
    url = device.stdout.readline().split()[-1]
    done = subprocess.run(["j2a-conform", "run", url + "?adapter=hci1", *sys.argv[1:]])
    device.terminate()
sys.exit(done.returncode)
"""


@pytest.fixture(autouse=True)
def tools(need):
    for tool in ("btvirt", "hcitool", "rfcomm", "sdptool", "dbus-daemon"):
        need(tool)


def test_the_suite_of_the_transports(guest):
    done = guest("python", *INSIDE, "-k", "TestRfcomm", timeout=PATIENCE_S)
    assert " passed" in done.stdout


@pytest.mark.parametrize("python", ["python", SYSTEM_PYTHON])
def test_channels_losses_terminals_and_service_discovery(guest, python):
    libraries = [sysconfig.get_paths()["purelib"]]
    libraries += [str(ROOT / folder) for folder in (".", "spec", "transports", "conformance")]
    done = guest(
        "env",
        f"PYTHONPATH={':'.join(libraries)}",
        "sh",
        "-c",
        f'{python} -c "$0" && exec {python} "$@"',
        NATIVE,
        *INSIDE,
        "-k",
        "not TestRfcomm",
        timeout=PATIENCE_S,
    )
    assert " passed" in done.stdout
    if python == SYSTEM_PYTHON:
        assert done.stdout.startswith("True\n")


# All levels, in parts that take a guest less than 40 s on a machine that does nothing else.
@pytest.mark.slow
@pytest.mark.parametrize(
    "levels",
    [["frame"], ["core"], ["mapping", "many", "properties", "debug", "sif"], ["timing"]],
    ids=lambda levels: levels[0],
)
def test_the_conformance_suite(guest, levels):
    done = guest("python", "-c", CONFORMANCE, "--level", *levels, timeout=PATIENCE_S)
    assert "The device is conformant" in done.stdout
