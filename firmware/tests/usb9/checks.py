"""What a check is, and how a module makes its list of them.

In: functions that take a device, with the sentence as docstring. Out: Check objects in the order of
the file. Rule: a function that is decorated is in the list, and its name is module.function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from usb9.device import Device

Run = Callable[["Device"], None]


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that a device has to do.

    Attributes:
        name: area and what it is about, such as "addresses.zero".
        section: of the USB 2.0 specification.
        sentence: what is required.
        run: raises AssertionError, or an error of the simulator, when the device does not do it.
        marks: of pytest, for rules of spec/LINKS.md that it proves.
    """

    name: str
    section: str
    sentence: str
    run: Run
    marks: tuple[Any, ...] = field(default=(), compare=False)


def listing(checks: list[Check]) -> Callable[..., Callable[[Run], Run]]:
    """A decorator that adds to a module's list: check(section, *marks)."""

    def check(section: str, *marks: Any) -> Callable[[Run], Run]:
        def add(run: Run) -> Run:
            area = run.__module__.rpartition(".")[2]
            name = f"{area}.{run.__name__.strip('_').replace('_', '-')}"
            sentence = " ".join((run.__doc__ or "").split())
            checks.append(Check(name, section, sentence, run, marks))
            return run

        return add

    return check
