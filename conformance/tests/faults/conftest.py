"""What the tests of the faults share: devices of the reference implementation behind an opener."""

from itertools import count

import j2a_transports
import pytest
from j2a_conformance.faults._experiment import player_for

_names = count()


@pytest.fixture
def player_of(reference):
    """Return a function: a mixin that breaks the reference device, to what judges it."""

    def make(mixin=object):
        device = type("Device", (mixin, reference), {}) if mixin is not object else reference

        def opener():
            here, there = j2a_transports.pair()
            device(there)
            return here

        return player_for(opener, starts=True)

    return make
