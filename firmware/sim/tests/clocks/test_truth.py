"""The models of truth: oscillators, the host's clock, starts of frames, delays."""

import numpy as np
import pytest
from j2a_sim._clocks.delays import SHARES, Delay, host_delay, quantiles, rfcomm, tcp
from j2a_sim._clocks.frames import NUMBERS, Bus, hub_delay_s
from j2a_sim._clocks.truth import HostClock, Oscillator, Slew, Step, crystal, temperature

HOUR_S = 3600.0


def rng(seed=1):
    return np.random.default_rng(seed)


def test_an_oscillator_counts_by_its_rate():
    fast = Oscillator(np.full(10, 100e-6))
    assert fast.elapsed_s(5.0) == pytest.approx(5.0005, abs=1e-12)
    assert fast.elapsed_s(1000.0) == pytest.approx(1000.1, abs=1e-9), "it goes on behind its grid"
    rising = Oscillator(np.array([0.0, 1e-6, 2e-6]))  # 1 ppm a second
    assert rising.elapsed_s(2.0) - 2 == pytest.approx(2e-6, abs=1e-14)
    assert rising.elapsed_s(0.5) - 0.5 == pytest.approx(0.125e-6, abs=1e-14)
    assert rising.rate(0.5) == pytest.approx(0.5e-6)


def test_one_time_gives_what_many_give():
    source = rng()
    clock = HostClock(source, 100.0, 50, steps=(Step(20.0, 0.5),), slews=(Slew(30.0, 5.0, 300),))
    oscillator = crystal(source, 100.0, 100, temperature(source, 100.0))
    times = np.concatenate([source.uniform(0, 130, 2000), np.arange(130.0)])
    for show in (oscillator.elapsed_s, clock.monotonic_us, clock.unix_us):
        assert show(times).tolist() == [show(one) for one in times.tolist()]


def test_true_time_is_the_inverse_of_elapsed_time():
    source = rng()
    oscillator = crystal(source, HOUR_S, 100, temperature(source, HOUR_S))
    times = source.uniform(0, HOUR_S, 10_000)
    assert np.abs(oscillator.true_s(oscillator.elapsed_s(times)) - times).max() < 1e-11
    ceramic = Oscillator(source.uniform(-5e-3, 5e-3, 100))
    times = source.uniform(0, 99, 1000)
    assert np.abs(ceramic.true_s(ceramic.elapsed_s(times)) - times).max() < 1e-11


def test_crystals_are_off_by_up_to_their_bound_and_differ():
    source = rng()
    rates = np.array([crystal(source, 10, 100).rates[0] for _ in range(400)]) * 1e6
    assert -100 <= rates.min() < -90 and 90 < rates.max() <= 100
    assert crystal(rng(5), 10, 100).rates[0] == crystal(rng(5), 10, 100).rates[0]


def test_temperature_warms_up_and_wanders():
    source = rng()
    runs = np.array([temperature(source, HOUR_S) for _ in range(50)])
    assert np.allclose(runs[:, 0], 0, atol=1e-9)
    assert runs[:, -1].min() > 3 and runs[:, -1].max() < 19
    assert np.abs(np.diff(runs, axis=1)).max() < 1, "no board jumps by a kelvin within a second"


def test_the_hosts_clock_follows_utc():
    for seed in range(10):
        clock = HostClock(rng(seed), HOUR_S, 100)
        times = np.arange(0, HOUR_S, 10.0)
        assert np.abs(clock.unix_us(times) - 1e6 * times).max() < 3000, "within some ms of truth"
        assert (np.diff(clock.unix_us(times)) > 0).all()
        alone = HostClock(rng(seed), HOUR_S, 100, ntp=False)
        assert np.array_equal(alone.unix_us(times), alone.monotonic_us(times))


def test_steps_and_slews_of_the_hosts_clock():
    plain = HostClock(rng(), 100.0)
    changed = HostClock(rng(), 100.0, steps=(Step(50, -3600.0),), slews=(Slew(20, 10, 500),))
    gain = changed.unix_us(np.array([19.0, 40.0, 49.999, 50.0])) - plain.unix_us(
        np.array([19.0, 40.0, 49.999, 50.0])
    )
    assert gain == pytest.approx([0, 5000, 5000, 5000 - 3600e6], abs=1)
    assert changed.monotonic_us(60.0) == plain.monotonic_us(60.0)


def test_frames_come_each_millisecond_and_their_numbers_wrap():
    bus = Bus(rng(), 10.0, Oscillator(np.zeros(12)))
    gaps = np.diff(bus.starts_s)
    assert np.abs(gaps - 1e-3).max() <= 1e-6
    assert gaps.mean() == pytest.approx(1e-3, abs=1e-9), "jitter does not add up"
    assert (np.diff(bus.numbers.astype(int)) % NUMBERS == 1).all()
    assert bus.numbers.max() == NUMBERS - 1 and bus.numbers.min() == 0
    off = Bus(rng(), 10.0, Oscillator(np.full(12, 100e-6)), 0)
    assert np.diff(off.starts_s) == pytest.approx(1e-3 / 1.0001, abs=1e-12)


def test_a_bus_that_sleeps_sends_no_frames():
    bus = Bus(rng(), 3.0, Oscillator(np.zeros(5)), sleeps=((1.0, 2.0),))
    assert not ((bus.starts_s >= 1) & (bus.starts_s < 2)).any()
    assert np.diff(bus.starts_s).max() == pytest.approx(1.0, abs=0.002)


def test_boards_share_frames_but_neither_hubs_nor_losses():
    source = rng()
    bus = Bus(source, 100.0, Oscillator(np.zeros(102)))
    one, other = bus.at_board(source, 10e-9, 0.01), bus.at_board(source, 300e-9, 0.01)
    assert other.starts_s - one.starts_s == pytest.approx(290e-9, abs=1e-12)
    assert 0.008 < one.lost.mean() < 0.012 and (one.lost != other.lost).any()
    assert not bus.at_board(source, 0, 0).lost.any()
    delays = [hub_delay_s(source) for _ in range(1000)]
    assert min(delays) >= 0 and 250e-9 < max(delays) <= 5 * 70e-9 + 26e-9


def test_delays_have_the_quantiles_that_were_recorded():
    samples = rng().exponential(100, 100_000)
    delay = Delay(SHARES, quantiles(samples))
    drawn = delay.draw_s(rng(2), 100_000) * 1e6
    assert np.quantile(drawn, [0.1, 0.5, 0.9]) == pytest.approx(
        np.quantile(samples, [0.1, 0.5, 0.9]), rel=0.05
    )
    assert drawn.max() <= samples.max() + 0.001
    assert delay.mean_us == pytest.approx(drawn.mean(), rel=0.05)
    with pytest.raises(ValueError, match="rise"):
        Delay((0, 0.5, 1), (3, 2, 1))


@pytest.mark.parametrize("load", ["light", "heavy"])
@pytest.mark.parametrize("kind", ["wake", "write"])
def test_the_recorded_delays_of_a_host_can_be_drawn(load, kind):
    drawn = host_delay(load, kind).draw_s(rng(), 1000)
    assert (drawn > 0).all() and drawn.max() < 1


def test_delays_of_networks():
    for delay, least_us, most_us in ((tcp(), 80, 2000), (rfcomm(), 1500, 20_000)):
        drawn = delay.draw_s(rng(), 100_000) * 1e6
        assert least_us <= drawn.min() and drawn.max() <= most_us
