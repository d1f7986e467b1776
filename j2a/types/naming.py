"""Names for generated files: what other languages reserve, and names that differ.

What flows in: names that a board gives to transducers, types and fields. What flows out: names that
can stand in C, C++, Python and ROS.
"""

import keyword
import re
from collections.abc import Container
from typing import Final

__all__ = ["C_KEYWORDS", "CNames", "free_name", "is_reserved"]

_OF_C: Final = """
auto break case char const continue default do double else enum extern float for goto if inline
int long register restrict return short signed sizeof static struct switch typedef union
unsigned void volatile while
"""
_FURTHER: Final = """
alignas alignof and and_eq asm bitand bitor bool catch char16_t char32_t char8_t class co_await
co_return co_yield compl concept const_cast consteval constexpr constinit decltype delete
dynamic_cast explicit export false friend int128_t main mutable namespace new noexcept not
not_eq nullptr operator or or_eq private protected public reinterpret_cast requires
static_assert static_cast template this thread_local throw true try typeid typename typeof
typeof_unqual using virtual wchar_t xor xor_eq
"""
C_KEYWORDS: Final = frozenset(_OF_C.split())
"""What C99 reserves, apart from names that begin with an underscore."""
_C_WORDS: Final = C_KEYWORDS.union(_FURTHER.split())
_C_OF_HEADERS: Final = re.compile(
    r"_[A-Z_].*|linux|unix|u?int(_least|_fast)?[0-9]+_t|u?int(ptr|max)_t"
    r"|(U?INT\w*|SIZE|WCHAR|WINT|PTRDIFF|SIG_ATOMIC)_(MIN|MAX|C)"
)


def is_reserved(name: str) -> bool:
    """Whether C++ or Python reserves a name."""
    return name in _C_WORDS or keyword.iskeyword(name)


def free_name(name: str, taken: Container[str], between: str = "") -> str:
    """Return a name that is not taken, with a number behind it, and `between`, if need be."""
    made, number = name, 1
    while made in taken:
        number += 1
        made = f"{name}{between}{number}"
    return made


class CNames:
    """Names in one scope of C that differ from each other and from reserved ones.

    Args:
        taken: by others.
    """

    def __init__(self, *taken: str) -> None:
        self._taken = set(taken)

    def give(self, name: str) -> str:
        """Return a name; one that C, C++ or a header of theirs reserves ends in an underscore."""
        made = f"x{name}" if _C_OF_HEADERS.fullmatch(name) and name[0] == "_" else name
        if made in _C_WORDS or _C_OF_HEADERS.fullmatch(made):
            made += "_"
        made = free_name(made, self._taken)
        self._taken.add(made)
        return made
