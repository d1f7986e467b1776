"""The transport in simulated time, and its pacing by the wall clock."""

import gc
import threading
import time

import j2a_transports
import pytest
from j2a_sim import AvrSim, SimError, SimLink
from j2a_sim._link import open_url
from j2a_sim._pace import MAX_LAG_S, Pacer
from j2a_transports import BadUrl, LinkClosed, LinkLost, OpenFailed, Url

pytestmark = pytest.mark.avr

SECOND = 16_000_000


@pytest.fixture
def link(simulate):
    return SimLink(simulate("echo"))


def read_all(link, count, timeout_s=1.0):
    data = b""
    while len(data) < count:
        more = link.read(timeout_s)
        assert more, f"{len(data)} of {count} bytes came"
        data += more
    return data


def test_echo(link):
    data = bytes(range(256)) * 4
    link.write(memoryview(data))
    assert read_all(link, len(data)) == data
    assert not link.closed


def test_a_byte_takes_its_time_on_the_wire(link):
    assert link.byte_time_s == pytest.approx(10 / link.sim.baud)


def test_timeouts_are_simulated(link):
    began = link.clock()
    assert link.read(2.5) == b""
    assert 2.5 <= link.clock() - began < 2.501
    # One character of 1360 cycles each way.
    link.write(b"x")
    assert link.read(0.0001) == b""
    assert link.read(0.001) == b"x"


def test_polling_lets_time_pass(link):
    link.write(b"x")
    began = link.clock()
    calls = 1
    while not (data := link.read(0)):
        calls += 1
    assert data == b"x"
    assert link.clock() - began == pytest.approx(calls * 1e-5, rel=0.3, abs=3e-4)


def test_sleep_keeps_what_arrives(link):
    link.write(b"abc")
    link.sleep(0.1)
    began = link.clock()
    assert link.read(1.0) == b"abc"
    assert link.clock() - began < 0.001


def test_a_read_returns_what_follows_without_a_gap(link):
    link.write(b"abc")
    assert link.read(1.0) == b"abc"
    link.write(b"abc")
    link.sleep(5 * 1360 / SECOND)
    link.write(b"def")
    assert read_all(link, 6) == b"abcdef"


def test_the_same_calls_give_the_same_cycles(simulate):
    def record():
        link = SimLink(simulate("echo_irq"))
        cycles = []
        for i in range(20):
            link.write(bytes(i))
            if i:
                read_all(link, i)
            cycles.append(link.sim.cycle)
        return cycles

    assert record() == record()


def test_a_write_from_another_thread_ends_a_read(link):
    got = []
    reader = threading.Thread(target=lambda: got.append(link.read(None)))
    reader.start()
    link.write(b"hello")
    reader.join(60)
    assert got == [b"hello"]


def test_close_ends_a_read(link):
    failed = []

    def read():
        try:
            link.read(None)
        except LinkClosed as error:
            failed.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    link.close()
    link.close()
    reader.join(60)
    assert len(failed) == 1
    assert link.closed
    for call in (lambda: link.read(0), lambda: link.write(b""), lambda: link.sleep(0.1)):
        with pytest.raises(LinkClosed):
            call()


def test_an_idle_reader_waits_in_real_time(simulate):
    link = SimLink(simulate("echo"), patience_s=0.05)
    threading.Timer(0.3, link.close).start()
    began_s, began_simulated_s = time.monotonic(), link.clock()
    with pytest.raises(LinkClosed):
        link.read(None)
    # At full speed it would be some 6 s.
    assert link.clock() - began_simulated_s < 0.05 + (time.monotonic() - began_s) + 0.01


def test_a_waiting_reader_takes_a_write_at_once(simulate):
    link = SimLink(simulate("echo"), patience_s=0.001)
    assert link.read(0.01) == b""
    got = []
    reader = threading.Thread(target=lambda: got.append(link.read(None)))
    reader.start()
    link.write(b"x")
    reader.join(60)
    assert got == [b"x"]


def test_speed_limits_simulated_time(simulate):
    link = SimLink(simulate("echo"), speed=1.0)
    began_s = time.monotonic()
    assert link.read(0.1) == b""
    assert time.monotonic() - began_s > 0.09
    with pytest.raises(SimError, match="negative"):
        SimLink(link.sim, speed=-1)


@pytest.mark.parametrize("how", [b"i", b"j", b"s"])
def test_a_stopped_firmware_is_a_lost_link(simulate, how):
    link = SimLink(simulate("stop"))
    assert link.read(1.0) == b"0"
    link.write(how)
    with pytest.raises(LinkLost, match="the firmware stopped"):
        link.read(1.0)
    for call in (lambda: link.read(0), lambda: link.write(b"x"), lambda: link.sleep(1)):
        with pytest.raises(LinkLost):
            call()


def test_what_came_before_the_end_is_read_first(simulate):
    link = SimLink(simulate("stop"))
    link.write(b"i")
    assert link.read(1.0) == b"0"
    with pytest.raises(LinkLost):
        link.read(1.0)


def test_open_by_url(firmware):
    elf = firmware("echo", BAUD=1_000_000)
    options = "?mcu=atmega328p&freq=8e6&uart=0&baud=500000&patience=none&speed=100"
    with open_url(Url.parse(f"sim:{elf}{options}")) as link:
        assert isinstance(link, SimLink)
        assert link.sim.baud == 500_000
        link.write(b"by url")
        assert read_all(link, 6) == b"by url"
    with open_url(Url.parse(f"sim:{elf}", {"freq": 16_000_000})) as link:
        assert link.sim.baud == 1_000_000


def test_the_default_speed_can_be_written(firmware):
    with open_url(Url.parse(f"sim:{firmware('echo')}?speed=0")) as link:
        link.write(b"x")
        assert read_all(link, 1) == b"x"


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("mcu", "not an option of the form name=value"),
        ("colour=red", "unknown option 'colour'"),
        ("freq=0", "takes a clock in Hz from 1 to 100000000"),
        ("freq=inf", "takes a clock in Hz from 1 to 100000000"),
        ("baud=-1", "takes a number above 0"),
        ("speed=fast", "takes 0 for as fast as possible"),
        ("speed=-1", "takes 0 for as fast as possible"),
        ("patience=0", "takes a number of seconds above 0, or none"),
    ],
)
def test_a_wrong_option_is_a_bad_url(firmware, option, says):
    with pytest.raises(BadUrl, match=says):
        open_url(Url.parse(f"sim:{firmware('echo')}?{option}"))


@pytest.mark.parametrize(
    "url", ["sim:", "sim:?speed=0", "sim:a.elf?x", "sim:a.elf?link=usb&uart=0"]
)
def test_a_url_that_can_never_be_opened_is_refused_before_that(url):
    with pytest.raises(BadUrl):
        j2a_transports.check(url)
    j2a_transports.check("sim:not-built-yet.elf?speed=0")


def test_a_firmware_that_cannot_run_is_open_failed(firmware, tmp_path):
    with pytest.raises(OpenFailed, match="build the firmware first"):
        open_url(Url.parse(f"sim:{tmp_path}/none.elf"))
    with pytest.raises(OpenFailed, match="does not know this MCU"):
        open_url(Url.parse(f"sim:{firmware('echo')}?mcu=atmega9"))


class Clock:
    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def test_pacer_waits_when_ahead_and_forgets_what_is_late():
    clock = Clock()
    pacer = Pacer(2.0, clock)
    pacer.restart(5.0)
    assert pacer.wait_s(5.0) == 0
    assert pacer.wait_s(5.5) == pytest.approx(0.25)
    clock.now += 0.25
    assert pacer.wait_s(5.5) == 0
    # A little late: made up for.
    clock.now += MAX_LAG_S / 2
    assert pacer.wait_s(5.5) == 0
    assert pacer.wait_s(5.5 + 2 * MAX_LAG_S) == pytest.approx(MAX_LAG_S / 2)
    # Very late: simulated time goes on from here.
    clock.now += 10
    assert pacer.wait_s(6.0) == 0
    assert pacer.wait_s(6.5) == pytest.approx(0.25)


@pytest.mark.parametrize("options", ["mcu=atmega32u4", "mcu=atmega32u4&link=usb"])
def test_a_firmware_that_does_not_come_up_leaves_no_simulator_behind(firmware, options):
    """Not even until the garbage collector has a turn: each takes 16 MB."""
    elf = firmware("poke", "atmega32u4")
    gc.collect()
    gc.disable()
    try:
        with pytest.raises(OpenFailed):
            open_url(Url.parse(f"sim:{elf}?{options}"))
        sims = [found for found in gc.get_objects() if isinstance(found, AvrSim)]
        assert not [sim for sim in sims if sim._sim is not None and sim.program.path == elf]
    finally:
        gc.enable()
