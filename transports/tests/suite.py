"""What every transport does, asked of two ends that are joined back to back.

In: a subclass that says how two ends come into being.  Out: the same tests for each transport,
each test once from either end.
Rules: waits are bounded by `PATIENCE_S`, far above what a loaded machine needs; no test judges
speed.
"""

from __future__ import annotations

import random
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, ClassVar, NamedTuple

import pytest
from j2a_transports import LinkClosed, LinkLost, Transport, WriteTimeout

PATIENCE_S = 60.0
# How long a thread gets to reach the call that blocks. Should it come later on a loaded machine,
# the call has to end all the same.
SETTLE_S = 0.03
MEGABYTE = 1 << 20
# Around the packets of USB, of 64 and 512 bytes: where a transfer ends by itself, and where not.
PACKET_SIZES = (63, 64, 65, 128, 512, 513, 1024)


class Ends(NamedTuple):
    """The end under test, the other one, and the other one's name."""

    here: Transport
    there: Transport
    there_is: str


class Background:
    """A function in a thread; `result` hands over what it returned or raised."""

    def __init__(self, function: Callable[[], Any]) -> None:
        self._outcome: list[Any] = []
        self._error: list[BaseException] = []

        def run() -> None:
            try:
                self._outcome.append(function())
            except BaseException as error:
                self._error.append(error)

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def result(self) -> Any:
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive(), "blocked"
        if self._error:
            raise self._error[0]
        return self._outcome[0]


def read_exactly(transport: Transport, count: int) -> bytes:
    """Read until `count` bytes have come, or fail."""
    data = bytearray()
    while len(data) < count:
        chunk = transport.read(PATIENCE_S)
        assert chunk, f"only {len(data)} of {count} bytes came"
        data += chunk
    return bytes(data)


def read_to_end(transport: Transport) -> bytes:
    """Read until the link is lost."""
    data = bytearray()
    with pytest.raises(LinkLost):
        while chunk := transport.read(PATIENCE_S):
            data += chunk
    return bytes(data)


def is_readable(transport: Transport, timeout_s: float) -> bool:
    """Ask the system, as an event loop does."""
    return bool(select.select([transport], [], [], timeout_s)[0])


def fill(transport: Transport) -> None:
    """Write until the write fails."""
    for _ in range(256):
        transport.write(bytes(MEGABYTE))
    pytest.fail("256 MiB were written although nobody reads")


class BackToBack:
    """Subclass as Test...; `connect` yields two joined ends.

    Attributes:
        discards: ends ("near", "far") whose hang-up throws away what the other has not read yet.
        has_exit_code: the end "near" is a program, which may end a moment behind its output.
    """

    has_exit_code: ClassVar[bool] = False
    discards: ClassVar[frozenset[str]] = frozenset()

    def connect(self) -> AbstractContextManager[tuple[Transport, Transport]]:
        raise NotImplementedError

    def hang_up(self, end: str, transport: Transport) -> None:
        """Make the other end lose the link."""
        transport.close()

    @pytest.fixture(params=["near", "far"])
    def ends(self, request: pytest.FixtureRequest) -> Iterator[Ends]:
        with self.connect() as (near, far), near, far:
            yield Ends(near, far, "far") if request.param == "near" else Ends(far, near, "near")

    def test_all_byte_values_arrive_unchanged(self, ends: Ends) -> None:
        data = bytes(range(256)) * 3 + bytes(reversed(range(256)))
        ends.here.write(data)
        assert read_exactly(ends.there, len(data)) == data

    def test_each_byte_value_alone(self, ends: Ends) -> None:
        for value in range(256):
            ends.here.write(bytes([value]))
            assert read_exactly(ends.there, 1) == bytes([value])

    def test_a_megabyte_both_ways_at_once(self, ends: Ends) -> None:
        out, back = random.Random(1).randbytes(MEGABYTE), random.Random(2).randbytes(MEGABYTE)
        tasks = [
            Background(lambda: ends.here.write(out)),
            Background(lambda: ends.there.write(back)),
        ]
        far_reader = Background(lambda: read_exactly(ends.there, MEGABYTE))
        assert read_exactly(ends.here, MEGABYTE) == back
        assert far_reader.result() == out
        for task in tasks:
            task.result()

    def test_sizes_around_chunk_boundaries(self, ends: Ends) -> None:
        sizes = [1, 2, 255, 256, 517, 518, 519, 4095, 4096, 4097, 65535, 65536, 65537]
        blocks = [random.Random(size).randbytes(size) for size in sizes]
        writer = Background(lambda: [ends.here.write(block) for block in blocks])
        whole = b"".join(blocks)
        assert read_exactly(ends.there, len(whole)) == whole
        writer.result()

    @pytest.mark.parametrize("size", PACKET_SIZES)
    def test_one_write_around_a_packet_boundary(self, ends: Ends, size: int) -> None:
        data = random.Random(size).randbytes(size)
        ends.here.write(data)
        assert read_exactly(ends.there, size) == data

    def test_writes_around_packet_boundaries_in_a_row(self, ends: Ends) -> None:
        blocks = [random.Random(size).randbytes(size) for size in PACKET_SIZES * 2]
        for block in blocks:
            ends.here.write(block)
        whole = b"".join(blocks)
        assert read_exactly(ends.there, len(whole)) == whole

    @pytest.mark.parametrize("size", PACKET_SIZES)
    def test_a_reply_around_a_packet_boundary_needs_nothing_after_it(
        self, ends: Ends, size: int
    ) -> None:
        for _ in range(3):
            data = random.Random(size).randbytes(size)
            ends.here.write(data)
            assert read_exactly(ends.there, size) == data
            ends.there.write(data)
            assert read_exactly(ends.here, size) == data
        assert ends.here.read(0) == b""

    def test_any_buffer_can_be_written_also_an_empty_one(self, ends: Ends) -> None:
        ends.here.write(b"")
        ends.here.write(bytearray(b"ab"))
        ends.here.write(memoryview(b"xcdx")[1:3])
        assert read_exactly(ends.there, 4) == b"abcd"

    def test_writes_of_several_threads_do_not_mix(self, ends: Ends) -> None:
        blocks = [bytes([65 + index]) * 20_000 for index in range(4)]
        writers = [Background(lambda block=block: ends.here.write(block)) for block in blocks]
        data = read_exactly(ends.there, 80_000)
        assert sorted(data[at : at + 20_000] for at in range(0, 80_000, 20_000)) == blocks
        for writer in writers:
            writer.result()

    def test_read_without_waiting(self, ends: Ends) -> None:
        assert ends.here.read(0) == b""
        ends.there.write(b"x")
        deadline = time.monotonic() + PATIENCE_S
        while not (data := ends.here.read(0)) and time.monotonic() < deadline:
            time.sleep(0.001)
        assert data == b"x"

    def test_read_waits_for_its_timeout(self, ends: Ends) -> None:
        start = time.monotonic()
        assert ends.here.read(0.05) == b""
        assert time.monotonic() - start >= 0.045
        ends.there.write(b"later")
        assert read_exactly(ends.here, 5) == b"later"

    @pytest.mark.parametrize("timeout_s", [None, PATIENCE_S])
    def test_read_returns_as_soon_as_a_byte_comes(
        self, ends: Ends, timeout_s: float | None
    ) -> None:
        reader = Background(lambda: ends.here.read(timeout_s))
        time.sleep(SETTLE_S)
        ends.there.write(b"!")
        assert reader.result() == b"!"

    def test_a_reader_that_is_woken_returns_early(self, ends: Ends) -> None:
        here, there, _ = ends
        if not here.wake_reader():
            pytest.skip("this transport cannot wake its reader")
        # Before the read, which is the first without a time limit, and while it waits.
        assert here.read(None) == b""
        reading = Background(lambda: here.read(None))
        time.sleep(SETTLE_S)
        assert here.wake_reader()
        assert reading.result() == b""
        there.write(b"x")
        assert here.read(PATIENCE_S) == b"x"
        there.write(b"y")
        here.wake_reader()
        data = here.read(None) or here.read(PATIENCE_S)
        assert data == b"y"

    def test_a_descriptor_is_readable_when_a_read_need_not_wait(self, ends: Ends) -> None:
        here, there, there_is = ends
        if here.fileno() < 0:
            with pytest.raises(NotImplementedError, match="no descriptor"):
                here.wait(0)
            return
        assert not here.wait(0)
        assert not is_readable(here, 0)
        waiter = Background(lambda: here.wait(PATIENCE_S))
        time.sleep(SETTLE_S)
        there.write(b"ab")
        assert waiter.result()
        assert here.wait(0), "it takes nothing"
        assert is_readable(here, PATIENCE_S)
        assert read_exactly(here, 2) == b"ab"
        assert not here.wait(0)
        self.hang_up(there_is, there)
        assert here.wait(PATIENCE_S)
        assert is_readable(here, PATIENCE_S)
        with pytest.raises(LinkLost):
            while here.read(0) == b"" and self.has_exit_code:
                assert is_readable(here, 0)
        assert here.wait(PATIENCE_S)

    def test_close_and_a_woken_reader_end_a_wait(self, ends: Ends) -> None:
        here = ends.here
        if here.fileno() < 0:
            return
        for end, is_over in ((here.wake_reader, False), (here.close, True)):
            waiter = Background(lambda: here.wait(PATIENCE_S))
            time.sleep(SETTLE_S)
            end()
            assert waiter.result() is is_over
        assert here.wait(PATIENCE_S)

    def test_time_is_that_of_the_machine(self, ends: Ends) -> None:
        here = ends.here
        assert not here.is_simulated
        before = time.monotonic()
        assert before <= here.clock() <= time.monotonic()
        here.sleep(SETTLE_S)
        assert here.clock() >= before + SETTLE_S

    def test_what_is_tried_never_waits_and_keeps_its_place(self, ends: Ends) -> None:
        here, there, _ = ends
        data = random.Random(5).randbytes(8 * MEGABYTE)
        sent = taken = here.try_write(data[:1000])
        if not taken:
            pytest.skip("this transport cannot tell what the link takes at once")
        while taken := here.try_write(data[sent : sent + 100_000]):
            sent += taken
            assert sent < len(data), "the peer does not read"
        writer = Background(lambda: here.write(data[sent : sent + 1000]))
        assert read_exactly(there, sent + 1000) == data[: sent + 1000]
        writer.result()
        here.close()
        assert here.try_write(b"x") == 0

    def test_close_ends_a_blocked_read(self, ends: Ends) -> None:
        reader = Background(lambda: ends.here.read(None))
        time.sleep(SETTLE_S)
        ends.here.close()
        with pytest.raises(LinkClosed):
            reader.result()

    def test_close_ends_a_blocked_write(self, ends: Ends) -> None:
        ends.here.write_timeout_s = None
        writer = Background(lambda: fill(ends.here))
        time.sleep(2 * SETTLE_S)
        # Where closing waits for a peer to take the rest, it waits this long.
        ends.here.write_timeout_s = 0.05
        ends.here.close()
        with pytest.raises(LinkClosed):
            writer.result()

    def test_a_peer_that_does_not_read_is_a_write_timeout(self, ends: Ends) -> None:
        ends.here.write_timeout_s = 0.05
        with pytest.raises(WriteTimeout, match=r"took no byte for 0\.05 s"):
            fill(ends.here)
        assert not ends.here.closed
        # The other direction is not affected.
        ends.there.write(b"still here")
        assert read_exactly(ends.here, 10) == b"still here"

    def test_what_the_peer_sent_before_hanging_up_arrives_first(self, ends: Ends) -> None:
        data = random.Random(3).randbytes(3000)
        if ends.there_is in self.discards:
            data = b""
        ends.there.write(data)
        self.hang_up(ends.there_is, ends.there)
        assert read_to_end(ends.here) == data
        with pytest.raises(LinkLost, match="lost"):
            ends.here.read(0)
        assert not ends.here.closed

    def test_a_hang_up_ends_a_blocked_read(self, ends: Ends) -> None:
        reader = Background(lambda: ends.here.read(None))
        time.sleep(SETTLE_S)
        self.hang_up(ends.there_is, ends.there)
        with pytest.raises(LinkLost):
            reader.result()

    def test_writing_to_a_peer_that_hung_up_is_a_lost_link(self, ends: Ends) -> None:
        self.hang_up(ends.there_is, ends.there)
        deadline = time.monotonic() + PATIENCE_S
        with pytest.raises(LinkLost):
            # The kernel may take the first bytes before it knows.
            while time.monotonic() < deadline:
                ends.here.write(bytes(1000))

    def test_close_is_idempotent_and_thread_safe(self, ends: Ends) -> None:
        assert not ends.here.closed
        closers = [Background(ends.here.close) for _ in range(4)]
        ends.here.close()
        for closer in closers:
            closer.result()
        ends.here.close()
        assert ends.here.closed

    def test_a_closed_transport_says_so(self, ends: Ends) -> None:
        ends.there.write(b"never read")
        ends.here.close()
        for timeout_s in (0, 1, None):
            with pytest.raises(LinkClosed):
                ends.here.read(timeout_s)
        for data in (b"x", b""):
            with pytest.raises(LinkClosed):
                ends.here.write(data)

    def test_a_with_block_closes(self, ends: Ends) -> None:
        with ends.here as transport:
            assert transport is ends.here
        assert ends.here.closed

    def test_its_name_holds_the_url(self, ends: Ends) -> None:
        assert ends.here.url in repr(ends.here)
