"""What messages say where a name is not known.

In: the name, and those that are known. Out: `did you mean X?`, or all that are known.
"""

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = ["did_you_mean", "nearest_or_all"]


def did_you_mean(asked: str, known: Iterable[str], *, most: int = 1, cutoff: float = 0.6) -> str:
    """Return `did you mean X?` or `did you mean X, Y or Z?`; "" where nothing is near.

    Args:
        asked: the name that is not known.
        known: the names that are.
        most: so many are named at most, the nearest first.
        cutoff: how alike they must be, from 0, not at all, to 1.
    """
    *others, last = ["", *get_close_matches(asked, list(known), n=most, cutoff=cutoff)]
    near = " or ".join(filter(None, (", ".join(others[1:]), last)))
    return f"did you mean {near}?" if near else ""


def nearest_or_all(
    asked: str, known: Iterable[str], *, most: int = 1, cutoff: float = 0.6, advice: str = ""
) -> str:
    """Return `did you mean X?`, or `it has: X, Y` and the advice where nothing is near.

    Args: as `did_you_mean`, and
        advice: what else to do, such as "; give its opcode".
    """
    names = list(known)
    question = did_you_mean(asked, names, most=most, cutoff=cutoff)
    return question or f"it has: {', '.join(names) or 'none'}{advice}"
