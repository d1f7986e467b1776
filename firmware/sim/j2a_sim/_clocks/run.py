"""One run of the bench: truth, boards, host, and the report.

In: settings. Out: a report. The same settings give the same one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from j2a.protocol.clock.estimator import WINDOW
from j2a_sim._clocks.avr import AvrBoard, build_firmware
from j2a_sim._clocks.frames import BoardFrames, Bus, hub_delay_s
from j2a_sim._clocks.host import START_S, Host
from j2a_sim._clocks.native import NativeBoard, build_board
from j2a_sim._clocks.report import Report, make_report
from j2a_sim._clocks.settings import Settings
from j2a_sim._clocks.truth import Floats, HostClock, Oscillator, Slew, Step, crystal, temperature
from j2a_sim._clocks.usb_host import UsbHost

__all__ = ["run"]

SLEW_S: Final = 60.0
CONTROLLER_PPM: Final = 100.0


def reading_times(settings: Settings, rng: Generator) -> Floats:
    """When all clocks are read: evenly, but for up to half a step, against beats."""
    count = max(10, settings.readings // settings.boards)
    step = (settings.seconds - START_S) / count
    times: Floats = START_S + (np.arange(count) + rng.uniform(0, 0.5, count)) * step
    return times


def host_clock(settings: Settings, rng: Generator) -> HostClock:
    """The clock of the host with what the settings do to it."""
    steps: tuple[Step, ...] = (
        () if settings.step_at is None else (Step(settings.step_at, settings.step_by),)
    )
    slews: tuple[Slew, ...] = ()
    if settings.slew_at is not None:
        slews = (Slew(settings.slew_at, SLEW_S, settings.slew_ppm),)
    return HostClock(rng, settings.seconds, steps=steps, slews=slews)


def frames_of(settings: Settings, rng: Generator) -> list[BoardFrames | None]:
    """The starts of frames at each board; None on other links."""
    if settings.link != "usb":
        return [None] * settings.boards
    sleeps: tuple[tuple[float, float], ...] = ()
    if settings.suspend_at is not None:
        sleeps = ((settings.suspend_at, settings.suspend_at + settings.suspend_for),)
    controller = crystal(rng, settings.seconds, CONTROLLER_PPM)
    jitter_s = settings.sof_jitter_ns * 1e-9
    bus = Bus(rng, settings.seconds, controller, jitter_s, sleeps)
    return [bus.at_board(rng, hub_delay_s(rng), settings.lost_sof) for _ in range(settings.boards)]


def oscillators(settings: Settings, rng: Generator) -> list[Oscillator]:
    """The crystals of the boards."""
    made = []
    for _ in range(settings.boards):
        kelvin = temperature(rng, settings.seconds) if settings.wander else None
        made.append(crystal(rng, settings.seconds, settings.ppm, kelvin))
    return made


def drift_us(settings: Settings, clock: HostClock, crystals: list[Oscillator]) -> float:
    """How far a clock that runs on at the rate of the start of holdover is off at its end."""
    if settings.holdover_at is None:
        return 0.0
    # The rate that a host knows is that of the exchanges which it keeps.
    begin_s, end_s = settings.holdover_at, settings.seconds
    before_s = max(0.0, begin_s - WINDOW * settings.period_s)
    worst = 0.0
    for crystal_ in crystals:
        at = np.array([before_s, begin_s, end_s])
        counted, shown = crystal_.elapsed_s(at), clock.unix_us(at) * 1e-6
        rate = (shown[1] - shown[0]) / (counted[1] - counted[0])
        told = shown[1] + rate * (counted[2] - counted[1])
        worst = max(worst, abs(float(told - shown[2])))
    return 1e6 * worst


def run(settings: Settings, progress: Callable[[float], object] = lambda _done_s: None) -> Report:
    """Do a run.

    Args:
        settings: of the run.
        progress: called with the simulated seconds that are over.

    Raises:
        SimError: the firmware cannot be built, or does not do what the bench needs.
    """
    for_host, for_frames, for_crystals, for_boards, for_readings, for_calls = (
        np.random.default_rng(part) for part in np.random.SeedSequence(settings.seed).spawn(6)
    )
    clock = host_clock(settings, for_host)
    times_s = reading_times(settings, for_readings)
    frames, crystals = frames_of(settings, for_frames), oscillators(settings, for_crystals)
    make: Any = NativeBoard
    if settings.chosen_engine == "avr":
        make = AvrBoard
        program: Any = build_firmware(settings.link)
    else:
        program = build_board(settings.link)
    boards = [
        make(
            program,
            rng=rng,
            oscillator=crystal_,
            frames=seen,
            link=settings.link,
            times_s=times_s,
        )
        for rng, crystal_, seen in zip(
            for_boards.spawn(settings.boards), crystals, frames, strict=True
        )
    ]
    is_usb = settings.link == "usb"
    host: Any = (UsbHost if is_usb else Host)(settings, for_calls, clock, boards)
    host.run(progress)
    more: dict[str, Any] = {
        "backwards": sum(board.backwards for board in boards),
        "slack_us": host.slack_us,
        "lost_calls": host.lost,
        "refused": host.refused,
    }
    readings = [board.readings for board in boards]
    if is_usb:
        readings = [
            replace(one, uncertainty_us=host.announced_us(number, times_s))
            for number, one in enumerate(readings)
        ]
    return make_report(
        settings,
        times_s,
        readings,
        clock,
        more=more,
        slack_us=host.slack_us,
        drift_us=drift_us(settings, clock, crystals),
        cpu_us=host.cpu_us,
    )
