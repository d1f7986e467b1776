"""A gadget on the kernel's USB: what inside_gadget.py asks, in the guest."""

import pytest

from .conftest import tool

pytestmark = pytest.mark.guest
INSIDE = ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/guest/inside_gadget.py"]
SUITE = "TestUsb"


def dummy_hcd() -> str:
    """Return the file of the module that the guest has loaded, to load it anew."""
    kernel = tool("guest_kernel")
    return str(kernel.kernel(kernel.cache_folder()) / "dummy_hcd.ko")


@pytest.mark.parametrize("end", ["near", "far"])
def test_the_suite_of_the_transports(guest, end):
    assert " passed" in guest(*INSIDE, "-k", f"{SUITE} and {end}", timeout=150).stdout


def test_what_the_bus_says(guest):
    command = ["env", f"J2A_DUMMY_HCD={dummy_hcd()}", *INSIDE, "-k", f"not {SUITE}"]
    assert " passed" in guest(*command, timeout=150).stdout
