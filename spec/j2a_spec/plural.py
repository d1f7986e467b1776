"""Counts of things, as messages say them.

In: a number, and the noun. Out: "1 byte", "2 bytes".
"""

__all__ = ["counted"]


def counted(count: object, one: str, more: str = "") -> str:
    """Return a number with its noun, in the singular for 1.

    Args:
        count: the number; of facts for JSON, which are of any type, too.
        one: the words for one, such as "byte" or "SIF was".
        more: those for any other number, such as "SIFs were"; not given, `one` with an "s".
    """
    return f"{count} {one if count == 1 else more or one + 's'}"
