"""The multiplication of the clock on AVRs: those with a multiplier, and those that have a loop."""

import random
from pathlib import Path

import pytest

import j2a

APP = Path(__file__).with_name("product")
LARGEST = 2**30 - 1  # of the first factor, see j2a_clock.h
ENDS = (0, 1, -1, 2, -2, 255, -256, 65535, 65536, -65536, LARGEST, -LARGEST)
CALLS = 300

pytestmark = pytest.mark.avr


@pytest.mark.sampled(2)  # they multiply by the same instructions
@pytest.mark.parametrize("mcu", ["atmega32u2", "atmega328p"])
def test_no_bit_is_lost(build, mcu):
    elf = build(
        "product",
        "avr-serial",
        APP_DIR=str(APP),
        MCU=mcu,
        OPTIONS="-DJ2A_WITH_SYNC=1",
    )
    chance = random.Random(5)
    pairs = [(a, b) for a in ENDS for b in (*ENDS, 2**31 - 1, -(2**31))]
    for _ in range(CALLS):
        bits_a, bits_b = chance.randrange(1, 31), chance.randrange(1, 32)
        pairs.append((chance.randrange(-(2**bits_a) + 1, 2**bits_a), chance.getrandbits(bits_b)))
        pairs.append((pairs[-1][0], ~pairs[-1][1]))
    with j2a.connect(f"sim:{elf}?mcu={mcu}", timeout=10) as board:
        for a, b in pairs:
            high, low = board.functions.product(a, b)
            assert high << 32 | low == a * b, (a, b)
