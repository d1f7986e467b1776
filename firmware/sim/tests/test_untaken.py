"""Runs without end keep little of what nobody takes."""

import threading
import time

import j2a_transports
import pytest
from j2a_sim import AvrSim, Runner
from j2a_sim._usb.driver import UsbHost

pytestmark = pytest.mark.avr

MOST = 2**16
LONG_S = 0.5  # of simulated time
WAIT_S = 60


def until_it_is_late(sim, serve):
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(stop,))
    thread.start()
    end = time.monotonic() + WAIT_S
    while sim.time_s < LONG_S and time.monotonic() < end:
        time.sleep(0.01)
    stop.set()
    thread.join(WAIT_S)
    assert sim.time_s >= LONG_S
    sim.run(sim.cycles(0.001))  # it may have dropped all just now


def test_a_runner_keeps_few_spans(simulate):
    sim = simulate("untaken")
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        until_it_is_late(sim, Runner(sim, listener, speed=100).serve)
    assert 0 < len(sim.spans()) < MOST * 1.1


def test_a_usb_host_keeps_few_spans_and_bytes_of_the_uart(firmware):
    with AvrSim(firmware("untaken", "atmega32u4"), "atmega32u4") as sim:
        until_it_is_late(sim, UsbHost(sim, speed=100).drive)
        assert 0 < len(sim.spans()) < MOST * 1.1
        assert 0 < sim.readable < MOST * 1.1


def test_what_is_taken_is_whole(simulate):
    """Less than that is kept, and a run that ends keeps all."""
    sim = simulate("untaken")
    sim.run(sim.cycles(0.01))
    sim.drop_untaken()
    kept = sim.readable
    assert kept == sim.counters.bytes_out > 100
    sim.run(sim.cycles(LONG_S))
    assert sim.readable == sim.counters.bytes_out > MOST
