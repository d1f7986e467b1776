"""The samples of one link: from SIFs to the sensors that they are of.

What flows in: SIFs, in the thread or task of the SIF handlers, and what the device tells about its
transducers. What flows out: samples, to those who registered for them, and the newest of each.
Rules: a SIF is taken apart once, before any handler of samples sees it; one that is not what the
descriptor says is an error of the device and gives no value (J2A-TRANS-023). While it is doubted
what the device has, no SIF is a sample (J2A-TRANS-027).
"""

from collections.abc import Callable, Iterable
from operator import le
from typing import Any

from j2a.errors import ProtocolError
from j2a.events import Sample, Sif
from j2a.protocol.device_info import DeviceInfo
from j2a.types.coding import PayloadMismatchError
from j2a.types.samples import SampleCodec
from j2a.types.transducers import Descriptors, Transducer

__all__ = ["BadPayload", "SampleSource", "WantedSamples"]

_LOST_MODULO = 0x10000


class BadPayload(ProtocolError):  # noqa: N818 - named as those of j2a.errors
    """A SIF is not what the device says of it."""


class _State:
    """What is remembered of one transducer until the device restarts."""

    def __init__(self, transducer: Transducer, codec: SampleCodec) -> None:
        self.transducer = transducer
        self.codec = codec
        self.latest: Sample | None = None
        self.count = 0
        self.lost: int | None = None
        self.times_us: dict[int, int] = {}

    def goes_back(self, channels: Iterable[int], times: tuple[int, ...]) -> bool:
        """Note the times of channels, 0 for none; return whether one is before that of its last."""
        is_sorted = not self.transducer.queue or all(map(le, times, times[1:]))
        if is_sorted and min(times) >= max(self.times_us.values(), default=1):
            # As nearly always; there is no loop over values.
            self.times_us.update(zip(channels, times, strict=True))
            return False
        is_back = False
        for channel, time_us in zip(channels, times, strict=True):
            if time_us:
                is_back |= time_us < self.times_us.get(channel, 0)
                self.times_us[channel] = time_us
        return is_back


class SampleSource:
    """The transducers of one link.

    Args:
        url: of the board.
        device: what the device told about itself.
        now: the time of the link, in seconds.
        is_doubted: what the device has may be wrong, because it has or may have restarted.
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
        is_doubted: Callable[[], bool],
        host_us: Callable[[int], int | None] = lambda _time_us: None,
    ) -> None:
        self.current: Sample | None = None
        self.board = url
        self._device = device
        self._now = now
        self._is_doubted = is_doubted
        self._host_us = host_us
        self._learnt: Descriptors | None = None
        self._by_name: dict[str, _State] = {}
        self._by_id: dict[int, _State] = {}

    def _load(self) -> None:
        descriptors = self._device.descriptors
        if descriptors is self._learnt:
            return
        self._learnt = descriptors
        found = descriptors.transducers if descriptors is not None else ()
        states = [_State(one, SampleCodec(one, self._device.types)) for one in found]
        for state in states:
            # Where the device was reset in between, its times go back.
            before = self._by_name.get(state.transducer.name)
            if before is not None:
                state.times_us, state.count = before.times_us, before.count
        self._by_name = {one.transducer.name: one for one in states}
        self._by_id = {one.transducer.id: one for one in states if one.transducer.is_sensor}

    def names(self) -> list[str]:
        """Return the names of the transducers, as the device lists them."""
        self._load()
        return list(self._by_name)

    def codec(self, name: str) -> SampleCodec | None:
        """Return what takes the payloads of a transducer apart, None without one of that name."""
        self._load()
        state = self._by_name.get(name)
        return None if state is None else state.codec

    def latest(self, name: str) -> Sample | None:
        """Return the newest sample of a sensor."""
        self._load()
        state = self._by_name.get(name)
        return None if state is None else state.latest

    def take(self, sif: Sif) -> None:
        """Take a SIF apart, if it is a sample; the first of all handlers.

        Raises:
            ProtocolError: the payload is not what the descriptor says.
        """
        self.current = None
        if self._device.descriptors is None or self._is_doubted():
            return
        self._load()
        state = self._by_id.get(sif.opcode)
        if state is None:
            return
        try:
            self.current = state.latest = self._sample(state, sif)
        except PayloadMismatchError as error:
            raise BadPayload(f"a sample of {state.transducer.name}: {error}") from None

    def _sample(self, state: _State, sif: Sif) -> Sample:
        lost = 0
        channels: Iterable[int]
        if state.transducer.queue:
            count, readings, channels, times = state.codec.times_queued(sif.payload)
            if state.lost is not None:
                lost = (count - state.lost) % _LOST_MODULO
            state.lost = count
        else:
            readings, times = state.codec.times(sif.payload)
            channels = range(len(times))
        is_reset = state.goes_back(channels, times)
        newest_us = max(times)
        sequence = state.count
        state.count += 1
        return Sample(
            self.board,
            state.transducer.name,
            sequence,
            readings,
            self._now(),
            state.transducer.unit,
            lost,
            sif.missed,
            is_reset,
            sif.payload,
            self._host_us(newest_us) if newest_us else None,
        )


class WantedSamples:
    """The samples of one sensor, or of all without a name, for a handler or a stream."""

    def __init__(self, source: SampleSource, name: str | None = None) -> None:
        self._source = source
        self._name = name

    def __contains__(self, opcode: object) -> bool:
        current = self._source.current
        return current is not None and self._name in (None, current.name)

    def decode(self, sif: Sif) -> Any:
        """Return the sample that the SIF is."""
        return self._source.current
