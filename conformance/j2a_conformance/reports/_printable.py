"""Text of a device in a file of text: what XML and HTML cannot hold is shown in hex.

What flows in: any text, also names and properties that a broken device made up. What flows out:
text without control characters and without halves of surrogate pairs.
"""

import re
from typing import Final

__all__ = ["printable"]

_REFUSED: Final = re.compile("[^\t\n\r\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def printable(text: str) -> str:
    r"""Return the text with each character that XML refuses as `\xNN` or `\uNNNN`."""
    return _REFUSED.sub(lambda match: match[0].encode("unicode_escape").decode(), text)
