"""How often something is done at most, and after which failures it is done again.

What flows in: a function that returns, or raises `Judged`. What flows out: its result, or its last
failure. Rules: only a suspect failure is repeated, which a stall of this machine could have caused;
on a lossy link, each one; an attempt within an attempt of the same policy is not repeated, because
the outer one may have changed the state of the testee.
"""

from collections.abc import Callable
from typing import TypeVar

from ._judge import Judged
from ._model import Verdict

__all__ = ["Retry"]

_Result = TypeVar("_Result")


class Retry:
    """A policy for attempts.

    Args:
        attempts: how many there are at most.
        every: each failure is repeated, not only a suspect one.
    """

    def __init__(self, attempts: int, every: bool = False) -> None:
        self._attempts = attempts
        self._every = every
        self._attempt = 0

    def run(
        self,
        body: Callable[[int], _Result],
        rest: Callable[[Judged], bool] = lambda _: True,
    ) -> _Result:
        """Do `body` until it passes, and return what it returns.

        Args:
            body: takes the number of the attempt, from 1.
            rest: called between two attempts with the failure; brings the testee to rest, or
                returns False where it cannot.

        Raises:
            Judged: the last attempt failed, or another one would not help.
        """
        if self._attempt:
            return body(self._attempt)
        try:
            while True:
                self._attempt += 1
                try:
                    return body(self._attempt)
                except Judged as judged:
                    if not self._repeats(judged):
                        raise
                    is_last = self._attempt == self._attempts
                    judged.final = self._every and is_last
                    if is_last or not rest(judged):
                        raise
        finally:
            self._attempt = 0

    def _repeats(self, judged: Judged) -> bool:
        return (
            judged.verdict is Verdict.FAILED
            and not judged.final
            and (judged.suspect or self._every)
        )
