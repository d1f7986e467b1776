"""Text of a device in a file of text, such as XML and HTML.

What flows in: any text of one line or several, also names and properties that a broken device made
up. What flows out: text without control and format characters and without halves of surrogate
pairs.
"""

from j2a_spec.printable import printable

__all__ = ["file_text"]


def file_text(text: str) -> str:
    """Return the text with each character escaped that XML refuses or that a viewer acts on."""
    return printable(text, "\n\r\t")
