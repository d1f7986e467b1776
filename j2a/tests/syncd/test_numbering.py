"""How many numbers the frames of a source have, by what it says of them and when."""

import random

import pytest

from j2a.syncd.numbering import SHORT, Numbering, nearest


@pytest.mark.parametrize("ppm", [-500, 0, 500])
@pytest.mark.parametrize("modulo", [1024, 2048])
@pytest.mark.parametrize(
    "gaps_s", [(0.004, 0.3), (0.5, 1.1), (1.024, 1.024), (2, 5), (5.1, 30), (0.01, 60)]
)
def test_the_modulus_is_found_whatever_lies_between_two_numbers(gaps_s, modulo, ppm):
    """A number of 2048 tells itself; those of 1024 are known by where they begin anew."""
    for seed in range(10):
        drawn = random.Random(seed)
        numbering, now_us = Numbering(), drawn.uniform(0, 3e6)
        first, has_told = drawn.randrange(2048), False
        for _ in range(600):
            frame = (first + int(now_us * (1 + ppm * 1e-6) / 1000)) % modulo
            numbering.see(frame, now_us + drawn.uniform(-0.1e6, 0.1e6))
            has_told |= frame >= SHORT
            if modulo == 1024:
                assert numbering.modulo in (None, SHORT)
            else:
                assert numbering.modulo == (2048 if has_told else None)
            now_us += 1e6 * drawn.uniform(*gaps_s)
        assert numbering.modulo == modulo


@pytest.mark.parametrize("modulo", [1024, 2048])
@pytest.mark.parametrize("off", [-0.49, -0.25, 0.0, 0.25, 0.49])
def test_a_number_stands_for_the_nearest_frame(modulo, off):
    for index in (0, 1, modulo - 1, modulo, 3 * modulo // 2, 7 * modulo + 5, 10**9):
        assert nearest(index + off * modulo, index % modulo, modulo) == index
