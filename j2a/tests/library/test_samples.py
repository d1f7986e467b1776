"""From SIFs to samples: each by the descriptors of its time, whoever learns others meanwhile."""

import math
import re
import struct
import threading
from fractions import Fraction
from types import SimpleNamespace

import pytest

import j2a.io.samples
from j2a.errors import WrongArgument
from j2a.events import Sif
from j2a.io.samples import SampleSource
from j2a.protocol.session import BOOT_EPOCHS
from j2a.types.coding import PythonTypes
from j2a.types.datasheet import data_sheets
from j2a.types.descriptors import parse_descriptors
from j2a.types.samples import SampleCodec
from j2a.types.scaled_numbers import in_unit

from .support import PATIENCE_S

OLD = parse_descriptors("\nsensor temp 9 1 i16 mV\n")
NEW = parse_descriptors("\nsensor temp 9 1 i16 Cel\n scale 1000\n")
LOG = "\nsensor log 9 2 u8\n queue 9\n"


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

    def take_queued(self, told, times, epoch=None):
        """Return the sample that a SIF of LOG is; it came in that epoch, by default that of now."""
        entries = b"".join(struct.pack("<BQB", 0, time_us, 7) for time_us in times)
        came = self.epoch if epoch is None else epoch
        self.source.take(Sif(9, struct.pack("<H", told) + entries, 0, 0, epoch=came))
        return self.source.current


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
    world.device.descriptors = parse_descriptors(LOG)

    def take(told, times):
        return world.take_queued(told, times).lost

    assert take(3, times) == 0
    assert take(4, times) == 1
    if is_without_times_between:
        assert take(4, (0,)) == 0
    assert take(2, then) == lost


@pytest.mark.requirement("J2A-TRANS-026")
@pytest.mark.parametrize("restarts", [0, 1])
@pytest.mark.parametrize(
    ("told", "time_us", "lost", "is_reset"),
    [(7, 6, 4, False), (3, 6, 0, False), (2, 6, 65_535, False), (2, 4, 2, True)],
)
def test_losses_are_known_behind_descriptors_learnt_anew_unless_a_boot_sif_came(
    told, time_us, lost, is_reset, restarts
):
    """They are also learnt anew when SIFs were lost: a restart would explain that, too."""
    world = World()
    world.device.descriptors = parse_descriptors(LOG)
    assert world.take_queued(3, (5,)).lost == 0
    world.device.descriptors, world.epoch = None, -1
    assert world.take_queued(3, (5,)) is None
    world.device.descriptors = parse_descriptors(LOG)
    world.epoch = restarts * BOOT_EPOCHS or 1
    sample = world.take_queued(told, (time_us,))
    assert (sample.lost, sample.is_reset) == (0 if restarts else lost, is_reset)
    assert world.take_queued(told + 5, (time_us,)).lost == 5


@pytest.mark.requirement("J2A-TRANS-026", "J2A-TRANS-027")
def test_sifs_that_waited_while_all_was_learnt_anew_count_for_those_behind_them():
    world = World()
    world.device.descriptors = parse_descriptors(LOG)
    assert world.take_queued(0, (10,)).lost == 0
    world.device.descriptors, world.epoch = parse_descriptors(LOG), 1
    assert world.source.names() == ["log"]
    sample = world.take_queued(5, (20,), epoch=0)
    assert (sample.lost, sample.is_reset) == (5, False)
    sample = world.take_queued(5, (15,))
    assert (sample.lost, sample.is_reset) == (0, True)


@pytest.mark.parametrize("size", [243, 244, 245, 246, 247])
def test_an_order_fits_into_a_frame_to_its_last_byte(size):
    [one] = parse_descriptors(f"\nactuator long 9 1 u8[{size}]\n").transducers
    codec = SampleCodec(one, PythonTypes())
    if size <= 255 - 2 - 9:
        assert len(codec.pack_set([[0] * size], 0, 5)) == 9 + size
    else:
        with pytest.raises(WrongArgument, match="1 value does not fit"):
            codec.pack_set([[0] * size], 0, 5)


@pytest.mark.parametrize(
    ("lines", "value", "told", "sheet"),
    [
        ("i32 mm\n scale 0.001\n range -1, 1234567", 5000, "-0.001 mm to 1234.567 mm, not 5000 mm",
         "-0.001 mm to 1234.567 mm"),
        ("i16 V\n scale -0.5\n offset 1\n range 0, 10", 2, "-4 V to 1 V, not 2 V", "-4 V to 1 V"),
        ("f32\n range -0.1, 16777216", 3e7, "-0.1 to 16777216, not 30000000", "-0.1 to 16777216"),
        ("f32\n range 0, 1", 1.0000001, "0 to 1, not 1.0000001", "0 to 1"),
        ("f64 s\n range 0, 1732785000", 1732785000.5, "0 s to 1732785000 s, not 1732785000.5 s",
         "0 s to 1732785000 s"),
        ("i32 s\n range 0, 1732785000", -1, "0 s to 1732785000 s, not -1 s", "0 s to 1732785000 s"),
    ],
)  # fmt: skip
def test_ranges_are_told_in_order_and_with_their_digits(lines, value, told, sheet):
    board = parse_descriptors(f"\nactuator a 1 1 {lines}\n")
    with pytest.raises(WrongArgument) as caught:
        SampleCodec(board["a"], PythonTypes()).pack_set([value], 0, 0)
    assert re.sub(r" \(raw .*?\)", "", str(caught.value)) == f"a is {told}"
    assert f"<th>Range</th><td>{sheet}</td>" in data_sheets(board, "x")


@pytest.mark.requirement("J2A-TRANS-025")
@pytest.mark.parametrize("name", ["class", "class_", "_x", "n_x"])
def test_a_name_is_in_range_or_refused_whatever_python_calls_it(name):
    """The names of Python went past the range."""
    board = parse_descriptors("enum e u8 (a=0, class=5, _x=6)\n\nactuator a 1 1 e\n range 0, 5\n")
    codec = SampleCodec(board["a"], PythonTypes())
    if name.startswith("class"):
        assert codec.pack_set([name], 0, 0)[-1] == 5
    else:
        with pytest.raises(WrongArgument, match="a is 0 to 5, not 6"):
            codec.pack_set([name], 0, 0)


@pytest.mark.parametrize(
    ("kind", "value", "raw"),
    [
        ("i64\n scale 1", 2**53 + 1, 2**53 + 1),
        ("i64\n scale -1", 2**63, -(2**63)),
        ("u64\n scale 1", 2**64 - 1, 2**64 - 1),
        ("i64\n offset 5", 2**60 + 6, 2**60 + 1),
        ("i64 ms\n scale 0.001", 9_000_000_000_001, 9_000_000_000_001_000),
        ("i64\n scale 3\n offset -0.5", 2**62 + 1, 1537228672809129302),
        ("i64\n scale 0.1", 400_000_000_000_007, 4_000_000_000_000_070),
        ("i16\n scale 0.1", 0.35, 3),
        ("i16\n scale 0.4", 1, 2),
    ],
)
def test_all_digits_of_an_integer_reach_the_board(kind, value, raw):
    """An f64 between them lost those beyond 53 bits, or made the largest integers too large."""
    numpy = pytest.importorskip("numpy")
    codec = SampleCodec(parse_descriptors(f"\nactuator a 1 1 {kind}\n")["a"], PythonTypes())
    is_signed = kind.startswith("i")
    assert int.from_bytes(codec.pack_set([value], 0, 0)[9:], "little", signed=is_signed) == raw
    if isinstance(value, int):
        assert codec.raw_of(numpy.array([value])[0]) == raw
    assert all(isinstance(codec.raw_of(one), int) for one in (5, 5.0, Fraction(1, 3)))


@pytest.mark.parametrize("kind", ["f32", "f64"])
@pytest.mark.parametrize("scale", ["0.1", "0.7", "1e-4", "0.18", "-0.3"])
def test_the_limits_that_are_told_and_read_can_be_set(kind, scale):
    """A division of floats made a bit more of them, which is out of range."""
    for limit in (*range(1, 40), 1000, 12345):
        text = f"\nactuator a 1 1 {kind}\n scale {scale}\n offset 0.2\n range -{limit}, {limit}\n"
        board = parse_descriptors(text)
        codec = SampleCodec(board["a"], PythonTypes())
        for raw in (-limit, limit):
            told = in_unit(float(raw), kind, float(scale), 0.2)
            for value in (told, codec.physical(float(raw))):
                assert codec.pack_set([value], 0, 0)[9:] == codec.pack_raw(raw)


def test_a_zero_keeps_its_sign_and_the_smallest_number_its_value():
    codec = SampleCodec(parse_descriptors("\nactuator a 1 1 f64\n scale 2\n")["a"], PythonTypes())
    assert math.copysign(1, codec.raw_of(-0.0)) == -1
    assert (codec.raw_of(1e-323), codec.raw_of(1.7e308), codec.raw_of(5)) == (5e-324, 8.5e307, 2.5)


@pytest.mark.parametrize("value", [10**400, -(10**400), math.inf, -math.inf, math.nan])
@pytest.mark.parametrize(
    "kind", ["u8\n scale 2", "i64\n offset 1", "f32\n scale 2", "f64\n scale 2"]
)
def test_what_is_no_finite_number_is_refused_in_words(kind, value):
    codec = SampleCodec(parse_descriptors(f"\nactuator a 1 1 {kind}\n")["a"], PythonTypes())
    with pytest.raises(WrongArgument, match="a takes a number, not "):
        codec.raw_of(value)


@pytest.mark.parametrize("kind", ["u8\n scale 2", "f32", "f64", "i16"])
def test_no_number_is_too_strange_to_be_told_the_range(kind):
    numpy = pytest.importorskip("numpy")
    codec = SampleCodec(
        parse_descriptors(f"\nactuator a 1 1 {kind}\n range 0, 9\n")["a"], PythonTypes()
    )
    for raw in (10**400, numpy.array([1.0, 2.0])):
        with pytest.raises(WrongArgument):
            codec.pack_set([raw], 0, 0, is_raw=True)


def test_a_data_sheet_has_all_digits_of_resolution_and_accuracy():
    board = parse_descriptors("\nsensor a 1 1 i16 V\n scale -0.00012207031\n accuracy 0.1234567\n")
    sheet = data_sheets(board, "x")
    assert "<th>Resolution</th><td>0.00012207031 V</td>" in sheet
    assert "<th>Accuracy</th><td>± 0.1234567 V</td>" in sheet
