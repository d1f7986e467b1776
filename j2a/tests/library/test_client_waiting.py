"""The blocking client while it waits: time limits, SIFs and their handlers, the end of the link."""

import math
import queue
import signal
import struct
import sys
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS

import j2a
from j2a.demo import DemoDevice

from .support import PATIENCE_S, linked
from .wire import Background, BrokenDriver, Wire, delay


class TestTimeLimits:
    def test_a_late_reply_does_not_answer_the_next_call(self):
        device, gate = DemoDevice(), threading.Event()
        device.function("gate")(lambda _payload: (gate.wait(PATIENCE_S), b"late")[1])
        with linked(device) as client:
            with pytest.raises(j2a.CallTimeout, match=r"gate .* 0\.05 s"):
                client.call("gate", timeout=0.05)
            gate.set()
            assert client.echo(b"next") == b"next"
            assert client.counters.timeouts == 1
            assert client.counters.late_replies == 1

    @pytest.mark.requirement("J2A-TIME-006")
    def test_calls_that_wait_for_their_turn_time_out_too(self):
        with Wire() as wire:
            slow = Background(wire.client.call, 1)
            request = wire.request()
            with pytest.raises(j2a.CallTimeout, match="not sent"):
                wire.client.call(2, b"waiting", timeout=0.05)
            wire.send(oracle.Frame(SOF, request.seq, 3, b"slow"))
            assert slow.result() == (3, b"slow")
            assert wire.client.counters.frames_sent == 1

    def test_waiting_for_ever_ends_with_the_reply(self):
        with linked() as client:
            assert client.call("delay", delay(50), timeout=math.inf) == j2a.Reply(0, b"")

    def test_seqs_wrap_around(self):
        with linked() as client:
            for n in range(600):
                payload = struct.pack("<H", n)
                assert client.echo(payload) == payload
            assert client.counters.stray_replies == 0

    @pytest.mark.requirement("J2A-SEQ-004", "J2A-SEQ-005")
    def test_stray_replies_are_dropped(self):
        with Wire() as wire:
            call = Background(wire.client.call, 9, b"x")
            request = wire.request()
            strays = [
                oracle.Frame(SOF, (request.seq + n) & 0xFF, 0, b"stray") for n in (1, 7, 128, 255)
            ]
            answer = oracle.Frame(SOF, request.seq, 5, b"answer")
            wire.send(*strays, answer, answer)
            assert call.result() == (5, b"answer")
            following = Background(wire.client.call, 10, b"y")
            assert wire.request().seq == (request.seq + 1) & 0xFF
            wire.send(answer, oracle.Frame(SOF, (request.seq + 1) & 0xFF, 6, b"second"))
            assert following.result() == (6, b"second")
            assert wire.client.counters.stray_replies == 6

    def test_what_an_earlier_program_left_behind_answers_nothing(self):
        near, far = j2a_transports.pair()
        for seq in range(256):
            far.write(oracle.encode(oracle.Frame(SOF, seq, 0, b"stale")))
        with j2a.Client(near, timeout=PATIENCE_S) as client:
            with pytest.raises(j2a.CallTimeout):
                client.call(1, timeout=0.02)
            assert client.counters.stray_replies == 256

    def test_an_interrupted_call_lets_the_next_one_go(self):
        def interrupt(_number, _frame):
            raise KeyboardInterrupt

        with Wire() as wire:
            before = signal.signal(signal.SIGALRM, interrupt)
            queued = threading.Timer(0.05, lambda: calls.append(Background(wire.client.call, 2)))
            calls = []
            queued.start()
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            try:
                with pytest.raises(KeyboardInterrupt):
                    wire.client.call(1, timeout=math.inf)
            finally:
                signal.signal(signal.SIGALRM, before)
            queued.join(PATIENCE_S)
            first = wire.request()
            second = wire.request()
            assert (first.opcode, second.opcode) == (1, 2)
            wire.send(oracle.Frame(SOF, second.seq, 0, b"done"))
            assert calls[0].result().payload == b"done"

    def test_a_call_interrupted_while_it_is_started_leaves_the_window(self, monkeypatch):
        with Wire() as wire:
            start_call = wire.client._session.start_call

            def interrupted(*args, **kwargs):
                start_call(*args, **kwargs)
                raise KeyboardInterrupt

            with monkeypatch.context() as patched:
                patched.setattr(wire.client._session, "start_call", interrupted)
                with pytest.raises(KeyboardInterrupt):
                    wire.client.call(1, timeout=math.inf)
            call = Background(wire.client.call, 2)
            while (request := wire.request()).opcode != 2:
                pass
            wire.send(oracle.Frame(SOF, request.seq, 0, b"done"))
            assert call.result().payload == b"done"

    def test_an_interrupted_call_is_forgotten(self):
        def interrupt(_number, _frame):
            raise KeyboardInterrupt

        with Wire() as wire:
            before = signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            try:
                with pytest.raises(KeyboardInterrupt):
                    wire.client.call(1)
            finally:
                signal.signal(signal.SIGALRM, before)
            seq = wire.request().seq
            call = Background(wire.client.call, 2)
            assert wire.request().opcode == 2
            wire.send(
                oracle.Frame(SOF, seq, 0, b"old"), oracle.Frame(SOF, seq + 1 & 0xFF, 0, b"new")
            )
            assert call.result().payload == b"new"
            assert wire.client.counters.late_replies == 1

    def test_first_seqs_differ_from_program_to_program(self):
        seqs = set()
        for _ in range(20):
            with Wire() as wire:
                call = Background(wire.client.call, 9)
                request = wire.request()
                seqs.add(request.seq)
                wire.send(oracle.Frame(SOF, request.seq, 0, b""))
                call.result()
        assert len(seqs) > 1


class TestSifs:
    @pytest.mark.requirement("J2A-SIF-007")
    def test_order_filters_and_cancelling(self):
        with linked() as client:
            every, some, one, done = [], [], [], threading.Event()
            client.on_sif(None, lambda sif: every.append(sif.payload))
            client.on_sif(range(2, 4), lambda sif: some.append(sif.payload))
            subscription = client.on_sif(3, lambda sif: one.append(sif.payload))
            client.on_sif(0xFF, lambda sif: done.set())
            for opcode in (1, 2, 3):
                client.call("sif", bytes((opcode,)) + b"payload%d" % opcode)
            client.call("sif", b"\xff")
            assert done.wait(PATIENCE_S)
            subscription.cancel()
            subscription.cancel()
            done.clear()
            client.call("sif", b"\x03again")
            client.call("sif", b"\xff")
            assert done.wait(PATIENCE_S)
            assert every == [b"payload1", b"payload2", b"payload3", b"", b"again", b""]
            assert some == [b"payload2", b"payload3", b"again"]
            assert one == [b"payload3"]
            assert client.counters.sifs == 6

    def test_handlers_may_call(self):
        with linked() as client:
            echoes, done = [], threading.Event()

            @client.on_sif(5)
            def handler(sif):
                echoes.append(client.echo(sif.payload))
                if len(echoes) == 20:
                    done.set()

            assert callable(handler)
            for n in range(20):
                client.call("sif", bytes((5, n)))
            assert done.wait(PATIENCE_S)
            assert echoes == [bytes((n,)) for n in range(20)]

    def test_a_handler_may_close_the_client(self):
        with linked() as client:
            closed = threading.Event()
            client.on_sif(None, lambda sif: (client.close(), closed.set()))
            client.call("sif", b"\x01")
            assert closed.wait(PATIENCE_S)
            assert not client.is_open

    def test_exceptions_of_handlers_are_logged_and_counted(self, caplog):
        with linked() as client:
            done = threading.Event()

            @client.on_sif()
            def broken(sif):
                raise RuntimeError("broken on purpose")

            client.on_sif(None, lambda sif: done.set())
            client.call("sif", b"\x07")
            assert done.wait(PATIENCE_S)
            assert client.counters.handler_errors == 1
            assert [str(record.exc_info[1]) for record in caplog.records] == ["broken on purpose"]

    @pytest.mark.parametrize("hook", [None, lambda _error, _sif: sys.exit("the hook as well")])
    def test_a_handler_that_exits_does_not_end_the_others(self, hook, caplog):
        with linked(on_handler_error=hook) as client:
            seen = queue.SimpleQueue()

            @client.on_sif()
            def leaves(sif):
                seen.put(sif.opcode)
                sys.exit("on purpose")

            client.call("sif", b"\x07")
            client.call("sif", b"\x08")
            assert [seen.get(timeout=PATIENCE_S) for _ in range(2)] == [7, 8]
            client.close()
            assert client.counters.handler_errors == 2
        assert "on purpose" in caplog.text

    def test_a_handler_cancelled_by_an_earlier_one_is_not_called(self):
        with linked() as client:
            seen, done = [], threading.Event()
            client.on_sif(None, lambda _sif: later.cancel())
            later = client.on_sif(None, seen.append)
            client.on_sif(None, lambda _sif: done.set())
            client.call("sif", b"\x01")
            assert done.wait(PATIENCE_S)
            assert seen == []

    def test_exceptions_of_handlers_reach_the_hook(self, caplog):
        errors, done = [], threading.Event()

        def hook(error, sif):
            errors.append((str(error), sif.opcode))
            if len(errors) == 2:
                done.set()
                raise ValueError("the hook as well")

        def broken(sif):
            raise RuntimeError("broken on purpose")

        with linked(on_handler_error=hook) as client:
            client.on_sif(None, broken)
            client.call("sif", b"\x07")
            client.call("sif", b"\x08")
            assert done.wait(PATIENCE_S)
        assert errors == [("broken on purpose", 7), ("broken on purpose", 8)]
        assert "on_handler_error failed" in caplog.text

    @pytest.mark.requirement("J2A-SIF-009")
    def test_gaps_reach_the_handler(self):
        with Wire() as wire:
            seen, done = [], threading.Event()
            wire.client.on_sif(None, lambda sif: (seen.append(sif), len(seen) < 2 or done.set()))
            wire.send(oracle.Frame(SOS, 4, 0xF2, b"a"), oracle.Frame(SOS, 9, 0xFF, b"b"))
            assert done.wait(PATIENCE_S)
            assert seen == [j2a.Sif(0xF2, b"a", 4, 0), j2a.Sif(0xFF, b"b", 9, 4)]
            assert wire.client.counters.sif_gaps == 1
            assert wire.client.counters.sifs_missed == 4

    def test_too_many_sifs_for_slow_handlers_are_dropped_and_counted(self, monkeypatch):
        monkeypatch.setattr("j2a.io.blocking.MAX_SIFS_WAITING", 3)
        with Wire() as wire:
            seen, started, gate = [], threading.Event(), threading.Event()

            def slow(sif):
                started.set()
                assert gate.wait(PATIENCE_S)
                seen.append(sif.opcode)

            wire.client.on_sif(None, slow)
            wire.send(oracle.Frame(SOS, 0, 0, b""))
            assert started.wait(PATIENCE_S)
            wire.send(*(oracle.Frame(SOS, n, n, b"") for n in range(1, 8)))
            while wire.client.counters.sifs < 8:
                time.sleep(0.001)
            assert wire.client.counters.sifs_dropped == 4
            gate.set()
            while len(seen) < 4:
                time.sleep(0.001)
            assert seen == [0, 1, 2, 3]

    def test_periodic_sifs(self):
        with linked() as client:
            numbers, done = [], threading.Event()

            @client.on_sif(0x20)
            def count(sif):
                numbers.extend(struct.unpack("<I", sif.payload))
                if len(numbers) == 10:
                    done.set()

            client.call("sifPeriod", delay(2))
            assert done.wait(PATIENCE_S)
            client.call("sifPeriod", delay(0))
            assert numbers[:10] == list(range(10))


class TestTheEnd:
    def test_close_while_calls_wait(self):
        with Wire() as wire:
            calls = [Background(wire.client.call, n, timeout=math.inf) for n in range(5)]
            wire.request()
            wire.client.close()
            for call in calls:
                with pytest.raises(j2a.LinkClosed):
                    call.result()
            with pytest.raises(j2a.LinkClosed):
                wire.client.call(1)
            wire.client.close()

    @pytest.mark.requirement("J2A-TIME-006")
    def test_a_lost_link_ends_all_calls_at_once(self):
        with Wire() as wire:
            calls = [Background(wire.client.call, n, timeout=math.inf) for n in range(5)]
            wire.request()
            wire.far.close()
            for call in calls:
                with pytest.raises(j2a.LinkLost):
                    call.result()
            with pytest.raises(j2a.LinkLost):
                wire.client.call(1)
            assert not wire.client.is_open

    @pytest.mark.parametrize("fails", ["read", "write"])
    def test_a_broken_driver_ends_all_calls(self, fails):
        with j2a.Client(BrokenDriver(fails)) as client:
            call = Background(client.call, 1, timeout=math.inf)
            with pytest.raises(j2a.LinkLost, match="ValueError: a bug in the driver"):
                call.result()

    def test_sifs_that_came_before_the_link_was_lost_are_handled(self):
        with Wire() as wire:
            seen, done = [], threading.Event()
            started = threading.Event()

            def handler(sif):
                started.set()
                assert done.wait(PATIENCE_S)
                seen.append(sif.opcode)

            wire.client.on_sif(None, handler)
            wire.send(*(oracle.Frame(SOS, n, n, b"") for n in range(5)))
            assert started.wait(PATIENCE_S)
            wire.far.close()
            while wire.client.is_open:
                time.sleep(0.001)
            done.set()
            while len(seen) < 5:
                time.sleep(0.001)
            assert seen == list(range(5))

    @pytest.mark.requirement("J2A-TIME-006")
    def test_calls_keep_their_time_limit_while_the_device_does_not_read(self):
        with Wire() as wire:
            wire.client._engine._transport.write_timeout_s = None
            wire.client._engine._transport._outgoing._limit = 3
            calls = [Background(wire.client.call, n, bytes(9), timeout=0.05) for n in range(3)]
            for call in calls:
                with pytest.raises(j2a.CallTimeout):
                    call.result()

    def test_a_device_that_does_not_read_cannot_block_replies(self):
        with Wire() as wire:
            wire.client._engine._transport.write_timeout_s = 0.2
            wire.client._engine._transport._outgoing._limit = 3
            call = Background(wire.client.call, 1, bytes(100), timeout=math.inf)
            with pytest.raises(j2a.LinkLost, match="does not read"):
                call.result()

    def test_a_timed_out_request_leaves_the_link_usable(self):
        with Wire() as wire:
            with pytest.raises(j2a.CallTimeout):
                wire.client.call(1, timeout=0.01)
            first = wire.request()
            call = Background(wire.client.call, 2)
            second = wire.request()
            wire.send(
                oracle.Frame(SOF, first.seq, 0, b"late"), oracle.Frame(SOF, second.seq, 0, b"now")
            )
            assert call.result().payload == b"now"

    def test_the_threads_end(self):
        before = threading.active_count()
        for _ in range(5):
            with linked() as client:
                client.echo(b"x")
        deadline = time.monotonic() + PATIENCE_S
        while threading.active_count() > before and time.monotonic() < deadline:
            time.sleep(0.01)
        assert threading.active_count() <= before
