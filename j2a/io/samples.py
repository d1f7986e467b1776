"""The samples of one link: from SIFs to the sensors that they are of.

What flows in: SIFs, in the thread or task of the SIF handlers, and what the device tells about its
transducers. What flows out: samples, to those who registered for them, and the newest of each.
Rules: a SIF is taken apart once, before any handler of samples sees it; one that is not what the
descriptor says is an error of the device and gives no value (J2A-TRANS-023). A SIF is read by the
descriptors of the time when it came, or not at all: a restart may be known while those of before
still wait (J2A-TRANS-027). Handlers and users call from several threads.
"""

import threading
from collections.abc import Callable, Sequence
from itertools import count
from operator import le
from typing import Any

from j2a.errors import ProtocolError
from j2a.events import Sample, Sif, quick_maker
from j2a.protocol.device_info import DeviceInfo
from j2a.protocol.session import restarts_of
from j2a.types.coding import PayloadMismatchError
from j2a.types.model import Structure
from j2a.types.samples import SampleCodec
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["BadPayload", "SampleSource", "WantedSamples"]

_LOST_MODULO = 0x10000
_new_sample = quick_maker(Sample)


class BadPayload(ProtocolError):  # noqa: N818 - named as those of j2a.errors
    """A SIF is not what the device says of it."""


class _State:
    """What is remembered of one transducer until its descriptor is learnt anew."""

    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        self.transducer = transducer
        self.codec = codec
        self.restarts = 0  # that the device had told of when the first SIF came
        is_structure = isinstance(transducer.type.element, Structure)
        self.field_units = tuple(transducer.units.items()) if is_structure else ()
        self.latest: Sample | None = None
        self.count = count()
        self.lost: int | None = None
        self.last_us = 0
        self.has_queue = transducer.queue > 0
        self._times_us: dict[int, int] = {}  # by channel
        self._latest_us = 1  # of these, and of the sample before, where it has all channels
        self._before: tuple[int, ...] = ()

    def losses(self, told: int, times: tuple[int, ...]) -> int:
        """Return how many values were lost since the SIF before (J2A-TRANS-026).

        Args:
            told: so many the device has lost, modulo 65536.
            times: of the values in the SIF, 0 for none.
        """
        before, self.lost = self.lost, told
        last_us, first_us = self.last_us, next(filter(None, times), 0)
        self.last_us = next(filter(None, reversed(times)), last_us)
        if before is None:
            return 0
        if told < before and 0 < first_us < last_us:
            return told  # the device was reset in between, and counts anew
        return (told - before) % _LOST_MODULO

    def go_on(self, before: "_State") -> None:
        """Count and compare times as one that knew the same transducer did.

        What was lost before a boot SIF is not known behind it (J2A-TRANS-026).
        """
        self.count = before.count
        if before.restarts == self.restarts:
            self.lost, self.last_us = before.lost, before.last_us
        before._note()
        self._times_us, self._latest_us = before._times_us, before._latest_us

    def goes_back(self, times: tuple[int, ...], channels: bytes | None = None) -> bool:
        """Note the times of channels, 0 for none; return whether one is before that of its last.

        Args:
            times: of readings.
            channels: of the same readings; None for all in order.
        """
        if min(times) >= self._latest_us and (channels is None or all(map(le, times, times[1:]))):
            # As nearly always; there is no loop over values.
            self._latest_us = max(times)
            if channels is None:
                self._before = times
            else:
                self._times_us.update(zip(channels, times, strict=True))
            return False
        self._note()
        is_back = False
        if channels is None:
            channels = bytes(range(len(times)))
        for channel, time_us in zip(channels, times, strict=True):
            if time_us:
                is_back |= time_us < self._times_us.get(channel, 0)
                self._times_us[channel] = time_us
        self._latest_us = max(self._times_us.values(), default=1)
        return is_back

    def _note(self) -> None:
        self._times_us.update(enumerate(self._before))
        self._before = ()


class _Known:
    """What follows from the descriptors of a device."""

    def __init__(self, descriptors: Descriptors | None, states: Sequence[_State]) -> None:
        self.descriptors = descriptors
        self.by_name = {one.transducer.name: one for one in states}
        self.by_id = {one.transducer.id: one for one in states if one.transducer.is_sensor}

    def begin(self, before: "_Known", restarts: int) -> None:
        """Go on behind the last SIF that was read by the descriptors of before.

        Args:
            before: these.
            restarts: that the device has told of before the SIF that is read next.
        """
        for name, state in self.by_name.items():
            state.restarts = restarts
            if (one := before.by_name.get(name)) is not None:
                # Where the device was reset in between, its times go back.
                state.go_on(one)


class SampleSource:
    """The transducers of one link.

    Args:
        url: of the board.
        device: what the device told about itself.
        now: the time of the link, in seconds.
        epoch: of the SIFs that are samples of the descriptors, -1 while those are being learnt.
        host_us: the time of this computer at one of the device, None where it is not known.

    Attributes:
        board: what samples name as their board.
        current: the sample that is being delivered, None where the SIF is none.
    """

    def __init__(
        self,
        url: str,
        device: DeviceInfo,
        now: Callable[[], float],
        epoch: Callable[[], int],
        host_us: Callable[[int], int | None] = lambda _time_us: None,
    ) -> None:
        self.current: Sample | None = None
        self.board = url
        self._device = device
        self._now = now
        self._epoch = epoch
        self._host_us = host_us
        self._lock = threading.Lock()
        self._known = _Known(None, ())
        self._before: dict[str, _State] = {}  # while nothing is known, that of before
        self._newest = -1, self._known  # by which a SIF was read, and of which epoch it was

    def _load(self) -> "_Known":
        """Return what is known by the descriptors of now."""
        known = self._known
        if known.descriptors is self._device.descriptors:
            return known
        with self._lock:
            known, descriptors = self._known, self._device.descriptors
            if known.descriptors is descriptors:
                return known
            found = descriptors.transducers if descriptors is not None else ()
            states = [_State(one, SampleCodec(one, self._device.types)) for one in found]
            self._known = _Known(descriptors, states)
            if descriptors is not None:
                self._before = self._known.by_name
            return self._known

    @property
    def is_known(self) -> bool:
        """The device has said what it has, since its last restart as far as that is known."""
        return self._device.asked_for_transducers

    def names(self) -> list[str]:
        """Return the names of the transducers, as the device lists them."""
        return list(self._load().by_name)

    def codec(self, name: str) -> SampleCodec | None:
        """Return what takes the payloads of a transducer apart, None without one of that name."""
        state = self._load().by_name.get(name)
        return None if state is None else state.codec

    def codec_of_reply(self, name: str) -> SampleCodec | None:
        """Return the same for a reply: while all is learnt anew, that by which it was asked for."""
        known = self._load()
        states = self._before if known.descriptors is None else known.by_name
        return states[name].codec if name in states else None

    def latest(self, name: str) -> Sample | None:
        """Return the newest sample of a sensor."""
        state = self._load().by_name.get(name)
        return None if state is None else state.latest

    def take(self, sif: Sif) -> None:
        """Take a SIF apart, if it is a sample; the first of all handlers.

        Raises:
            ProtocolError: the payload is not what the descriptor says.
        """
        self.current = None
        epoch = self._epoch()
        known = self._load()
        if known.descriptors is not None and epoch == sif.epoch == self._epoch():
            if known is not self._newest[1]:
                # Not before: SIFs of the time before may have waited until now.
                known.begin(self._newest[1], restarts_of(epoch))
            self._newest = epoch, known
        elif self._newest[0] != sif.epoch:
            return
        # Else it came before a restart, after which all has been learnt anew already, perhaps also
        # the clock, by which its times mean nothing (J2A-CLOCK-026).
        has_clock = epoch < 0 or restarts_of(epoch) == restarts_of(sif.epoch)
        state = self._newest[1].by_id.get(sif.opcode)
        if state is None:
            return
        try:
            self.current = state.latest = self._sample(state, sif, has_clock)
        except PayloadMismatchError as error:
            raise BadPayload(f"a sample of {state.transducer.name}: {error}") from None

    def _sample(self, state: _State, sif: Sif, has_clock: bool) -> Sample:
        lost, channels = 0, None
        if state.has_queue:
            told, readings, channels, times = state.codec.times_queued(sif.payload)
            lost = state.losses(told, times)
        else:
            readings, times = state.codec.times(sif.payload)
        is_reset = state.goes_back(times, channels)
        newest_us = max(times)
        return _new_sample(
            self.board,
            state.transducer.name,
            next(state.count),
            readings,
            self._now(),
            state.transducer.unit,
            lost,
            sif.missed,
            is_reset,
            sif.payload,
            self._host_us(newest_us) if newest_us and has_clock else None,
            state.field_units,
            sif.gone,
        )


class WantedSamples:
    """The samples of one sensor, or of all without a name, for a handler or a stream."""

    def __init__(self, source: SampleSource, name: str | None = None) -> None:
        self._source = source
        self._name = name

    def __str__(self) -> str:
        return "all samples" if self._name is None else f"samples of {self._name}"

    def __contains__(self, opcode: object) -> bool:
        current = self._source.current
        return current is not None and self._name in (None, current.name)

    def decode(self, sif: Sif) -> Any:
        """Return the sample that the SIF is."""
        return self._source.current
