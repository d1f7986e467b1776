"""Actuators: SET, and what a watchdog does (J2A-TRANS)."""

import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

from j2a_spec import constants as c
from j2a_spec import transducers as oracle
from j2a_transports import TransportError

from j2a_conformance._judge import Judged, fail

from ._board import (
    DUE_US,
    LATER_US,
    LOOK_S,
    SLACK_US,
    US,
    Board,
    TransducerCase,
    around_range,
    check_time,
    far_us,
    fit,
    numbers,
    room,
    safe,
    settable,
    slots,
    spread,
    unsafe,
    wrong_sets,
)

_CHANNELS: Final = 16  # of which each range is set
_LONG_MS: Final = 60_000  # a watchdog that does not expire


@contextmanager
def watchdog_kept(board: Board, one: oracle.Transducer) -> Iterator[None]:
    """Write WATCHDOG of an actuator as it was in the end, whatever fails before."""
    before = board.read(one, c.TRANSD_WATCHDOG)
    try:
        yield
    finally:
        with suppress(Judged, TransportError):
            board.write(one, c.TRANSD_WATCHDOG, before)


class Set(TransducerCase):
    """Sets channels of actuators at once and at times ahead."""

    ID = "transducers.set"
    EXPECTATION = "The channels have the values, from the time on; others stay as they were."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-015", "J2A-TRANS-016")

    def _judge(self, board: Board) -> None:
        for one in board.actuators():
            guarded = board.has(one, c.TRANSD_WATCHDOG)
            before = board.read(one, c.TRANSD_WATCHDOG) if guarded else b""
            if guarded:
                board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            self._at_once(board, one)
            self._ahead(board, one)
            for channel in spread(one):
                self._replaced(board, one, channel)
                self._far(board, one, channel)
            if fit(board, one) > 1:
                self._replaced_together(board, one)
            if guarded:
                board.write(one, c.TRANSD_WATCHDOG, before)

    @staticmethod
    def _counts(most: int, at_us: int | None) -> list[int]:
        """Return how many channels to set together: each number once where they are not many."""
        every = range(1, most + 1) if at_us == 0 and most <= _CHANNELS else ()
        return sorted({*every, 1, (most + 1) // 2, most} if at_us == 0 else {1, most})

    def _at_once(self, board: Board, one: oracle.Transducer) -> None:
        most = room(board, one)
        now = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        for at_us in (0, 1, None):
            for first in range(one.channels):
                for count in self._counts(min(most, one.channels - first), at_us):
                    values = [settable(board, one) for _ in range(count)]
                    begin_us = board.time_us()
                    at = US.pack(begin_us if at_us is None else at_us)
                    board.write(one, c.TRANSD_SET, bytes((first,)) + at + b"".join(values))
                    end_us = board.time_us()
                    found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                    for channel in range(one.channels):
                        if not first <= channel < first + count:
                            if found[channel] != now[channel]:
                                fail(f"channel {channel} of {one.name} has changed")
                            continue
                        if found[channel][1] != values[channel - first]:
                            fail(
                                f"channel {channel} of {one.name} is {found[channel][1].hex()}, it "
                                f"was set to {values[channel - first].hex()}"
                            )
                        check_time(one, found[channel][0], begin_us, end_us)
                    now = found
        ends = [board.packed(one, number) for number in numbers(board, one) or ()]
        for number, value in enumerate((*ends, *around_range(board, one, is_within=True))):
            channel = number % one.channels
            board.write(one, c.TRANSD_SET, bytes((channel,)) + bytes(8) + value)
            raw = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel][1]
            if raw != value:
                fail(f"channel {channel} of {one.name} is {raw.hex()}, not {value.hex()}")

    def _ahead(self, board: Board, one: oracle.Transducer) -> None:
        for channel in spread(one):
            before = board.read(one, c.TRANSD_SAMPLE)
            value = settable(board, one)
            due_us = board.time_us() + DUE_US
            board.write(one, c.TRANSD_SET, bytes((channel,)) + US.pack(due_us) + value)
            # What is refused replaces nothing (J2A-TRANS-008).
            wrong = [bad for bad in wrong_sets(board, one) if bad[0] == channel]
            board.exchange(bytes((one.id, c.TRANSD_SET, channel)) + bytes(8), c.TRANSD_BAD_LENGTH)
            for refused in (*wrong[:1], *wrong[-1:]):
                board.exchange(bytes((one.id, c.TRANSD_SET)) + refused, c.TRANSD_BAD_VALUE)
            for item in (c.TRANSD_WATCHDOG, c.TRANSD_TOPIC):
                if board.has(one, item):
                    board.exchange(bytes((one.id, item)) + bytes(33), c.TRANSD_BAD_LENGTH)
            board.exchange(bytes((one.id, c.TRANSD_SET)), c.TRANSD_NO_ITEM)
            board.rewrite(one)  # nor does what other items are
            for limit_ms in (_LONG_MS, 0) if board.has(one, c.TRANSD_WATCHDOG) else ():
                board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            for _ in board.until(due_us):
                board.peer.link.pause(LOOK_S)
                sample = board.read(one, c.TRANSD_SAMPLE)
                if sample == before:
                    continue
                if slots(board, one, sample)[channel][0] < due_us:
                    fail(f"channel {channel} of {one.name} has changed before its time")
                break
            board.wait_until(due_us + LATER_US)
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            time_us, raw = found[channel]
            if raw != value or not due_us <= time_us <= due_us + SLACK_US:
                fail(
                    f"channel {channel} of {one.name} is {raw.hex()} since {time_us} us; it was to "
                    f"be {value.hex()} from {due_us} us on",
                    suspect=raw != value or time_us > due_us,  # late, as one that stalls is
                )
            others = slots(board, one, before)
            for other in range(one.channels):
                if other != channel and found[other] != others[other]:
                    fail(f"channel {other} of {one.name} has changed")

    def _replaced(self, board: Board, one: oracle.Transducer, channel: int) -> None:
        """Set a channel for a time, and then anew before that."""
        for second_us in (0, DUE_US // 2, 2 * DUE_US):
            first, second = settable(board, one), settable(board, one)
            begin_us = board.time_us()
            due_us = begin_us + DUE_US
            later_us = begin_us + second_us if second_us else 0
            board.write(one, c.TRANSD_SET, bytes((channel,)) + US.pack(due_us) + first)
            board.write(one, c.TRANSD_SET, bytes((channel,)) + US.pack(later_us) + second)
            is_in_time = board.time_us() < due_us
            board.wait_until(max(due_us, later_us) + LATER_US)
            time_us, raw = slots(board, one, board.read(one, c.TRANSD_SAMPLE))[channel]
            if raw != second or not max(later_us, begin_us) <= time_us:
                text = f"{one.name} is {raw.hex()} since {time_us} us, not {second.hex()}"
                fail(text, suspect=raw != second)
            if second_us < DUE_US and time_us >= due_us and is_in_time:
                text = f"{one.name} was set at {due_us} us, though a later SET had replaced that"
                fail(text, suspect=True)  # a device that stalls is late, too

    @staticmethod
    def _far(board: Board, one: oracle.Transducer, channel: int) -> None:
        """Set a channel for times that are years ahead, each in place of one that is near."""
        before = board.read(one, c.TRANSD_SAMPLE)
        now_us = board.time_us()
        due_us = now_us + DUE_US
        for at_far_us in far_us(now_us):
            for at_us in (due_us, at_far_us):
                value = settable(board, one)
                board.write(one, c.TRANSD_SET, bytes((channel,)) + US.pack(at_us) + value)
        is_in_time = board.time_us() < due_us
        board.wait_until(due_us + LATER_US)
        if is_in_time and board.read(one, c.TRANSD_SAMPLE) != before:
            fail(f"{one.name} was set, for a time that is far ahead or one that was replaced")
        # So that nothing waits.
        board.write(one, c.TRANSD_SET, bytes((channel,)) + bytes(8) + settable(board, one))

    @staticmethod
    def _replaced_together(board: Board, one: oracle.Transducer) -> None:
        """Set all channels that fit for a time, and then some of them anew: at once, for a time
        before that, and for one behind it.
        """
        most = fit(board, one)
        parts = {(0, 1), (0, most), (most - 1, 1), (most // 2, most - most // 2), (0, most - 1)}
        for first, count in sorted(part for part in parts if part[1]):
            for second_us in (0, DUE_US // 2, 2 * DUE_US):
                Set._some(board, one, first, count, second_us)

    @staticmethod
    def _some(board: Board, one: oracle.Transducer, first: int, count: int, second_us: int) -> None:
        most = fit(board, one)
        values, others = ([settable(board, one) for _ in range(most)] for _ in range(2))
        begin_us = board.time_us()
        due_us = begin_us + DUE_US
        anew_us = begin_us + second_us if second_us else 0
        board.write(one, c.TRANSD_SET, b"\0" + US.pack(due_us) + b"".join(values))
        some = b"".join(others[first : first + count])
        board.write(one, c.TRANSD_SET, bytes((first,)) + US.pack(anew_us) + some)
        is_in_time = board.time_us() < due_us
        board.wait_until(max(due_us, anew_us) + LATER_US)
        found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        for channel in range(most):
            is_anew = first <= channel < first + count
            time_us, raw = found[channel]
            if raw != (others if is_anew else values)[channel]:
                text = f"channel {channel} of {one.name} is {raw.hex()}; {count} channels from "
                fail(f"{text}{first} on were set anew for {anew_us} us", suspect=True)
            if is_in_time and time_us < (max(anew_us, begin_us) if is_anew else due_us):
                fail(f"channel {channel} of {one.name} was set at {time_us} us, too early")
            # Those that are set before the others, whichever these are, are not set with them.
            is_first = is_anew == (anew_us < due_us)
            if is_in_time and is_first and time_us >= max(due_us, anew_us):
                text = f"channel {channel} of {one.name} was set at {time_us} us, as others"
                fail(text, suspect=True)


class Watchdog(TransducerCase):
    """Is silent for shorter and longer than the watchdog of an actuator, and for longer again; lets
    watchdogs of 1 ms to more than a second expire, and those of all actuators together.
    """

    ID = "transducers.watchdog"
    EXPECTATION = "Behind a longer silence each channel is safe, once, and what waited is dropped."
    REQUIREMENTS = ("J2A-TRANS-017",)
    LIMIT_MS: Final = 150
    _EXPIRE_MS: Final = (1, 20, 50, 256)
    _LONGEST_MS: Final = 1100  # of one actuator
    _LATE_MS: Final = 40
    _MOMENT_MS: Final = 15

    def _judge(self, board: Board) -> None:
        guarded = board.actuators("watchdog")
        with ExitStack() as stack:
            for one in guarded:
                stack.enter_context(watchdog_kept(board, one))
            if guarded:
                board.peer.attempts(lambda: self._together(board, guarded))
        for one in guarded:
            with watchdog_kept(board, one):
                board.peer.attempts(lambda one=one: self._actuator(board, one))  # type: ignore[misc]

    def _together(self, board: Board, guarded: list[oracle.Transducer]) -> None:
        """Have the watchdogs of all actuators expire twice, with a single request in between."""
        for one in guarded:
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        for times in (1, 2, 4):  # as in `_each_silence`
            self._silence(board, times * self.LIMIT_MS * 2)
            begin_us = board.time_us()
            self._silence(board, times * self.LIMIT_MS * 2)
            samples = [slots(board, one, board.read(one, c.TRANSD_SAMPLE)) for one in guarded]
            if board.time_us() >= begin_us + self.LIMIT_MS * 1600:
                break
        for one, sample in zip(guarded, samples, strict=True):
            for channel, (time_us, raw) in enumerate(sample):
                if raw != safe(board, one) or time_us < begin_us:
                    what = f"channel {channel} of {one.name} was not made safe in a second silence"
                    fail(f"{what}, but is {raw.hex()} since {time_us} us", suspect=True)

    def _actuator(self, board: Board, one: oracle.Transducer) -> None:
        safe_value, value = safe(board, one), unsafe(board, one)
        if value == safe_value:  # it has one value only
            return
        count = fit(board, one)
        self._long(board, one, value)
        self._each_silence(board, one, value)
        is_first = one == board.actuators("watchdog")[0]
        for limit_ms in (*self._EXPIRE_MS, *[self._LONGEST_MS] * is_first):
            self._expire(board, one, value, limit_ms)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        board.write(one, c.TRANSD_SET, bytes(9) + value * count)
        board.write(one, c.TRANSD_WATCHDOG, bytes(2))
        self._silence(board, self.LIMIT_MS * 2)  # 0 is never
        self._same(board, one, board.read(one, c.TRANSD_SAMPLE), value, count)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        for _ in range(5):
            self._silence(board, self.LIMIT_MS * 0.4)
            sample = board.read(one, c.TRANSD_SAMPLE)
        if slots(board, one, sample)[0][1] != value:
            fail(f"{one.name} was made safe within the time of its watchdog", suspect=True)
        due_us = board.time_us() + self.LIMIT_MS * 4000
        board.write(one, c.TRANSD_SET, b"\0" + US.pack(due_us) + value * count)
        board.rewrite(one)
        begin_us = board.time_us()
        self._silence(board, self.LIMIT_MS * 2.6)
        found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
        end_us = board.time_us()
        for channel, (time_us, raw) in enumerate(found):
            if raw != safe_value:
                text = f"channel {channel} of {one.name} is {raw.hex()} after the silence, not safe"
                fail(text, suspect=True)
            if not begin_us + self.LIMIT_MS * 900 <= time_us <= end_us:
                fail(f"{one.name} was made safe at {time_us} us, the silence began at {begin_us}")
            if time_us > begin_us + self.LIMIT_MS * 1600:
                fail(f"{one.name} was made safe at {time_us} us, or again then", suspect=True)
        for _ in board.until(due_us + LATER_US):
            self._silence(board, self.LIMIT_MS * 0.2)
        if slots(board, one, board.read(one, c.TRANSD_SAMPLE)) != found:
            fail(f"{one.name} has changed after it was made safe", suspect=True)

    def _expire(self, board: Board, one: oracle.Transducer, value: bytes, limit_ms: int) -> None:
        """Be silent for a little longer than the watchdog; SAMPLE tells when it has expired.

        The silence is that behind TIME: a short one may have been over before, and all is set to
        safe once more then.
        """
        safe_value = safe(board, one)
        for times in (1, 2, 4):  # the clock of an emulator on a busy machine is slower than ours
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            begin_us = board.time_us()
            board.write(one, c.TRANSD_SET, bytes((one.channels - 1,)) + bytes(8) + value)
            silent_us = board.time_us()
            self._silence(board, times * (limit_ms + self._LATE_MS + 10))
            found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
            board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            if all(raw == safe_value and time_us >= begin_us for time_us, raw in found):
                break
        for channel, (time_us, raw) in enumerate(found):
            what = f"channel {channel} of {one.name}, with a watchdog of {limit_ms} ms,"
            if raw != safe_value or time_us < begin_us:
                text = f"is {raw.hex()} since {time_us} us, after a silence from {silent_us} us on"
                fail(f"{what} {text}", suspect=True)
            if time_us < begin_us + limit_ms * 900 - 1000:
                fail(f"{what} was made safe at {time_us} us, and set after {begin_us} us")
            if time_us > silent_us + (limit_ms + self._LATE_MS) * 1000:
                text = f"was made safe at {time_us} us, silent since {silent_us} us"
                fail(f"{what} {text}", suspect=True)

    def _each_silence(self, board: Board, one: oracle.Transducer, value: bytes) -> None:
        """Set the last channel only, and be silent; all must be safe, also if none was ever set.

        The same again, without a write of WATCHDOG in between, and once more without SET, too.
        """
        safe_value = safe(board, one)
        board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", self.LIMIT_MS))
        for which in ("first", "second", "third"):
            for times in (1, 2, 4):  # as in `_expire`, but by the clock of the device
                if which != "third":
                    board.write(one, c.TRANSD_SET, bytes((one.channels - 1,)) + bytes(8) + value)
                begin_us = board.time_us()
                self._silence(board, times * self.LIMIT_MS * 2)
                found = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                if board.time_us() >= begin_us + self.LIMIT_MS * 1600:
                    break
            for channel, (time_us, raw) in enumerate(found):
                if raw != safe_value or time_us < begin_us:
                    what = f"channel {channel} of {one.name} was not made safe, but {raw.hex()}"
                    fail(f"{what}, in the {which} silence", suspect=True)

    def _long(self, board: Board, one: oracle.Transducer, value: bytes) -> None:
        """Be silent for far less than long watchdogs, whose limits do not fit into fewer bits; for
        a moment where it is their microseconds that do not, and next to nothing would be left.
        """
        for limit_ms in (256, 0x1010, 32767, 32768, 40000, 65535):
            board.write(one, c.TRANSD_WATCHDOG, bytes(2))
            board.write(one, c.TRANSD_SET, bytes(9) + value)
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            for _ in range(2):
                self._silence(board, self.LIMIT_MS * 0.8)
                if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[0][1] != value:
                    text = f"{one.name} was made safe after less than its watchdog of {limit_ms} ms"
                    fail(text, suspect=True)
                board.write(one, c.TRANSD_SET, bytes(9) + value)
        for bits in range(18, 26):
            limit_ms = (1 << bits) // 1000 + 1
            board.write(one, c.TRANSD_WATCHDOG, struct.pack("<H", limit_ms))
            self._silence(board, self._MOMENT_MS)
            if slots(board, one, board.read(one, c.TRANSD_SAMPLE))[0][1] != value:
                text = f"{one.name} was made safe after a moment, its watchdog is of {limit_ms} ms"
                fail(text, suspect=True)
        board.write(one, c.TRANSD_WATCHDOG, bytes(2))

    @staticmethod
    def _silence(board: Board, time_ms: float) -> None:
        board.peer.silence(time_ms / 1e3, "while nothing was asked")

    @staticmethod
    def _same(
        board: Board, one: oracle.Transducer, sample: bytes, value: bytes, count: int
    ) -> None:
        for time_us, raw in slots(board, one, sample)[:count]:
            if raw != value or not time_us:
                fail(f"{one.name} is {raw.hex()}, though its watchdog is off")
