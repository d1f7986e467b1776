"""The estimate of a counter: its error on links of all kinds is inside what it says."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from j2a.protocol.clock import Estimator, Exchange, Verdict
from j2a.tests.library import simulated_clock as sim
from j2a.tests.library.simulated_clock import US, Board

BYTE_US = 10 * US / 115_200
SEEDS = range(3)
LINKS = [
    sim.serial,
    sim.symmetric,
    sim.asymmetric,
    sim.instant,
    sim.bursts,
    sim.latency_timer,
]


def readings(
    board: Board, estimator: Estimator, seconds: float, period_s: float = 1.0
) -> list[tuple[float, float, float]]:
    """Return time since the start, error and uncertainty, at five times between two exchanges."""
    begin, found = board.host_us, []
    for exchange, pause in sim.exchanges(board, seconds, period_s):
        estimator.add(exchange)
        estimate = estimator.estimate
        for share in (0.0, 0.1, 0.4, 0.7, 1.0) if estimate is not None else ():
            ahead = share * pause
            counter = board.counter_us + ahead * (1 + board.ppm * 1e-6)
            error = estimate.to_host(counter) - (board.host_us + ahead)
            found.append(((board.host_us - begin) / US, error, estimate.uncertainty_us(counter)))
    return found


def share_inside(found: list[tuple[float, float, float]]) -> float:
    return sum(abs(error) <= bound for _, error, bound in found) / len(found)


def rms(found: list[tuple[float, float, float]], after_s: float) -> float:
    errors = [error for at, error, _ in found if at >= after_s]
    return math.sqrt(sum(error * error for error in errors) / len(errors))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("wander_ppm", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("delays", LINKS, ids=lambda one: one.__name__)
def test_the_error_is_inside_the_uncertainty(
    delays: sim.Delays, wander_ppm: float, seed: int
) -> None:
    draw = random.Random(f"{delays.__name__} {wander_ppm} {seed}")
    board = Board(draw, delays, draw.uniform(-100, 100), wander_ppm)
    found = readings(board, Estimator(), 150)
    assert share_inside(found) >= 0.997


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("ppm", [-5000, -100, 30, 5000])
def test_a_uart_of_115200_baud_gives_20_us(ppm: float, seed: int) -> None:
    board = Board(random.Random(seed), sim.serial, ppm, 0.01, BYTE_US)
    found = readings(board, Estimator(BYTE_US), 90)
    assert rms(found, 30) <= 20
    assert share_inside(found) >= 0.997
    assert max(bound for at, _, bound in found if at > 30) < 200


@pytest.mark.parametrize("error", [-0.021, 0.021])
def test_a_uart_that_is_off_by_2_percent_stays_inside(error: float) -> None:
    board = Board(random.Random(1), sim.instant, 50, 0.0, BYTE_US * (1 + error))
    assert share_inside(readings(board, Estimator(BYTE_US), 90)) >= 0.997


def test_a_link_that_is_faster_than_its_baud_rate_has_no_speed() -> None:
    board = Board(random.Random(2), sim.serial, 50)
    estimator = Estimator(BYTE_US)
    found = readings(board, estimator, 60)
    assert estimator.byte_us == 0
    assert share_inside(found) >= 0.997


def test_asymmetry_is_not_hidden() -> None:
    """A link that takes 20 us there and 20 ms back cannot be told from one with 10 ms each."""
    board = Board(random.Random(3), lambda _: (20.0, 20_000.0))
    found = readings(board, Estimator(), 60)
    assert share_inside(found) == 1
    assert min(bound for _, _, bound in found) > 9_900


def test_a_sudden_change_of_the_rate_is_followed() -> None:
    board = Board(random.Random(4), sim.serial, 50)
    estimator = Estimator()
    readings(board, estimator, 60)
    board.ppm += 500
    found = readings(board, estimator, 60)
    assert rms(found, 10) < 50
    assert share_inside([one for one in found if one[0] > 2]) >= 0.997
    assert estimator.restarts == 0


def test_a_board_that_begins_anew_is_noticed_by_two_exchanges() -> None:
    board = Board(random.Random(5))
    estimator = Estimator()
    readings(board, estimator, 30)
    for _ in range(5):
        board.reset()
        assert estimator.add(board.exchange()) is Verdict.DOUBTED
        assert estimator.estimate is None
        assert estimator.add(board.exchange()) is Verdict.RESTARTED
        assert share_inside(readings(board, estimator, 10)) >= 0.997
    assert estimator.restarts == 5


def test_a_single_wrong_exchange_is_left_out() -> None:
    board = Board(random.Random(6))
    estimator = Estimator()
    readings(board, estimator, 30)
    for wrong in (-10_000_000, 5_000, 2**40):
        exchange = board.exchange()
        wrong_one = replace(exchange, received_us=exchange.received_us + wrong)
        assert estimator.add(wrong_one) is Verdict.DOUBTED
        board.run(US)
        assert estimator.add(board.exchange()) is Verdict.TAKEN
    assert estimator.restarts == 0
    assert share_inside(readings(board, estimator, 30)) >= 0.997


@pytest.mark.parametrize(
    "exchange",
    [
        Exchange(100.0, 90.0, 0),
        Exchange(100.0, math.nan, 0),
        Exchange(math.nan, 100.0, 0),
        Exchange(100.0, math.inf, 0),
        Exchange(-math.inf, 0.0, 0),
        Exchange(0.0, 2e7, 0),
        Exchange(0.0, 100.0, 0, 200),
        Exchange(0.0, 1e6, 0, 65535),
    ],
)
def test_what_contradicts_itself_is_rejected(exchange: Exchange) -> None:
    estimator = Estimator()
    assert estimator.add(exchange) is Verdict.ABSURD
    assert (estimator.rejected, estimator.taken, estimator.estimate) == (1, 0, None)


_any_us = st.floats(allow_nan=True, allow_infinity=True) | st.floats(0, 1e9)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.builds(
            Exchange,
            _any_us,
            _any_us,
            st.integers(0, 2**64 - 1) | st.integers(0, 10**9),
            st.integers(0, 65535) | st.integers(0, 100),
            st.integers(0, 300),
            st.integers(0, 300),
        ),
        max_size=20,
    )
)
def test_whatever_a_device_says_raises_nothing(exchanges: list[Exchange]) -> None:
    estimator = Estimator(BYTE_US, window=8)
    for exchange in exchanges:
        estimator.add(exchange)
        estimate = estimator.estimate
        if estimate is not None:
            assert estimate.error_us >= 0
            assert estimate.rate_error >= 0
            assert abs(estimate.rate) <= 0.0101
            assert math.isfinite(estimate.to_host(estimate.counter_us + 10**6))
    assert estimator.taken + estimator.rejected >= len(exchanges)


def test_an_estimate_turns_times_there_and_back() -> None:
    board = Board(random.Random(7), ppm=5000)
    estimator = Estimator()
    readings(board, estimator, 30)
    estimate = estimator.estimate
    assert estimate is not None
    for counter in (0.0, board.counter_us, board.counter_us + 1e9):
        assert estimate.to_counter(estimate.to_host(counter)) == pytest.approx(counter, abs=1e-3)


@pytest.mark.parametrize("late", [0, 1, 5])
def test_an_exchange_that_comes_late_takes_its_place(late: int) -> None:
    draw = random.Random(late)
    exchanges = [one for one, _ in sim.exchanges(Board(draw, sim.serial, ppm=80), 8)]
    ordered, other = Estimator(), Estimator()
    for one in exchanges:
        ordered.add(one)
    for one in [*exchanges[:late], *exchanges[late + 1 :], exchanges[late]]:
        assert other.add(one) is Verdict.TAKEN
    assert other.newest == exchanges[-1]
    assert other.estimate is not None and ordered.estimate is not None
    assert other.estimate.counter_us == ordered.estimate.counter_us
    assert other.estimate.host_us == pytest.approx(ordered.estimate.host_us, abs=0.01)
    assert other.estimate.rate == pytest.approx(ordered.estimate.rate, abs=1e-9)


@pytest.mark.parametrize("window", [2, 3, 8])
@pytest.mark.parametrize("behind", [1, 2, 7])
def test_one_that_comes_late_into_a_full_window_takes_its_place_and_that_of_the_oldest(
    window: int, behind: int
) -> None:
    exchanges = [one for one, _ in sim.exchanges(Board(random.Random(1), sim.serial, ppm=80), 20)]
    at = len(exchanges) - 1 - min(behind, window - 1)
    ordered, other = Estimator(window=window), Estimator(window=window)
    for one in exchanges:
        ordered.add(one)
    for one in [*exchanges[:at], *exchanges[at + 1 :], exchanges[at]]:
        assert other.add(one) is Verdict.TAKEN
    assert list(other._exchanges) == exchanges[-window:]
    assert other.newest == exchanges[-1]
    assert other.estimate is not None and ordered.estimate is not None
    assert other.estimate.host_us == pytest.approx(ordered.estimate.host_us, abs=0.01)


def test_what_was_is_as_uncertain_as_what_will_be() -> None:
    estimator = Estimator()
    readings(Board(random.Random(8), sim.serial), estimator, 30)
    estimate = estimator.estimate
    assert estimate is not None
    bound = estimate.error_us
    for passed in (1.0, 1e6, 1e9):
        before, bound = bound, estimate.uncertainty_us(estimate.counter_us + passed)
        assert bound > before
        assert estimate.uncertainty_us(estimate.counter_us - passed) == pytest.approx(bound)
