"""What the line of the frames remembers after days in which nobody told the host's time.

8 * the frames since then are more than 32 bits hold when these are 2^29, 6 days and 5 hours.
"""

from pathlib import Path

import pytest

from firmware.tests.native_clock import run_with_clock

# Frames between two times that are told, of each step; what is remembered must be what 64 bits say.
CODE = r"""
#include <stdio.h>
#include "ext/j2a_clock_frames.c"

int main(void) {
    static const uint32_t gaps[] = {
        1, 10, 1000, 8000, 1UL << 20, (1UL << 29) - 1, 1UL << 29, (1UL << 29) + 1,
        (1UL << 29) + 125, 3UL << 28, 1UL << 30
    };
    enum { GAPS = sizeof gaps / sizeof gaps[0] };
    unsigned first, second, third;
    for (first = 0; first < GAPS; first++)
        for (second = 0; second < GAPS; second++)
            for (third = 0; third < GAPS; third++) {
                const uint32_t row[] = {gaps[first], gaps[second], gaps[third]};
                uint64_t span = 0;
                unsigned i;
                told_span = 0;
                for (i = 0; i < 3; i++) {
                    const uint64_t most = (uint64_t)MEMORY * row[i];
                    span = span + row[i] < most ? span + row[i] : most;
                    lead(0, row[i]);
                    if (told_span != span) {
                        printf("%u %u %u: %u, not %llu\n", row[0], row[1], row[2], told_span,
                               (unsigned long long)span);
                        return 1;
                    }
                }
            }
    return 0;
}
"""


@pytest.mark.requirement("SYNC-007")
def test_the_line_remembers_days_of_silence(need, tmp_path: Path) -> None:
    need("gcc")
    assert run_with_clock(CODE, tmp_path) == (0, "")
