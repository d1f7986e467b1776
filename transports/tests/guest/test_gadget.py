"""A gadget on the kernel's USB: what inside_gadget.py asks, in the guest."""

import pytest

from .conftest import tool

# test_usb.py uses the gadget, too, as the far end.
pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]
SCRIPT = "transports/tests/guest/inside_gadget.py"
INSIDE = ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", SCRIPT]
PATIENCE_S = 840


def dummy_hcd() -> str:
    """Return the file of the module that the guest has loaded, to load it anew."""
    kernel = tool("guest_kernel")
    return str(kernel.kernel(kernel.cache_folder()) / "dummy_hcd.ko")


@pytest.mark.timeout(PATIENCE_S + 60)
def test_a_gadget_on_the_kernels_usb(guest):
    """The suite of the transports from either end, and what the bus says, in one boot."""
    command = ["env", f"J2A_DUMMY_HCD={dummy_hcd()}", *INSIDE]
    assert " passed" in guest(*command, timeout=PATIENCE_S).stdout
