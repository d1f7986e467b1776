"""RFCOMM over the kernel's Bluetooth, with BlueZ: what inside_bluetooth.py asks, in the guest."""

import sysconfig

import pytest

from .conftest import ROOT

pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]
SCRIPT = "transports/tests/guest/inside_bluetooth.py"
INSIDE = ["-m", "pytest", "-q", "-p", "no:cacheprovider", SCRIPT]
# Debian's own, whose socket module knows Bluetooth; that of the virtual environment may not, and
# reaches the kernel through the C library.
SYSTEM_PYTHON = "/usr/bin/python3"
# A loaded machine leaves an emulated one little.
PATIENCE_S = 840
NATIVE = "import socket; print(hasattr(socket, 'AF_BLUETOOTH'))"


@pytest.fixture(autouse=True)
def tools(need):
    for tool in ("btvirt", "hcitool", "rfcomm", "sdptool", "dbus-daemon"):
        need(tool)


@pytest.mark.timeout(PATIENCE_S + 60)
@pytest.mark.parametrize("python", ["python", SYSTEM_PYTHON])
def test_rfcomm_on_the_kernels_bluetooth(guest, python):
    """The suite of the transports, channels, losses, terminals and service discovery."""
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
        timeout=PATIENCE_S,
    )
    assert " passed" in done.stdout
    if python == SYSTEM_PYTHON:
        assert done.stdout.startswith("True\n")
