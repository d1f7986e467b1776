"""Makes a stream that fails as short and as plain as it gets.

What flows in: a stream and a judge. What flows out: a stream that fails too, from which no byte and
no pause can be taken, and in which no byte can be 0 that is not. Rules: pieces are taken away from
large to small (delta debugging), then bytes are set to 0, until neither changes anything.
"""

from collections.abc import Callable

from ._rules import Stream

__all__ = ["shrink"]

_PAUSE = -1
_Tokens = list[int]


def shrink(stream: Stream, fails: Callable[[Stream], bool]) -> Stream:
    """Return the shortest stream found that fails.

    Args:
        stream: a stream that fails.
        fails: tells whether a stream does.
    """
    known = {stream: True}

    def judge(tokens: _Tokens) -> bool:
        candidate = _stream(tokens)
        if candidate not in known:
            known[candidate] = fails(candidate)
        return known[candidate]

    tokens = _tokens(stream)
    before: _Tokens = []
    while before != tokens:
        before = tokens
        tokens = _plainer(_shorter(tokens, judge), judge)
    return _stream(tokens)


def _shorter(tokens: _Tokens, judge: Callable[[_Tokens], bool]) -> _Tokens:
    """Leave out runs, the longest first."""
    size = len(tokens) // 2 or 1
    while size:
        at = 0
        while at < len(tokens):
            candidate = tokens[:at] + tokens[at + size :]
            if judge(candidate):
                tokens = candidate
            else:
                at += size
        size //= 2
    return tokens


def _plainer(tokens: _Tokens, judge: Callable[[_Tokens], bool]) -> _Tokens:
    """Set to 0 what can be."""
    for at, token in enumerate(tokens):
        candidate = [*tokens[:at], 0, *tokens[at + 1 :]]
        if token not in (0, _PAUSE) and judge(candidate):
            tokens = candidate
    return tokens


def _tokens(stream: Stream) -> _Tokens:
    tokens: _Tokens = []
    for segment in stream:
        tokens += [_PAUSE] * bool(tokens) + list(segment)
    return tokens


def _stream(tokens: _Tokens) -> Stream:
    segments = [bytearray()]
    for token in tokens:
        if token == _PAUSE:
            segments.append(bytearray())
        else:
            segments[-1].append(token)
    return tuple(bytes(segment) for segment in segments if segment)
