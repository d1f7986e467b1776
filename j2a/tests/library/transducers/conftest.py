"""A device with transducers of each sort, and a client of it."""

import pytest

from j2a.tests.library.support import linked

from .boards import make_device


@pytest.fixture
def device():
    with make_device() as made:
        yield made


@pytest.fixture
def board(device):
    with linked(device) as client:
        yield client
