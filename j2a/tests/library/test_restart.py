"""A device that restarts while the link stays (SPEC.md, section 21)."""

import asyncio
import contextlib
import enum
import gc
import logging
import struct
import threading
import time
import weakref
from collections import OrderedDict

import j2a_transports
import pytest
from j2a_spec import oracle, vectors
from j2a_spec.constants import BOOT, GET_MAPPING, SOF, SOS

import j2a
from j2a.errors import Outcome
from j2a.events import ResetCause, Restart
from j2a.io.handlers import NamedSif
from j2a.protocol.boot import pack_boot, unpack_boot
from j2a.protocol.device_info import DeviceInfo
from j2a.protocol.session import Session
from j2a.types.descriptors import parse_descriptors
from j2a.types.transds_file import read_transds

from .rebooting import Rebooting, boot_payload
from .support import PATIENCE_S, linked
from .wire import Background


class Mode(enum.IntEnum):
    off = 0
    on = 1


def old_firmware(**options):
    """Firmware with `add`, `read`, `mode`, `raw` and the SIF `beat`."""
    device = j2a.Device(**{"boot": True, **options})
    device.calls = []
    device.describe_sif("beat", 7, "(count u8)")

    @device.function
    def add(a: j2a.i32, b: j2a.i32) -> j2a.i32:
        device.calls.append("add")
        return a + b

    @device.function
    def read() -> j2a.u8:
        device.calls.append("read")
        return 7

    @device.function
    def mode(mode: Mode) -> Mode:
        return mode

    device.function("raw")(lambda payload: payload)
    device.many("log")(lambda request: j2a.read_chunk(b"old" * 200, request))
    return device


def new_firmware(**options):
    """Firmware whose functions have other opcodes, and `erase` has that of the old `add`."""
    device = j2a.Device(**{"boot": True, **options})
    device.calls = []
    device.describe_sif("beat", 9, "(level u16, count u8)")

    @device.function
    def erase() -> None:
        device.calls.append("erase")

    @device.function
    def add(a: j2a.i64, b: j2a.i64) -> j2a.i64:
        device.calls.append("add")
        return a + b

    @device.function
    def read() -> j2a.u8:
        device.calls.append("read")
        return 9

    @device.function
    def mode(mode: Mode) -> Mode:
        return mode

    device.function("raw")(lambda payload: payload + b"!")
    device.many("log")(lambda request: j2a.read_chunk(b"new" * 200, request))
    return device


@contextlib.contextmanager
def connected(device, *, says=True, timeout=PATIENCE_S, **options):
    """A board, as it is after a reset, and a client that has learnt what it has."""
    with Rebooting(device) as board:
        if says:
            board.reset()
        with j2a.Client(board.near, timeout=timeout, **options) as client:
            client.refresh()
            yield board, client


def restart(board, client, firmware=None, **options):
    """Reset the board, and wait until the client has noticed it."""
    before = client.counters.restarts
    board.reset(firmware, **options)
    while client.counters.restarts == before:
        pass


def queued(lost, time_us):
    """Return a sample of a sensor with a queue, of one value of a byte."""
    return struct.pack("<HBQB", lost, 0, time_us, 7)


def in_loop(test):
    return asyncio.run(asyncio.wait_for(test, 2 * PATIENCE_S))


@contextlib.asynccontextmanager
async def aconnected(device):
    with Rebooting(device) as board:
        board.reset()
        async with j2a.AsyncClient(board.near, timeout=PATIENCE_S) as client:
            await client.refresh()
            yield board, client


class TestPayload:
    @pytest.mark.requirement("J2A-BOOT-007")
    def test_means_what_the_grammar_says(self):
        tests = [test for test in vectors.load("payload") if test["grammar"] == "boot"]
        assert len(tests) >= 15
        for test in tests:
            found = unpack_boot(bytes.fromhex(test["data"]))
            value = test["value"]
            if value is None:
                assert found == Restart()
                continue
            assert (found.count, found.interface_hash) == (value["count"], f"{value['hash']:08x}")
            known = {cause.value for cause in ResetCause}
            assert found.cause == (value["cause"] if value["cause"] in known else 0)
            if test["result"] == "valid":
                packed = pack_boot(found.cause, found.count, found.interface_hash)
                assert packed.hex() == test["data"]


class TestSession:
    def session(self, has_boot=True, window=4):
        session = Session(first_seq=10, window=window)
        session.rxbuf = 1000
        session.has_boot = has_boot
        return session

    def start(self, session, what="f", **options):
        return session.start_call(what, 5, b"", now=0.0, timeout_s=9.0, waiter=object(), **options)

    def boot(self, seq=0, payload=bytes(7)):
        return oracle.encode(oracle.Frame(SOS, seq, BOOT, payload))

    @pytest.mark.requirement("J2A-BOOT-004")
    @pytest.mark.parametrize("sent", range(5))
    @pytest.mark.parametrize("queued", range(3))
    def test_ends_every_call(self, sent, queued):
        session = self.session(window=max(sent, 1))
        calls = [self.start(session) for _ in range(sent + queued)]
        events = session.receive(self.boot(payload=bytes((4, 3, 0, 1, 2, 3, 4))), 1.0)
        assert events[: len(calls)] == calls
        restart, sif = events[len(calls) :]
        assert restart == Restart(ResetCause.WATCHDOG, 3, "04030201")
        assert (sif.opcode, sif.seq, sif.missed) == (BOOT, 0, 0)
        for number, call in enumerate(calls):
            assert isinstance(call.error, j2a.DeviceRestarted)
            was_sent = number < max(sent, 1)
            assert call.error.outcome is (Outcome.MAYBE_EXECUTED if was_sent else Outcome.NOT_SENT)
            assert "watchdog" in str(call.error)
        assert session.waiting == 0
        assert session.counters.restarts == 1

    @pytest.mark.requirement("J2A-BOOT-004")
    def test_takes_no_later_reply_for_one_to_an_earlier_call(self):
        session = self.session()
        old = self.start(session)
        session.receive(self.boot(), 1.0)
        for _ in range(255):
            call = self.start(session)
            assert call.seq != old.seq
            late = oracle.encode(oracle.Frame(SOF, old.seq, 0, b"late"))
            reply = oracle.encode(oracle.Frame(SOF, call.seq, 0, b"right"))
            assert session.receive(late + reply, 1.0) == [call]
            assert call.reply.payload == b"right"
            if session.counters.late_replies == 1:
                break
        assert session.counters.late_replies == 1

    @pytest.mark.requirement("J2A-BOOT-007")
    @pytest.mark.parametrize("before", [None, 0, 1, 100, 255])
    @pytest.mark.parametrize("seq", [0, 1, 254, 255])
    def test_begins_to_count_sifs_anew(self, before, seq):
        session = self.session()
        if before is not None:
            session.receive(oracle.encode(oracle.Frame(SOS, before, 1, b"")))
        session.receive(self.boot(seq=seq))
        after = oracle.encode(oracle.Frame(SOS, (seq + 3) % 256, 1, b""))
        [sif] = session.receive(after)
        assert sif.missed == 2
        assert session.counters.sifs_missed == 2

    @pytest.mark.parametrize("length", range(12))
    def test_any_length_is_a_restart(self, length):
        session = self.session()
        call = self.start(session)
        assert session.receive(self.boot(payload=bytes(range(length))), 1.0)[0] is call
        assert session.generation == 1

    @pytest.mark.parametrize("has_boot", [False, None])
    def test_is_a_sif_like_others_where_nobody_announced_it(self, has_boot):
        session = self.session(has_boot)
        call = self.start(session)
        [sif] = session.receive(self.boot(), 1.0)
        assert sif.opcode == BOOT
        assert not call.has_ended
        assert session.generation == session.epoch == 0
        session.receive(self.boot(seq=1), 1.0)
        # Before it is known whether the device has the capability, it may be one.
        assert session.epoch == (has_boot is None)

    @pytest.mark.parametrize("opcode", [0, 1, 0x7F, 0xFE])
    def test_other_opcodes_are_other_sifs(self, opcode):
        session = self.session()
        call = self.start(session)
        session.receive(oracle.encode(oracle.Frame(SOS, 0, opcode, bytes(7))), 1.0)
        assert not call.has_ended
        assert session.epoch == 0

    def test_a_reply_of_that_code_is_a_reply(self):
        session = self.session()
        call = self.start(session)
        session.receive(oracle.encode(oracle.Frame(SOF, call.seq, BOOT, bytes(7))), 1.0)
        assert call.reply.code == 0xFF
        assert session.generation == 0

    def test_a_damaged_one_is_none(self):
        session = self.session()
        call = self.start(session)
        wire = bytearray(self.boot())
        wire[-1] ^= 1
        session.receive(bytes(wire), 1.0)
        assert not call.has_ended
        assert session.generation == 0

    def test_refuses_a_call_of_a_generation_that_is_over(self):
        session = self.session()
        session.receive(self.boot())
        self.start(session, generation=1)
        self.start(session)
        for generation in (0, 2):
            with pytest.raises(j2a.DeviceRestarted) as caught:
                self.start(session, generation=generation)
            assert caught.value.outcome is Outcome.NOT_SENT
        assert session.waiting == 2

    def test_forgets_what_the_device_can_hold(self):
        session = self.session()
        session.receive(self.boot())
        assert session.rxbuf == 0
        calls = [self.start(session) for _ in range(3)]
        assert [call.was_sent for call in calls] == [True, False, False]

    @pytest.mark.parametrize(
        ("seqs", "doubts"),
        [((5, 6, 7), 0), ((5, 7), 0), ((254, 255, 0, 1), 0), ((5, 4), 1), ((5, 0), 1), ((5, 5), 1),
         ((200, 1), 1), ((0, 0), 1), ((3, 4, 0, 1), 1), ((255, 1), 0)],
    )  # fmt: skip
    def test_a_counter_that_goes_back_is_a_clue(self, seqs, doubts):
        session = self.session(has_boot=False)
        for seq in seqs:
            session.receive(oracle.encode(oracle.Frame(SOS, seq, 1, b"")))
        assert (session.epoch, session.generation) == (doubts, 0)


class TestCalls:
    @pytest.mark.requirement("J2A-BOOT-005")
    def test_a_name_is_looked_up_in_the_new_map(self):
        with connected(old_firmware()) as (board, client):
            assert client.call("raw", b"a").payload == b"a"
            new = new_firmware()
            restart(board, client, new)
            assert client.call("raw", b"a").payload == b"a!"
            assert client.functions.read() == 9
            assert client.read_many("log") == b"new" * 200
            assert new.calls == ["read"]

    @pytest.mark.requirement("J2A-BOOT-006")
    @pytest.mark.parametrize("how", ["kept", "with timeout", "used before"])
    def test_a_changed_signature_is_refused(self, how):
        with connected(old_firmware()) as (board, client):
            add = client.functions.add
            if how == "used before":
                assert add(40, 2) == 42
            if how == "with timeout":
                add = add.with_timeout(9)
            new = new_firmware()
            restart(board, client, new)
            for _ in range(2):
                with pytest.raises(j2a.InterfaceChanged, match=r"add.*i32.*i64") as caught:
                    add(40, 2)
                assert caught.value.outcome is Outcome.NOT_SENT
            assert new.calls == []
            assert client.functions.add(40, 2) == 42
            assert new.calls == ["add"]

    @pytest.mark.requirement("J2A-BOOT-006")
    def test_a_function_that_is_gone_is_refused(self):
        with connected(old_firmware()) as (board, client):
            add, raw = client.functions.add, client.functions["raw"]
            bare = j2a.Device(boot=True)
            restart(board, client, bare)
            with pytest.raises(j2a.InterfaceChanged, match="no function of that name"):
                add(1, 2)
            with pytest.raises(j2a.InterfaceChanged, match="no function of that name"):
                client.call(raw, b"")
            with pytest.raises(j2a.UnknownFunction):
                client.call("add", b"")

    @pytest.mark.requirement("J2A-BOOT-006")
    def test_a_function_that_is_not_described_any_more_is_refused(self):
        with connected(old_firmware()) as (board, client):
            add = client.functions.add
            raw = j2a.Device(boot=True)
            raw.function("add")(lambda payload: payload)
            restart(board, client, raw)
            with pytest.raises(j2a.InterfaceChanged, match="not described"):
                add(1, 2)

    def test_an_equal_function_moves_to_its_new_opcode(self):
        with connected(old_firmware()) as (board, client):
            read, log, raw = (client.functions[name] for name in ("read", "log", "raw"))
            mode = client.functions.mode
            old_opcode = read.opcode
            restart(board, client, new_firmware())
            assert [read(), read()] == [9, 9]
            assert read.opcode == client.functions.read.opcode != old_opcode
            assert client.read_many(log) == b"new" * 200
            assert client.call(raw, b"a").payload == b"a!"
            assert mode(1) == 1

    def test_what_the_user_described_is_found_by_its_name_or_opcode(self):
        with connected(old_firmware()) as (board, client):
            by_name = client.function("raw", "(a u8) (a u8, rest bytes)")
            by_opcode = client.function(4, "(text text) text")
            restart(board, client, new_firmware())
            assert by_name(1) == (1, b"!")
            with pytest.raises(j2a.FunctionFailed, match="0xBA"):
                by_opcode("hello")

    @pytest.mark.requirement("J2A-BOOT-004")
    def test_a_call_under_way_ends(self):
        with connected(old_firmware()) as (board, client):
            board.is_mute = True
            asked = len(board.requests)
            calls = [Background(client.call, "raw", b"a"), Background(client.functions.add, 1, 2)]
            board.wait_for_request(asked + 1)
            while client._session.waiting < 2:
                pass
            board.reset()
            fates = []
            for call in calls:
                with pytest.raises(j2a.DeviceRestarted) as caught:
                    call.result()
                fates.append(caught.value.outcome)
            assert set(fates) == {Outcome.MAYBE_EXECUTED, Outcome.NOT_SENT}

    @pytest.mark.requirement("J2A-BOOT-004")
    def test_a_transfer_under_way_ends(self):
        with connected(old_firmware()) as (board, client):
            board.is_mute = True
            asked = len(board.requests)
            reading = Background(client.read_many, "log")
            first = board.wait_for_request(asked + 1)
            board.reply(first, 0, bytes((0, 0, 0, 0, 0, 0)) + b"old" * 80)
            board.wait_for_request(asked + 2)
            board.reset(new_firmware())
            with pytest.raises(j2a.DeviceRestarted):
                reading.result()

    def test_a_transfer_does_not_go_on_in_the_new_firmware(self):
        """The restart comes between two chunks, when no call waits."""
        with connected(old_firmware()) as (board, client):
            new = new_firmware()

            def swap(done, _total):
                if done < 600:
                    restart(board, client, new)

            with pytest.raises(j2a.DeviceRestarted, match="meanwhile"):
                client.read_many("log", progress=swap)
            assert all(by is not new or frame.opcode == 0 or frame.payload[:1] != b"\x0b"
                       for frame, by in board.requests)  # fmt: skip

    @pytest.mark.requirement("J2A-BOOT-005")
    @pytest.mark.parametrize("length", [32, 33, 255])
    def test_the_room_is_learnt_anew(self, length):
        with connected(old_firmware()) as (board, client):
            raw = int(client.functions["raw"])
            assert client.call(raw, bytes(255)).ok
            restart(board, client, old_firmware(room=32))
            if length == 32:
                assert client.call(raw, bytes(length)).ok
            else:
                with pytest.raises(j2a.PayloadTooLong):
                    client.call(raw, bytes(length))

    @pytest.mark.requirement("J2A-DISP-007", "J2A-IFACE-010")
    @pytest.mark.parametrize("boot", [False, True])
    def test_a_function_is_found_anew_behind_a_refresh_that_shows_another_device(self, boot):
        """Whoever loads firmware need not tell, and refreshes by hand."""
        new = new_firmware(boot=boot)
        with connected(old_firmware(boot=boot)) as (board, client):
            read, add = client.functions.read, client.functions.add
            log = client.function("log", "(data bytes)")
            assert read() == 7
            board.reset(new, says=False)
            client.refresh()
            assert read() == 9
            with pytest.raises(j2a.InterfaceChanged):
                add(40, 2)
            assert client.read_many(log) == b"new" * 200
            assert client.counters.restarts == 0
        assert new.calls == ["read"]

    @pytest.mark.requirement("J2A-TRANS-026", "J2A-TRANS-027")
    @pytest.mark.parametrize(("says", "expected"), [(False, (2, True)), (True, (0, True))])
    def test_samples_go_on_behind_other_firmware(self, says, expected):
        log = parse_descriptors("\nsensor log 9 1 u8\n queue 9\n")
        told = []
        with connected(old_firmware(transducers=log)) as (board, client):
            client.transducers["log"].on_sample(lambda one: told.append((one.lost, one.is_reset)))
            board.sif(9, queued(4, 1000))
            while client.transducers["log"].latest() is None:
                time.sleep(0.001)
            board.reset(new_firmware(transducers=log), says=says)
            if not says:
                client.refresh()
                board.skip_sifs(2)
            board.sif(9, queued(2, 900))
        assert told == [(0, False), expected]

    @pytest.mark.requirement("J2A-BOOT-005")
    def test_one_call_at_a_time_waits_where_the_boot_sif_comes_with_the_properties(self):
        async def main():
            with Rebooting(old_firmware()) as board:
                async with j2a.AsyncClient(board.near, timeout=1.0, window=4) as client:
                    await client.refresh()
                    assert client._session.rxbuf > 0
                    write = board._write

                    def write_with_boot_sif(*frames):
                        is_last = b"j2a.spec" in frames[0].payload
                        boot = oracle.Frame(SOS, 0, BOOT, boot_payload(board.device))
                        write(*frames, *[boot] * is_last)
                        board.is_mute |= is_last

                    board._write = write_with_boot_sif
                    with contextlib.suppress(j2a.DeviceRestarted):  # what it asks then is refused
                        await client.refresh()
                    asked = len(board.requests)
                    calls = [client.call(9, timeout=0.1) for _ in range(3)]
                    await asyncio.gather(*calls, return_exceptions=True)
                    return [frame.opcode for frame, _ in board.requests[asked:]]

        assert in_loop(main()).count(9) <= 1

    def test_a_device_that_does_not_answer_after_its_restart(self):
        with connected(old_firmware(), timeout=2.0) as (board, client):
            client.on_restart(lambda _restart: None)
            board.reset()
            board.is_mute = True
            while client.counters.restarts == 0:
                pass
            with pytest.raises(j2a.CallTimeout) as caught:
                client.call("raw", b"", timeout=0.05)
            assert caught.value.outcome is Outcome.NOT_SENT
            board.is_mute = False
            # It may have to wait until the question for the map is given up.
            assert client.call("raw", b"x", timeout=PATIENCE_S).payload == b"x"

    def test_another_restart_while_the_map_is_fetched(self):
        with connected(old_firmware()) as (board, client):
            restart(board, client)
            client.functions.read()
            board.is_mute = True
            asked = len(board.requests)
            board.sif(BOOT, boot_payload(board.device))
            call = Background(client.call, "raw", b"")
            board.wait_for_request(asked + 1)
            while client._session.waiting < 1:
                pass
            board.reset(new_firmware())
            with contextlib.suppress(j2a.DeviceRestarted):
                call.result()
            while client.counters.restarts < 3:
                pass
            assert client.call("raw", b"").payload == b"!"

    @pytest.mark.parametrize("answered", range(2))  # the properties, and then the interface
    def test_another_restart_while_the_interface_is_read(self, answered, monkeypatch):
        """It is no fault of the interface, which would leave the functions without types."""
        monkeypatch.setattr("j2a.protocol.interface._kept", OrderedDict())
        firmware, device = old_firmware(), DeviceInfo()
        device.take_map(j2a.Reply(*firmware._execute(0, b"")))
        learning = device.learn_interface()
        requests = next(learning)
        for _ in range(answered):
            requests = learning.send(
                [j2a.Reply(*firmware._execute(device.many_opcode, one.payload)) for one in requests]
            )
        with pytest.raises(j2a.DeviceRestarted):
            learning.throw(j2a.DeviceRestarted("the device has restarted"))
        assert not device.asked_for_interface
        assert device.interface_problem == ""

    @pytest.mark.parametrize("what", ["interface", "transducers"])
    @pytest.mark.parametrize("answered", range(2))  # the properties, and then what is learnt
    def test_another_thread_takes_a_new_map_meanwhile(self, what, answered, monkeypatch):
        """What is learnt then belongs to the new map, and not to that of before."""
        monkeypatch.setattr("j2a.protocol.interface._kept", OrderedDict())
        old = old_firmware(transducers=read_transds("SENSOR(a, 1, a, M, 1, u8, none)\n"))
        new = new_firmware(transducers=read_transds("SENSOR(b, 1, b, M, 1, u8, none)\n"))
        device, asks = DeviceInfo(), 0
        device.take_map(j2a.Reply(*old._execute(0, b"")))
        learning = getattr(device, f"learn_{what}")()
        with contextlib.suppress(StopIteration):
            requests = next(learning)
            while True:
                board = old if asks <= answered else new
                if asks == answered:
                    device.take_map(j2a.Reply(*new._execute(0, b"")))
                asks += 1
                requests = learning.send(
                    [j2a.Reply(*board._execute(one.opcode or 1, one.payload)) for one in requests]
                )
        assert (device.interface_problem, device.transducers_problem) == ("", "")
        if what == "interface":
            assert device.functions == new.functions
            assert device.interface_hash == new._table.interface_hash
        else:
            assert [one.name for one in device.descriptors.transducers] == ["b"]

    def test_what_was_learnt_in_part_is_not_compared_with(self):
        new = old_firmware()
        new.describe_sif("more", 8, "(level u8)")
        execute = new._execute
        with connected(old_firmware()) as (board, client):
            restarts = []
            client.on_restart(restarts.append)

            def map_only(opcode, payload):
                board.is_mute = True  # behind the map
                return execute(opcode, payload)

            new._execute = map_only
            asked = len(board.requests)
            board.reset(new)
            board.wait_for_request(asked + 2)
            new._execute = execute
            for number in (2, 3):
                board.reset()
                while len(restarts) < number:
                    pass
            assert client.functions.add(40, 2) == 42
        assert [restart.is_changed for restart in restarts] == [True, True, False]

    def test_a_new_firmware_that_does_not_say_such_things(self):
        """It may use the opcode as it likes, and the old one may come back."""
        with connected(old_firmware()) as (board, client):
            silent = new_firmware(boot=False)
            restart(board, client, silent, payload=b"")
            assert client.functions.read() == 9
            board.sif(BOOT, bytes(7))
            board.sif(BOOT, b"")
            assert client.functions.read() == 9
            assert client.counters.restarts == 1


class TestGeneratedModules:
    HASH = old_firmware()._table.interface_hash

    def test_are_refused_until_their_firmware_is_back(self):
        with connected(old_firmware()) as (board, client):
            client.use_types(self.HASH, {"Mode": Mode})
            assert client.functions.mode(Mode.on) is Mode.on
            new = new_firmware()
            restart(board, client, new)
            for _ in range(2):
                with pytest.raises(j2a.InterfaceChanged, match=self.HASH):
                    client.functions.read()
            with pytest.raises(j2a.InterfaceChanged, match=self.HASH):
                client.functions.mode(1)
            assert new.calls == []
            assert client.call("read").ok
            restart(board, client, old_firmware())
            assert client.functions.mode(Mode.on) is Mode.on
            assert client.functions.read() == 7


class TestHandlers:
    def told(self, client):
        restarts, came = [], threading.Event()

        @client.on_restart()
        def told(restart):
            restarts.append(restart)
            came.set()

        return restarts, came

    @pytest.mark.parametrize("is_new", [False, True])
    def test_are_told_when_the_functions_are_known(self, is_new):
        with connected(old_firmware()) as (board, client):
            restarts, came = self.told(client)
            seen = []
            client.on_restart(lambda _restart: seen.append(client.functions.read()))
            firmware = new_firmware() if is_new else old_firmware()
            board.reset(firmware)
            assert came.wait(PATIENCE_S)
            expected = Restart(ResetCause.WATCHDOG, 2, firmware._table.interface_hash, is_new)
            assert restarts == [expected]
        assert seen == [9 if is_new else 7]

    def test_sif_handlers_stay_by_name(self):
        with connected(old_firmware()) as (board, client):
            values, raw = [], []
            client.on_sif("beat", lambda sif: values.append(sif.values))
            client.on_sif(7, raw.append)
            client.on_sif(BOOT, raw.append)
            board.sif(7, b"\x05")
            board.reset(new_firmware())
            board.sif(9, b"\x01\x00\x06")
            board.sif(7, b"\x08")
        assert [tuple(one) for one in values] == [(5,), (1, 6)]
        assert [sif.opcode for sif in raw] == [7, BOOT, 7]

    @pytest.mark.parametrize("came_before", range(2))
    def test_a_sif_is_decoded_by_what_it_was_found_by(self, came_before):
        """Another thread may take a new map in between."""
        sif = j2a.Sif(7, b"\x05", 0, 0)
        with linked(old_firmware()) as client:
            beats = NamedSif(client._device, "beat")
            for _ in range(came_before):
                assert beats.finds(sif.opcode, 0)
                beats.decode(sif)
            assert beats.finds(sif.opcode, 0)
            client._device.take_map(j2a.Reply(*new_firmware()._execute(0, b"")))
            assert tuple(beats.decode(sif).values) == (5,)
            assert not beats.finds(sif.opcode, 0)

    @contextlib.contextmanager
    def renamed(self):
        """A board that begins anew with another SIF `beat` of the same opcode and length.

        A handler of SIF 99 waits for the event and then has all learnt anew.
        """
        old, new = (j2a.Device(boot=True) for _ in range(2))
        old.describe_sif("beat", 7, "(count u32)")
        new.describe_sif("beat", 7, "(level f32)")
        values, may_go = [], threading.Event()
        with connected(old, timeout=0.2) as (board, client):

            def learn_anew(_sif):
                may_go.wait(PATIENCE_S)
                with contextlib.suppress(j2a.CallTimeout):
                    client.functions  # noqa: B018

            client.on_sif(99, learn_anew)
            client.on_sif("beat", lambda sif: values.append(tuple(sif.values)))
            yield board, client, new, values, may_go

    @pytest.mark.requirement("J2A-BOOT-005")
    def test_a_sif_that_waited_is_decoded_by_what_the_device_said_before(self):
        with self.renamed() as (board, client, new, values, may_go):
            board.sif(99)
            board.sif(7, struct.pack("<I", 1000))
            restart(board, client, new)
            board.sif(7, struct.pack("<f", 1.5))
            may_go.set()
        assert values == [(1000,), (1.5,)]

    @pytest.mark.requirement("J2A-BOOT-005")
    def test_a_sif_behind_a_boot_sif_is_not_decoded_by_what_the_device_said_before(self):
        with self.renamed() as (board, client, new, values, may_go):
            may_go.set()
            seen = client.sifs(99)
            with board._lock:
                board.device, board.is_mute, board._sif_seq = new, True, 0
                board._sif(BOOT, boot_payload(new))
            board.sif(7, struct.pack("<f", 1.5))
            board.sif(99)
            seen.wait(PATIENCE_S)
            board.is_mute = False
            assert client.functions
            board.sif(7, struct.pack("<f", 2.5))
        assert values == [(2.5,)]

    def test_one_that_raises_is_counted_and_told(self):
        errors = []
        options = {"on_handler_error": lambda error, event: errors.append((error, event))}
        with connected(old_firmware(), **options) as (board, client):
            client.on_restart(lambda _restart: 1 / 0)
            _, came = self.told(client)
            board.reset()
            assert came.wait(PATIENCE_S)
        [(error, event)] = errors
        assert isinstance(error, ZeroDivisionError)
        assert isinstance(event, Restart)
        assert client.counters.handler_errors == 1

    def test_can_be_cancelled(self):
        with connected(old_firmware()) as (board, client):
            seen = []
            client.on_restart(seen.append).cancel()
            _, came = self.told(client)
            board.reset()
            assert came.wait(PATIENCE_S)
        assert seen == []

    def test_are_told_of_many_restarts_at_once(self):
        with connected(old_firmware()) as (board, client):
            gate, begun = threading.Event(), threading.Event()

            @client.on_sif(7)
            def hold(_sif):
                begun.set()
                gate.wait(PATIENCE_S)

            restarts, _ = self.told(client)
            board.sif(7, b"\0")
            assert begun.wait(PATIENCE_S)
            for count in range(1, 101):
                board.reset(payload=boot_payload(board.device, 1, count))
            while client.counters.restarts < 100:
                pass
            assert client._engine._sifs.qsize() <= 102
            gate.set()
        assert [restart.count for restart in restarts] == [100]

    def test_are_told_where_nothing_could_be_learnt(self, caplog):
        with connected(old_firmware()) as (board, client):
            restarts, came = self.told(client)
            client._timeout = 0.01
            board.reset()
            board.is_mute = True
            assert came.wait(PATIENCE_S)
            assert [(one.is_changed, one.interface_hash) for one in restarts] == [(True, "")]
            assert "its functions are not known" in caplog.text

    def test_a_device_that_does_nothing_else_does_not_fill_the_log(self, caplog):
        with connected(old_firmware()) as (_, client):
            for _ in range(100):
                client._failed_relearning(Restart(), j2a.CallTimeout("no answer"))
            assert caplog.text.count("its functions are not known") == 7

    def test_must_be_callable(self):
        with connected(old_firmware()) as (_, client), pytest.raises(j2a.LocalError):
            client.on_restart(5)

    def test_a_client_that_nobody_uses_ends(self):
        with Rebooting(old_firmware()) as board:
            board.reset()
            client = j2a.Client(board.near, timeout=PATIENCE_S)
            client.refresh()
            client.on_restart(lambda _restart: None)
            gone = weakref.ref(client)
            with pytest.warns(ResourceWarning):
                del client
                gc.collect()
            assert gone() is None


class TestClues:
    """Of devices without the capability."""

    def silent(self, make, **options):
        return make(boot=False, **options)

    def test_a_counter_that_begins_anew_leads_to_a_new_map(self):
        with connected(self.silent(old_firmware), says=False) as (board, client):
            restarts = []
            client.on_restart(restarts.append)
            add = client.functions.add
            board.skip_sifs(9)
            board.sif(7, b"\0")
            new = self.silent(new_firmware)
            board.reset(new, says=False)
            board.sif(9, bytes(3))
            while client.counters.sifs < 2:
                pass
            with pytest.raises((j2a.DeviceRestarted, j2a.InterfaceChanged)) as caught:
                add(40, 2)
            assert caught.value.outcome is Outcome.NOT_SENT
            assert new.calls == []
            assert client.functions.read() == 9
        expected = Restart(ResetCause.UNKNOWN, 0, new._table.interface_hash, True)
        assert restarts == [expected]
        assert client.counters.restarts == 1

    def test_lost_sifs_cost_nothing_but_a_look(self):
        with connected(self.silent(old_firmware), says=False) as (board, client):
            restarts = []
            client.on_restart(restarts.append)
            board.skip_sifs(250)
            board.sif(7, b"\0")
            board.skip_sifs(20)
            board.sif(7, b"\0")
            while client.counters.sifs < 2:
                pass
            assert client.functions.add(40, 2) == 42
            asked = len(board.requests)
            assert client.functions.add(40, 2) == 42
            assert len(board.requests) == asked + 1
        assert restarts == []
        assert client.counters.restarts == 0

    def test_a_transfer_begun_before_does_not_go_on(self):
        with connected(self.silent(old_firmware), says=False) as (board, client):
            new = self.silent(new_firmware)

            def swap(done, _total):
                if client.counters.sifs == 0:
                    board.skip_sifs(5)
                    board.sif(7, b"\0")
                    board.reset(new, says=False)
                    board.sif(9, bytes(3))
                    while client.counters.sifs < 2:
                        pass
                    Background(lambda: client.properties).result()

            with pytest.raises(j2a.DeviceRestarted):
                client.read_many("log", progress=swap)

    def test_a_device_without_an_interface(self):
        old = j2a.Device(interface=False)
        old.function("first")(lambda payload: b"old")
        new = j2a.Device(interface=False)
        new.function("zero")(lambda payload: b"zero")
        new.function("first")(lambda payload: b"new")
        with connected(old, says=False) as (board, client):
            assert client.call("first").payload == b"old"
            board.skip_sifs(5)
            board.sif(7)
            board.reset(new, says=False)
            board.sif(7)
            while client.counters.sifs < 2:
                pass
            with pytest.raises(j2a.DeviceRestarted):
                client.call("first")
            assert client.call("first").payload == b"new"

    def test_its_sifs_of_that_opcode_say_nothing(self):
        with connected(self.silent(old_firmware), says=False) as (board, client):
            asked = len(board.requests)
            for _ in range(5):
                board.sif(BOOT, bytes(7))
            while client.counters.sifs < 5:
                pass
            assert client.functions.read() == 7
            assert len(board.requests) == asked + 1
            assert client.counters.restarts == 0


class TestAsyncio:
    def test_calls_and_handlers(self):
        async def main():
            async with aconnected(old_firmware()) as (board, client):
                told: asyncio.Queue = asyncio.Queue()
                values = []
                client.on_restart(told.put)
                client.on_sif("beat", lambda sif: values.append(tuple(sif.values)))
                add, read = client.functions.add, client.functions.read
                board.is_mute = True
                asked = len(board.requests)
                calls = [asyncio.create_task(f) for f in (read(), client.call("raw"))]
                await asyncio.to_thread(board.wait_for_request, asked + 1)
                new = new_firmware()
                board.reset(new)
                board.sif(9, b"\x01\x00\x06")
                found = await asyncio.gather(*calls, return_exceptions=True)
                assert all(isinstance(one, j2a.DeviceRestarted) for one in found)
                restart = await told.get()
                assert restart == Restart(ResetCause.WATCHDOG, 2, new._table.interface_hash, True)
                with pytest.raises(j2a.InterfaceChanged):
                    await add(1, 2)
                assert await read() == 9
                assert await client.functions.add(1, 2) == 3
                assert (await client.call("raw", b"a")).payload == b"a!"
                assert await client.read_many("log") == b"new" * 200
                assert new.calls == ["read", "add"]
            assert values == [(1, 6)]

        in_loop(main())

    def test_a_handler_that_raises_is_counted(self, caplog):
        async def main():
            async with aconnected(old_firmware()) as (board, client):
                came = asyncio.Event()

                async def fail(_restart):
                    raise ValueError("no")

                client.on_restart(fail)
                client.on_restart(lambda _restart: came.set())
                board.reset()
                await came.wait()
            return client.counters.handler_errors

        with caplog.at_level(logging.ERROR):
            assert in_loop(main()) == 1
        assert "a handler of restarts failed" in caplog.text

    def test_a_device_that_says_nothing(self):
        async def main():
            async with aconnected(old_firmware(boot=False)) as (board, client):
                told: asyncio.Queue = asyncio.Queue()
                client.on_restart(told.put)
                board.skip_sifs(3)
                board.sif(7, b"\0")
                board.reset(new_firmware(boot=False), says=False)
                board.sif(9, bytes(3))
                while client.counters.sifs < 4:
                    if client.counters.sifs == 3:
                        break
                    await asyncio.sleep(0)
                with pytest.raises(j2a.DeviceRestarted):
                    await client.call("raw", b"")
                assert (await client.call("raw", b"")).payload == b"!"
                assert (await told.get()).is_changed

        in_loop(main())


class TestDevice:
    @pytest.mark.requirement("J2A-BOOT-001", "J2A-BOOT-002", "J2A-BOOT-003")
    def test_says_so_to_each_host_first(self):
        device = old_firmware()
        device.send("beat", 1)
        for _ in range(3):
            near, far = j2a_transports.pair()
            thread = threading.Thread(target=device.serve, args=(far,))
            thread.start()
            data = b""
            while not oracle.decode(data):
                data += near.read(PATIENCE_S)
            [frame] = oracle.decode(data)
            assert frame == oracle.Frame(SOS, 0, BOOT, boot_payload(device, 0, 0))
            near.write(oracle.encode(oracle.Frame(SOF, 1, 0, b"")))
            reply = near.read(PATIENCE_S)
            assert oracle.decode(reply)[0].start == SOF
            near.close()
            thread.join(PATIENCE_S)

    def test_announces_it(self):
        with linked(old_firmware()) as client:
            assert client.capabilities == {"boot", "interface"}
            assert client.functions.read() == 7
        more = j2a.Device({"j2a.caps": "acme.turbo"}, boot=True)
        with linked(more) as client:
            assert client.properties["j2a.caps"] == "interface boot acme.turbo"
        with linked(j2a.Device()) as client:
            assert client.capabilities == {"interface"}

    def test_keeps_the_opcode_for_it(self):
        device = old_firmware()
        with pytest.raises(j2a.LocalError, match="0xFF"):
            device.send_sif(BOOT)
        with pytest.raises(j2a.RegistrationError, match="0xFF"):
            device.describe_sif("mine", BOOT)
        assert device.send_sif(0xFE) == 0
        other = j2a.Device()
        other.describe_sif("mine", BOOT)
        assert other.send_sif(BOOT) == 0

    def test_needs_an_interface(self):
        with pytest.raises(j2a.LocalError, match="interface"):
            j2a.Device(interface=False, boot=True)

    def test_no_call_is_ended_by_the_first_frame(self):
        """It may come while the host asks already."""
        for _ in range(20):
            with linked(old_firmware()) as client:
                assert client.functions.add(40, 2) == 42
                assert client.counters.restarts == 0
                assert GET_MAPPING in client.functions


class TestTransducers:
    """The number of a transducer is another one's in other firmware."""

    OLD = "ACTUATOR(servo, 2, servo, S, 1, u8, 0)\nACTUATOR(heater, 5, heater, H, 1, u8, 0)\n"
    NEW = "ACTUATOR(heater, 2, heater, H, 1, u8, 0)\nACTUATOR(servo, 5, servo, S, 1, u8, 0)\n"

    def board(self, text):
        device = j2a.Device(boot=True, transducers=read_transds(text))
        device.was_set = []
        for name in ("servo", "heater"):
            device.actuator(name)(lambda _, value, name=name: device.was_set.append((name, value)))
        return device

    def test_one_is_set_by_the_number_that_it_has_now(self):
        new, is_held, may_go = self.board(self.NEW), threading.Event(), threading.Event()

        def hold(_sif):
            is_held.set()
            may_go.wait(PATIENCE_S)

        with (
            Rebooting(self.board(self.OLD)) as board,
            j2a.Client(board.near, timeout=PATIENCE_S) as client,
        ):
            servo = client.transducers["servo"]
            client.on_sif(99, hold)
            board.sif(99)
            assert is_held.wait(PATIENCE_S)
            board.reset(new)  # of which nothing is learnt, as a handler of SIFs does not end
            while not client._is_stale:
                time.sleep(0.001)
            servo.set(7)
            may_go.set()
        assert new.was_set == [("servo", 7)]

    def test_one_is_set_by_the_number_that_it_has_now_in_an_event_loop(self):
        new = self.board(self.NEW)

        async def main():
            with Rebooting(self.board(self.OLD)) as board:
                async with j2a.AsyncClient(board.near, timeout=PATIENCE_S) as client:
                    servo, is_held = (await client.transducers())["servo"], asyncio.Event()
                    may_go = asyncio.Event()

                    async def hold(_sif):
                        is_held.set()
                        await may_go.wait()

                    client.on_sif(99, hold)
                    board.sif(99)
                    await is_held.wait()
                    board.reset(new)
                    while not client._is_stale:
                        await asyncio.sleep(0.001)
                    await servo.set(7)
                    may_go.set()

        asyncio.run(main())
        assert new.was_set == [("servo", 7)]

    @contextlib.contextmanager
    def logging_board(self):
        """A board with a queue; a client of it, and the losses and resets that its samples tell."""
        device = j2a.Device(
            boot=True, transducers=parse_descriptors("\nsensor log 9 1 u8\n queue 9\n")
        )
        told = []
        with connected(device) as (board, client):
            client.transducers["log"].on_sample(lambda one: told.append((one.lost, one.is_reset)))
            yield board, client, told

    @pytest.mark.requirement("J2A-TRANS-026", "J2A-TRANS-027")
    def test_a_handler_that_has_all_learnt_anew_does_not_have_losses_told_twice(self):
        with self.logging_board() as (board, client, told):

            def call(_sif):
                while client.counters.sifs < 5:
                    time.sleep(0.001)
                assert client.echo(b"x") == b"x"

            client.on_sif(99, call)
            board.sif(9, queued(0, 1000))
            board.sif(99)
            board.sif(9, queued(5, 2000))
            board.skip_sifs(-3)  # so many are lost that the counter seems to go back
            board.sif(9, queued(5, 1500))
        assert told == [(0, False), (5, False), (0, True)]

    @pytest.mark.requirement("J2A-TRANS-026")
    def test_nothing_is_lost_behind_a_boot_sif_that_comes_with_the_first_sample(self):
        with self.logging_board() as (board, client, told):
            client.refresh()  # what the descriptors mean is found out by the next SIF
            frames = [(1, 9, queued(5, 1000)), (0, BOOT, boot_payload(board.device))]
            board.far.write(b"".join(oracle.encode(oracle.Frame(SOS, *one)) for one in frames))
            while not client.counters.restarts:
                time.sleep(0.001)
            board.sif(9, queued(9, 5000))
        assert told == [(0, False), (0, False)]

    @pytest.mark.requirement("J2A-TRANS-027")
    @pytest.mark.parametrize("then", [(5, 99), (0, BOOT)])
    def test_samples_come_where_a_restart_was_possible_before_they_were_known(self, then):
        """Nobody waits for samples of a device of which it is not known that it has some."""
        temp = j2a.Device(boot=True, transducers=parse_descriptors("\nsensor temp 9 1 u8\n"))
        execute, frames = temp._execute, [(7, 98), then]

        async def main():
            with Rebooting(temp) as board:

                def answer(opcode, payload):
                    while opcode and frames:  # the first request behind the function map
                        board._sif_seq, opcode_of_sif = frames.pop(0)
                        board._sif(opcode_of_sif, b"")
                    return execute(opcode, payload)

                temp._execute = answer
                async with j2a.AsyncClient(board.near, timeout=PATIENCE_S) as client:
                    await client.refresh()
                    samples = client.transducers["temp"].samples()
                    for number in range(2, 50):
                        board.sif(9, struct.pack("<QB", number, number))
                        with contextlib.suppress(j2a.CallTimeout):
                            return (await samples.wait(0.1)).values
                return None

        assert in_loop(main()) is not None

    @pytest.mark.requirement("J2A-CLOCK-026")
    @pytest.mark.parametrize("clock", [None, 10.0])
    def test_a_sample_that_waited_is_not_given_the_time_of_a_clock_that_began_since(self, clock):
        temp, host_us = parse_descriptors("\nsensor temp 9 1 u8\n"), []
        options, may_go = {"boot": True, "clock": clock, "transducers": temp}, threading.Event()
        with connected(j2a.Device(**options)) as (board, client):
            client.on_sif(99, lambda _sif: may_go.wait(PATIENCE_S))
            client.transducers["temp"].on_sample(lambda sample: host_us.append(sample.host_us))
            client.clock.measure(2)
            board.sif(9, struct.pack("<QB", 1, 1))
            while not host_us:
                time.sleep(0.001)
            board.sif(99)
            board.sif(9, struct.pack("<QB", 1, 2))
            restart(board, client, j2a.Device(**options))
            client.clock.measure(2)
            may_go.set()
            while len(host_us) < 2:
                time.sleep(0.001)
            board.sif(9, struct.pack("<QB", 1, 3))
        assert [one is not None for one in host_us] == [True, False, True]

    @pytest.mark.parametrize("clock", [None, 10.0])
    def test_what_is_known_of_the_clock_ends_with_a_restart(self, clock):
        """An order for a time, or the host time of a sample, would be by a clock that is gone."""
        board = self.board(self.OLD) if clock is None else j2a.Device(boot=True, clock=clock)
        with Rebooting(board) as link, j2a.Client(link.near, timeout=PATIENCE_S) as client:
            client.clock.measure()
            assert client.clock._is_fresh
            assert client.clock.host_time_of_sample(1) is not None
            link.reset()
            while not client.counters.restarts:
                time.sleep(0.001)
            assert not client.clock._is_fresh
            assert client.clock.host_time_of_sample(1) is None
            client.clock.measure()
            assert client.clock._is_fresh


class TestClosedWhileTheDeviceIsAsked:
    """A board that restarts and says no more: `close` has ended before it is known what it has."""

    def test_no_handler_is_called_any_more(self, monkeypatch):
        monkeypatch.setattr("j2a.io.blocking.JOIN_S", 0.05)
        seen = []
        with connected(old_firmware()) as (board, client):
            client.on_restart(seen.append)
            board.is_mute = True
            board.sif(BOOT, boot_payload(new_firmware()))
            while not client.counters.restarts:
                pass
            dispatcher = client._engine.dispatcher
            client.close()
            dispatcher.join(PATIENCE_S)
            assert not dispatcher.is_alive()
        assert seen == []

    def test_nor_by_the_asyncio_client(self, monkeypatch):
        monkeypatch.setattr("j2a.io.loop.JOIN_S", 0.05)
        seen = []

        async def main():
            async with aconnected(old_firmware()) as (board, client):
                client.on_restart(seen.append)
                board.is_mute = True
                board.sif(BOOT, boot_payload(new_firmware()))
                while not client.counters.restarts:
                    await asyncio.sleep(0)
                await client.close()
                await asyncio.wait([client._engine.dispatcher], timeout=PATIENCE_S)

        in_loop(main())
        assert seen == []
