"""From SIFs to samples: each by the descriptors of its time, whoever learns others meanwhile."""

import struct
import threading
from types import SimpleNamespace

import pytest

import j2a.io.samples
from j2a.errors import WrongArgument
from j2a.events import Sif
from j2a.io.samples import SampleSource
from j2a.types.coding import PythonTypes
from j2a.types.descriptors import parse_descriptors
from j2a.types.samples import SampleCodec

from .support import PATIENCE_S

OLD = parse_descriptors("\nsensor temp 9 1 i16 mV\n")
NEW = parse_descriptors("\nsensor temp 9 1 i16 Cel\n scale 1000\n")


class World:
    """A source, what its device has, and of which epoch that is."""

    def __init__(self):
        self.device = SimpleNamespace(descriptors=OLD, types=PythonTypes())
        self.epoch = 0
        self.source = SampleSource("x:", self.device, lambda: 0.0, lambda: self.epoch)

    def take(self, epoch):
        """Return what a SIF is that came in an epoch: unit and values, or None."""
        self.source.take(Sif(9, struct.pack("<Qh", 5, 7), 0, 0, epoch=epoch))
        sample = self.source.current
        return sample and (sample.unit, sample.values, sample.sequence)


@pytest.mark.requirement("J2A-TRANS-027")
def test_a_sif_is_read_by_the_descriptors_of_its_time():
    """It may wait behind a slow handler until all has been learnt anew after a restart."""
    world = World()
    assert world.take(0) == ("mV", (7,), 0)
    world.device.descriptors, world.epoch = None, -1
    assert world.take(0) == ("mV", (7,), 1)
    assert world.take(1) is None
    world.device.descriptors = NEW  # of epoch 1, which is not told yet
    assert world.take(0) == ("mV", (7,), 2)
    assert world.take(1) is None
    world.epoch = 1
    assert world.take(0) == ("mV", (7,), 3)
    assert world.source.latest("temp") is None
    assert world.take(1) == ("Cel", (7000.0,), 4)
    assert world.source.latest("temp").unit == "Cel"
    assert world.take(0) is None
    assert world.take(2) is None


def test_descriptors_that_change_while_a_sif_is_read():
    """The epoch is looked at before and behind: what lies in between may be of either."""
    world = World()
    assert world.take(0) == ("mV", (7,), 0)
    epochs = iter((0, -1))
    world.source._epoch = lambda: next(epochs)
    world.device.descriptors = NEW
    assert world.take(0) == ("mV", (7,), 1)


def test_nobody_sees_descriptors_without_what_follows_from_them(monkeypatch):
    world = World()
    goes_on, begun, found = threading.Event(), threading.Event(), []

    def slow(*args):
        begun.set()
        assert goes_on.wait(PATIENCE_S)
        return SampleCodec(*args)

    monkeypatch.setattr(j2a.io.samples, "SampleCodec", slow)
    threads = [
        threading.Thread(target=lambda: found.append(world.source.names())) for _ in range(2)
    ]
    threads[0].start()
    assert begun.wait(PATIENCE_S)
    threads[1].start()
    threads[1].join(0.1)  # Enough for one that does not wait; no need to be.
    goes_on.set()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert found == [["temp"], ["temp"]]


@pytest.mark.requirement("J2A-TRANS-026")
@pytest.mark.parametrize(
    ("times", "then", "lost"),
    [
        ((5,), (4,), 2),
        ((5,), (5,), 65_534),
        ((4, 5), (4,), 2),  # the last one that came counts
        ((5, 4), (4,), 65_534),
        ((5, 0), (4,), 2),  # of which 0 is none
        ((0, 5), (4,), 2),
        ((0, 0), (4,), 65_534),
        ((5,), (0, 4), 2),  # the first one in the SIF
        ((5,), (0, 6), 65_534),
        ((5,), (0, 0), 65_534),
        ((5,), (6, 4), 65_534),
        ((5,), (4, 6), 2),
    ],
)
@pytest.mark.parametrize("is_without_times_between", [False, True])
def test_losses_behind_a_reset_are_judged_by_the_first_time_and_the_last(
    times, then, lost, is_without_times_between
):
    world = World()
    world.device.descriptors = parse_descriptors("\nsensor log 9 2 u8\n queue 9\n")

    def take(told, times):
        entries = b"".join(struct.pack("<BQB", 0, time_us, 7) for time_us in times)
        world.source.take(Sif(9, struct.pack("<H", told) + entries, 0, 0, epoch=0))
        return world.source.current.lost

    assert take(3, times) == 0
    assert take(4, times) == 1
    if is_without_times_between:
        assert take(4, (0,)) == 0
    assert take(2, then) == lost


@pytest.mark.parametrize("size", [243, 244, 245, 246, 247])
def test_an_order_fits_into_a_frame_to_its_last_byte(size):
    [one] = parse_descriptors(f"\nactuator long 9 1 u8[{size}]\n").transducers
    codec = SampleCodec(one, PythonTypes())
    if size <= 255 - 2 - 9:
        assert len(codec.pack_set([[0] * size], 0, 5)) == 9 + size
    else:
        with pytest.raises(WrongArgument, match="1 values do not fit"):
            codec.pack_set([[0] * size], 0, 5)
