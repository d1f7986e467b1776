"""`usb://` on the kernel's USB: what inside_usb.py asks, in the guest."""

import pytest

pytestmark = [pytest.mark.guest, pytest.mark.exhaustive]
SCRIPT = "transports/tests/guest/inside_usb.py"
INSIDE = ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", SCRIPT]
PATIENCE_S = 840


@pytest.mark.timeout(PATIENCE_S + 60)
def test_usb_on_the_kernels_stack(guest):
    assert " passed" in guest(*INSIDE, timeout=PATIENCE_S).stdout
