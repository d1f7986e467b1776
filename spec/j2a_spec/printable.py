"""Text from the other end of a link, made safe to show.

In: any text, such as names, properties and debug text that a broken or hostile device made up.
Out: the same text with every control and format character escaped (ESC, C1, DEL, bidi controls,
separators, surrogates), so that it can neither drive a terminal nor be refused by XML.
"""

__all__ = ["printable"]


def printable(text: str, keep: str = "") -> str:
    r"""Return the text with each character that is not printable as `\xNN`, `\uNNNN` or `\n`.

    Args:
        text: any text; what Unicode calls printable stays as it is.
        keep: further characters that stay, such as a line feed where several lines are shown.
    """
    if text.isprintable():
        return text
    # A page has a million characters, of which a hundred are different.
    strange = {char for char in {*text} if not char.isprintable() and char not in keep}
    escapes = {ord(char): char.encode("unicode_escape").decode("ascii") for char in strange}
    return text.translate(escapes) if escapes else text
