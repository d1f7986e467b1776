"""Which case tests which requirement.

What flows in: requirements and cases. What flows out: for each requirement the ids of its cases,
or why it has none. A requirement that binds hosts alone cannot be seen at a device; it is
proved for our library, by its tests.
"""

from j2a_spec import requirements

from ._smoke import SMOKE
from .cases import load

__all__ = ["LIBRARY_TESTS", "coverage"]

LIBRARY_TESTS = "library tests"


def coverage() -> dict[str, str]:
    """Return, for each requirement id, its cases, "library tests", or "no case: " and why.

    A requirement that should have a case and has none gets "MISSING".
    """
    found = {}
    for requirement in requirements.load().values():
        cases = [case.ID for case in (*SMOKE, *load()) if requirement.id in case.REQUIREMENTS]
        if cases:
            found[requirement.id] = ", ".join(cases)
        elif requirement.exception:
            found[requirement.id] = f"no case: {requirement.exception}"
        else:
            found[requirement.id] = LIBRARY_TESTS if requirement.role == "host" else "MISSING"
    return found
