"""`make demo` counts the cases that its device does not implement."""

import pytest

from tools.demo import shortened


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        (
            "unimplemented: boot.first, boot.once: the device does not announce boot\n",
            "unimplemented: 2 cases: the device does not announce boot\n",
        ),
        (
            "unimplemented: many.return-values: no function: retMany\n",
            "unimplemented: 1 case: no function: retMany\n",
        ),
        ("The device is conformant; 21.5 s.\n", "The device is conformant; 21.5 s.\n"),
    ],
)
def test_cases_of_one_reason_are_counted(line, shown):
    assert shortened(line) == shown
