"""The policy for attempts: how many, after which failures, and what lies between them."""

import pytest
from j2a_conformance import Verdict
from j2a_conformance._judge import Judged, give_up
from j2a_conformance._retry import Retry


class Body:
    """Fails as often as it is told."""

    def __init__(self, failures, verdict=Verdict.FAILED, suspect=True):
        self.failures = failures
        self.verdict, self.suspect = verdict, suspect
        self.numbers = []

    def __call__(self, number):
        self.numbers.append(number)
        if len(self.numbers) <= self.failures:
            raise Judged(self.verdict, f"attempt {number}", self.suspect)
        return "passed"


def failure(retry, body, rest=lambda _: True):
    with pytest.raises(Judged) as caught:
        retry.run(body, rest)
    return caught.value


@pytest.mark.parametrize("failures", [0, 1, 2])
@pytest.mark.parametrize(("suspect", "every"), [(True, False), (True, True), (False, True)])
def test_attempts_go_on_until_one_passes(failures, suspect, every):
    body, rested = Body(failures, suspect=suspect), []
    assert Retry(3, every).run(body, lambda judged: rested.append(judged) is None) == "passed"
    assert body.numbers == [*range(1, failures + 2)]
    assert [judged.reason for judged in rested] == [f"attempt {n + 1}" for n in range(failures)]


@pytest.mark.parametrize(
    ("verdict", "suspect", "every"),
    [
        (Verdict.FAILED, False, False),
        (Verdict.INFORMATIONAL, True, True),
        (Verdict.UNIMPLEMENTED, True, True),
    ],
)
def test_other_failures_are_not_repeated(verdict, suspect, every):
    body = Body(1, verdict, suspect)
    assert not failure(Retry(3, every), body).final
    assert body.numbers == [1]


@pytest.mark.parametrize("every", [False, True])
def test_the_last_attempt_decides(every):
    body = Body(5)
    judged = failure(Retry(3, every), body)
    assert (judged.reason, body.numbers) == ("attempt 3", [1, 2, 3])
    # A stall of this machine may still be the cause; a lossy link had all its attempts.
    assert judged.final is every


def test_without_rest_there_is_no_other_attempt():
    body = Body(5)
    judged = failure(Retry(3, every=True), body, lambda _: False)
    assert (body.numbers, judged.final) == ([1], False)


def test_what_is_given_up_is_not_repeated():
    numbers = []

    def body(number):
        numbers.append(number)
        give_up("the link ended")

    assert failure(Retry(3, every=True), body).final
    assert numbers == [1]


def test_attempts_within_attempts_are_those_of_the_outer_ones():
    retry, inner = Retry(3), Body(1)
    outer = []

    def body(number):
        outer.append(number)
        return retry.run(inner)

    assert retry.run(body) == "passed"
    assert (outer, inner.numbers) == ([1, 2], [1, 2])
    assert retry.run(Body(2)) == "passed"  # the policy is ready for the next use


def test_what_one_policy_has_exhausted_another_does_not_repeat():
    body, outer = Body(99, suspect=False), []

    def case(number):
        outer.append(number)
        return Retry(4, every=True).run(body)

    assert failure(Retry(10, every=True), case).reason == "attempt 4"
    assert outer == [1]
