"""Bad links: every call ends, and no answer is wrong unless the checksum cannot see it.

The session and the server meet in virtual time, driven by hypothesis; the clients and the device
meet over the faults transport.
"""

import asyncio
import struct
import threading
from random import Random

import j2a_transports
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from j2a_spec.constants import MAX_PAYLOAD
from j2a_transports import faults

import j2a
from j2a.demo import DemoDevice
from j2a.events import Reply

from .support import PATIENCE_S, TRICKY, Judge
from .virtual import World

ECHO = 0xBA

edits = st.lists(
    st.tuples(
        st.sampled_from(["drop", "flip", "dup", "dup all", "split", "delay", "marker"]),
        st.integers(0, 600),
        st.integers(0, 7),
    ),
    max_size=3,
)


def damage(data: bytes, plan: list[tuple[str, int, int]]) -> list[tuple[float, bytes]]:
    """Carry out faults on bytes; returns pieces and the seconds before each."""
    pieces = [(0.0, data)]
    for kind, place, number in plan:
        delay_s, last = pieces.pop()
        at = place % (len(last) + 1)
        head, tail = last[:at], last[at:]
        match kind:
            case "drop":
                pieces.append((delay_s, head + tail[1 + number :]))
            case "flip":
                pieces.append((delay_s, head + bytes(b ^ 1 << number for b in tail[:1]) + tail[1:]))
            case "dup":
                pieces.append((delay_s, head + tail[: 1 + number] + tail))
            case "dup all":
                pieces.append((delay_s, last + last))
            case "marker":
                pieces.append((delay_s, head + bytes((TRICKY[number],)) + tail))
            case "split":
                pieces += [(delay_s, head), (0.004, tail)]
            case "delay":
                pieces += [(delay_s, head), (0.015 * (1 + number), tail)]
    return pieces


class BadLink(RuleBasedStateMachine):
    """Calls, SIFs and waiting in any order, with faults in either direction."""

    @initialize(
        first_seq=st.sampled_from([0, 17, 0x11, 0xEC, 250, 255]),
        window=st.sampled_from([1, 1, 3, 8]),
        busy_s=st.sampled_from([0.0, 0.002, 0.06]),
    )
    def begin(self, first_seq, window, busy_s):
        self.world = World(first_seq=first_seq, window=window, busy_s=busy_s)
        self.sent = []
        self.cancelled = []
        self.sif = 0

    @rule(plan=edits)
    def make_faults(self, plan):
        """The next bytes suffer; those after them do not."""
        done = []

        def fault(data):
            if done:
                return [(0.0, data)]
            done.append(True)
            return damage(data, plan)

        self.world.fault = fault

    @rule(extra=st.binary(max_size=12), timeout_s=st.sampled_from([0.005, 0.05, 0.5]))
    def call(self, extra, timeout_s):
        payload = struct.pack("<H", len(self.sent)) + extra
        self.sent.append((payload, self.world.call(payload, timeout_s)))

    @rule(n=st.integers(1, 5))
    def call_often(self, n):
        for _ in range(n):
            self.call(b"\x12\xed\x7d", 0.1)

    @precondition(lambda self: self.sent)
    @rule(which=st.integers(0, 1000))
    def cancel(self, which):
        call = self.sent[which % len(self.sent)][1]
        if not call.has_ended:
            self.cancelled.append(call)
            self.world.cancel(call)

    @rule()
    def send_sif(self):
        self.world.send_sif(struct.pack("<L", self.sif))
        self.sif += 1

    @rule(seconds=st.sampled_from([0.0005, 0.002, 0.009, 0.012, 0.1, 1.0]))
    def wait(self, seconds):
        self.world.run(seconds)

    @invariant()
    def no_answer_is_wrong(self):
        if not hasattr(self, "world"):
            return
        for payload, call in self.sent:
            if call.reply is not None and call.reply != Reply(ECHO, payload):
                assert self.world.judge.excuses(call.seq), (payload, call)

    @invariant()
    def sifs_keep_their_order(self):
        if hasattr(self, "world") and not self.world.judge.forged("host"):
            numbers = [struct.unpack("<L", sif.payload)[0] for sif in self.world.sifs]
            assert numbers == sorted(numbers)
            assert set(numbers) <= set(range(self.sif))

    def teardown(self):
        if not hasattr(self, "world"):
            return
        self.world.run(60.0)
        assert all(call.has_ended for _, call in self.sent)
        # Whatever happened before: the link has healed.
        self.world.fault = lambda data: [(0.0, data)]
        call = self.world.call(b"healed", 10.0)
        self.world.run(20.0)
        assert call.reply == Reply(ECHO, b"healed")
        self.no_answer_is_wrong()


TestBadLink = BadLink.TestCase
TestBadLink.settings = settings(max_examples=150, stateful_step_count=30)


# ---------------------------------------------------------------------- the real thing

RATES = {"drop": 4e-4, "flip": 4e-4, "dup": 4e-4, "split": 2e-2, "delay": 2e-4}
SEEDS = range(4)
CALLS = 60


class BadWorld:
    """A demo device behind a link with seeded faults, and the judge of it."""

    def __init__(self, seed: int) -> None:
        near, far = j2a_transports.pair()
        self.judge = Judge()
        self.near = faults.wrap(near, seed=seed, **RATES)
        self.device = DemoDevice(trace=self.judge.device)
        self.server = threading.Thread(target=self.device.serve, args=(far,))
        self.seqs: dict[bytes, int] = {}
        self.good = self.bad = 0

    def __enter__(self) -> "BadWorld":
        self.server.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.device.stop()
        self.server.join(PATIENCE_S)
        assert not self.server.is_alive()

    def trace(self, direction, item) -> None:
        self.judge.host(direction, item)
        if direction == "tx" and isinstance(item, j2a.Frame):
            self.seqs[item.payload] = item.seq

    def check(self, payload: bytes, reply: Reply) -> None:
        if reply == Reply(ECHO, payload):
            self.good += 1
        else:
            assert self.judge.excuses(self.seqs[payload]), (payload, reply)

    def payloads(self, seed: int) -> list[bytes]:
        random = Random(seed)
        sizes = [random.choice([0, 10, 100, 200]) for _ in range(CALLS)]
        return [b"%d " % n + random.randbytes(size) for n, size in enumerate(sizes)]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_client_over_a_bad_link(seed):
    with BadWorld(seed) as world, j2a.Client(world.near, timeout=0.2, trace=world.trace) as client:
        client._device.room = MAX_PAYLOAD  # known, so that each call sends one frame
        for payload in world.payloads(seed):
            try:
                world.check(payload, client.call(4, payload))
            except (j2a.RemoteError, j2a.CallTimeout):
                world.bad += 1
        assert world.good > CALLS / 6
        assert world.good + world.bad <= CALLS
        assert client.is_open
        counters = client.counters
    assert counters.frames_sent == CALLS


@pytest.mark.parametrize("seed", SEEDS)
def test_the_asyncio_client_over_a_bad_link(seed):
    async def run(world: BadWorld) -> None:
        async with j2a.AsyncClient(world.near, timeout=0.2, trace=world.trace) as client:

            async def call(payload: bytes) -> None:
                try:
                    world.check(payload, await client.call(4, payload, timeout=PATIENCE_S / 2))
                except (j2a.RemoteError, j2a.CallTimeout):
                    world.bad += 1

            for payload in world.payloads(seed):
                try:
                    await asyncio.wait_for(call(payload), 0.2)
                except TimeoutError:
                    world.bad += 1
            assert world.good > CALLS / 6
            assert client.is_open

    with BadWorld(seed) as world:
        asyncio.run(run(world))


def test_faults_are_seen_by_the_counters():
    seen = j2a.Counters()
    with BadWorld(7) as world, j2a.Client(world.near, timeout=0.1, trace=world.trace) as client:
        for payload in world.payloads(7) * 2:
            try:
                client.call(4, payload)
            except (j2a.RemoteError, j2a.CallTimeout):
                world.bad += 1
        seen = client.counters
    assert world.bad
    # An error reply may name a call whose true reply comes after all.
    assert seen.timeouts + seen.error_replies >= world.bad
    assert seen.checksum_errors + seen.framing_errors + seen.error_replies > 0
