"""The oracle of the disciplined clock, about devices that keep its rules and one that does not."""

from fractions import Fraction

import pytest
from j2a_spec import constants as c
from j2a_spec.clock import Clock
from j2a_spec.grammar import CLOCK_ADJUST

_US = 10**6
_PPB = 10**9
_RATES = (10_000_000, -10_000_000, -10_000_000, 0)


def _is_right(begins_us, apart_us):
    """Tell whether the oracle takes a device for right whose time runs by each rate from so long
    after its adjustment on, without a correction; the first adjustment is a step.
    """
    clock, local, time, rate = Clock(), _US, _US * _PPB, 0  # the time in 10^-9 us
    begins: dict[int, int] = {}
    for number, ppb in enumerate(_RATES):
        target = {"mode": c.CLOCK_SLEW, "local": local, "time": time // _PPB, "rate": ppb}
        request = CLOCK_ADJUST.build({**target, "uncertainty": 0, "wander": 0})
        off = Fraction(-(time % _PPB), _PPB)
        assert clock.code(bytes(request), local, off=off) == c.RET_OK
        begins[local + (begins_us if number else 0)] = ppb
        is_last = number == len(_RATES) - 1
        for _ in range(20_000 if is_last else apart_us):
            rate = begins.get(local, rate)
            local, time = local + 1, time + _PPB + rate
            if local % 50 == 0:
                low, high = clock.bounds(local).time
                if not low <= time // _PPB <= high:
                    return False
    return True


@pytest.mark.parametrize("begins_us", [0, 1024, 4999])
@pytest.mark.parametrize("apart_us", [100, 500, 1500, 4000, 10_000])
def test_the_time_may_run_as_before_for_5_ms_behind_each_adjustment(begins_us, apart_us):
    assert _is_right(begins_us, apart_us)


def test_the_time_may_not_run_as_before_for_longer():
    assert not _is_right(7000, 10_000)
