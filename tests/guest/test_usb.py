"""`usb://` on the kernel's USB: what inside_usb.py asks, in the guest."""

import pytest

pytestmark = pytest.mark.guest
INSIDE = ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/guest/inside_usb.py"]


@pytest.mark.parametrize("part", ["TestStream", "not TestStream"])
def test_usb_on_the_kernels_stack(guest, part):
    assert " passed" in guest(*INSIDE, "-k", part).stdout
