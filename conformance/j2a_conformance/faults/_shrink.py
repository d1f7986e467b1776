"""Makes a stream that fails as short and as plain as it gets.

What flows in: a stream and a judge. What flows out: a stream that fails too, from which no byte and
no pause can be taken, and in which no byte can be 0 that is not. Rules: pieces are taken away from
large to small (delta debugging), then bytes are set to 0, until neither changes anything.
"""

from collections.abc import Callable, Iterator

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
        for simpler in (_shorter, _plainer):
            tokens = _greedy(tokens, simpler, judge)
    return _stream(tokens)


def _greedy(
    tokens: _Tokens,
    simpler: Callable[[_Tokens], Iterator[_Tokens]],
    judge: Callable[[_Tokens], bool],
) -> _Tokens:
    """Go from one failing candidate to the next until none fails."""
    while True:
        found = next((candidate for candidate in simpler(tokens) if judge(candidate)), None)
        if found is None:
            return tokens
        tokens = found


def _shorter(tokens: _Tokens) -> Iterator[_Tokens]:
    """Leave out runs, the longest first."""
    size = len(tokens)
    while size:
        for at in range(0, len(tokens) - size + 1, max(size // 2, 1)):
            yield tokens[:at] + tokens[at + size :]
        size //= 2


def _plainer(tokens: _Tokens) -> Iterator[_Tokens]:
    for at, token in enumerate(tokens):
        if token not in (0, _PAUSE):
            yield [*tokens[:at], 0, *tokens[at + 1 :]]


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
