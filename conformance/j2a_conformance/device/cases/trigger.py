"""TRIGGER: a sample at a time that the host says (J2A-TRANS)."""

from itertools import permutations

from j2a_spec import constants as c
from j2a_spec import transducers as oracle

from j2a_conformance._judge import fail

from ._board import (
    DUE_US,
    LATER_US,
    LOOK_S,
    SLACK_US,
    US,
    Board,
    TransducerCase,
    far_us,
    measured,
    slots,
)


class Trigger(TransducerCase):
    """Triggers sensors at once, at a time ahead, and anew before that, and several at one time;
    reads and writes other items meanwhile, and triggers sensors that are disabled, and those
    whose sample waits for the end of PERIOD.
    """

    ID = "transducers.trigger"
    EXPECTATION = "One sample each, not measured before its time; the later request replaces one."
    REQUIREMENTS = ("J2A-TRANS-008", "J2A-TRANS-009", "J2A-TRANS-018")

    def _judge(self, board: Board) -> None:
        for one in board.sensors("trigger"):
            with board.tuned(one):
                for at_us in (0, 1):
                    begin_us, since = board.time_us(), board.seen
                    board.write(one, c.TRANSD_TRIGGER, US.pack(at_us))
                    self._measured(board, one, since, begin_us)
                for later_us in (None, DUE_US // 2, 2 * DUE_US, 0, -1):
                    self._replaced(board, one, later_us)
                if "queue" not in one.attributes:
                    self._unsent(board, one, c.TRANSD_ENABLED, b"\0")
                    self._unsent(board, one, c.TRANSD_PERIOD, b"\xff" * 4)
        for pair in permutations(board.sensors("trigger"), 2):
            with board.tuned(pair[0]), board.tuned(pair[1]):
                since, due_us = board.seen, board.time_us() + DUE_US
                for one in pair:
                    board.write(one, c.TRANSD_TRIGGER, US.pack(due_us))
                for one in pair:
                    self._measured(board, one, since, due_us)

    def _replaced(self, board: Board, one: oracle.Transducer, later_us: int | None) -> None:
        """Trigger for times far ahead, for a near one, and unless it is None for another one.

        That is so long after the start; a negative one stands for the time 0.
        """
        since, now_us = board.seen, board.time_us()
        for at_us in far_us(now_us):
            board.write(one, c.TRANSD_TRIGGER, US.pack(at_us))
        board.write(one, c.TRANSD_TRIGGER, US.pack(now_us + DUE_US))
        self._disturb(board, one)
        due_us = now_us + DUE_US
        if later_us is not None:
            at_us = 0 if later_us < 0 else now_us + later_us
            board.write(one, c.TRANSD_TRIGGER, US.pack(at_us))
            due_us = max(at_us, now_us)
        if board.time_us() >= now_us + DUE_US:  # a stall: it was replaced too late
            board.wait_until(max(due_us, now_us + DUE_US) + LATER_US)
            board.peer.settle()  # a device that stalls may measure later still
            return
        since = self._measured(board, one, since, due_us)
        board.wait_until(now_us + DUE_US + LATER_US)
        board.no_sif(one, since, "for a trigger that was replaced")

    @staticmethod
    def _disturb(board: Board, one: oracle.Transducer) -> None:
        """Have requests refused, and read and write other items, none of which is to matter."""
        begin = bytes((one.id, c.TRANSD_TRIGGER))
        for length in (1, 7, 9):
            board.exchange(begin + bytes(length), c.TRANSD_BAD_LENGTH)
        board.exchange(begin, c.TRANSD_NO_ITEM)
        board.write(one, c.TRANSD_ENABLED, b"\0")
        board.write(one, c.TRANSD_ENABLED, b"\1")
        board.rewrite(one)

    @staticmethod
    def _unsent(board: Board, one: oracle.Transducer, item: int, value: bytes) -> None:
        """Trigger a sensor that sends no sample SIFs, because it is disabled or the last one was
        just sent: SAMPLE must show what it measures, also where a sample waits already.
        """
        before = board.read(one, item)
        board.write(one, item, value)
        for later_us in (0, 0, DUE_US):
            due_us = board.time_us() + later_us
            board.write(one, c.TRANSD_TRIGGER, US.pack(due_us))
            for _ in board.until(due_us + SLACK_US):
                board.peer.link.pause(LOOK_S)
                sample = slots(board, one, board.read(one, c.TRANSD_SAMPLE))
                if (time_us := max(time_us for time_us, _ in sample)) >= due_us:
                    break
            else:
                fail(f"{one.name}, which sends nothing, did not measure when it was triggered")
            if time_us > due_us + SLACK_US:
                fail(f"{one.name} has measured at {time_us} us, due was {due_us} us")
        since = board.seen
        board.write(one, item, before)
        if item == c.TRANSD_PERIOD:
            board.sif(one, since)

    @staticmethod
    def _measured(board: Board, one: oracle.Transducer, since: int, due_us: int) -> int:
        """Wait for the sample of a trigger, and for none behind it; return the SIFs until then."""
        board.wait_until(due_us)
        behind = measured(board, one, since, due_us)
        board.no_sif(one, behind, "behind that of the trigger")
        return behind
