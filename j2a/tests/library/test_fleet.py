"""A fleet: boards that come, go, fall silent and share names, and the samples of all of them."""

import contextlib
import queue
import sys
import threading
from collections import deque
from itertools import count
from types import SimpleNamespace

import j2a_transports
import pytest

import j2a
from j2a.fleet import by_url
from j2a.io.fleet_base import FleetTransducers
from j2a.protocol.roster import Heartbeat, Member, Roster
from j2a.types.transds_file import read_transds

from .support import PATIENCE_S, served

FILE = """
SENSOR(quad, 0, quad, X, 2, i16, none, (unit, deg))
SENSOR(level, 1, level, X, 1, u8, none)
ACTUATOR(lamp, 2, lamp, X, 1, bool, none)
"""
SOON_S = 0.01

_names = count()


def make_url():
    return f"loopback:fleet-{next(_names)}"


def make_device(serial=None):
    properties = {} if serial is None else {"serial": serial}
    return j2a.Device(properties, transducers=read_transds(FILE))


@contextlib.contextmanager
def fleet_of(*urls, **options):
    options.setdefault("timeout", PATIENCE_S)
    options.setdefault("boot_time", PATIENCE_S)
    options.setdefault("retry", SOON_S)
    options.setdefault("heartbeat", None)
    with j2a.Fleet(*urls, **options) as fleet:
        yield fleet


def changes_of(fleet):
    """Return a queue of what changes from now on."""
    changes = queue.SimpleQueue()
    fleet.on_change(changes.put)
    return changes


@contextlib.contextmanager
def silent(url):
    """A board at the URL that takes every host and says nothing."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(j2a_transports.listen(url))
        stop = threading.Event()

        def take():
            while not stop.is_set():
                with contextlib.suppress(j2a_transports.TransportError):
                    if (link := listener.accept(SOON_S)) is not None:
                        stack.callback(link.close)

        thread = threading.Thread(target=take)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


class TestBoards:
    def test_each_is_known_by_its_serial_number(self):
        with (
            served(make_device("B7")) as first,
            served(make_device("A3")) as second,
            served(make_device()) as nameless,
            fleet_of(first, second, nameless) as fleet,
        ):
            fleet.wait(3, timeout=PATIENCE_S)
            assert set(fleet) == {"A3", "B7", nameless}
            assert (len(fleet), "A3" in fleet, "C9" in fleet) == (3, True, False)
            assert (fleet["B7"].url, fleet["A3"].url) == (first, second)
            assert fleet["B7"].echo(b"hi") == b"hi"
            assert fleet.problems == {}
            assert repr(fleet) == "<j2a.Fleet 3 of 3 boards are here>"

    def test_a_transducer_of_each(self):
        with (
            served(make_device("left")) as left,
            served(make_device("right")) as right,
            fleet_of(left, right) as fleet,
        ):
            fleet.wait("left", "right", timeout=PATIENCE_S)
            found = fleet.transducers
            names = ("quad", "level", "lamp")
            assert set(found) == {(side, name) for side in ("left", "right") for name in names}
            found["left", "quad"].period = 0.5
            assert fleet["left"].transducers["quad"].period == 0.5
            assert fleet["right"].transducers["quad"].period == 0.0

    @pytest.mark.parametrize(
        "error",
        [
            j2a.CallTimeout("no reply"),
            j2a.DeviceRestarted("no reply"),
            j2a.LinkLost("no reply"),
            j2a.ProtocolError("no reply"),
            j2a.errors.ChecksumRefused("no reply", 0xF3, b""),
        ],
        ids=lambda error: type(error).__name__,
    )
    def test_transducers_of_the_others_where_one_does_not_tell(self, error, monkeypatch):
        with (
            served(make_device("left")) as left,
            served(make_device("right")) as right,
            fleet_of(left, right) as fleet,
        ):
            fleet.wait("left", "right", timeout=PATIENCE_S)

            def load(client, **_options):
                if client.url == right:
                    raise error

            monkeypatch.setattr(j2a.Client, "_load", load)
            found = fleet.transducers
            assert {board for board, _ in found} == {"left"}
            with pytest.raises(j2a.UnknownTransducer, match="what right has is not known: no rep"):
                found["right", "quad"]
            with pytest.raises(j2a.UnknownTransducer, match=r"did you mean \["):
                found["left", "qaud"]

    def test_one_that_comes_later_and_goes_and_comes_again(self):
        url = make_url()
        with fleet_of() as fleet:
            changes = changes_of(fleet)
            fleet.add(url)
            gone = changes.get(timeout=PATIENCE_S)
            assert (gone.board, gone.url, gone.is_here) == (None, url, False)
            assert isinstance(gone.reason, j2a.LinkError)
            assert isinstance(fleet.problems[url], j2a.LinkError)
            for _ in range(2):
                with served(make_device("A3"), url):
                    here = changes.get(timeout=PATIENCE_S)
                    assert (here.board, here.url, here.is_here) == ("A3", url, True)
                    assert here.reason is None
                    assert fleet["A3"].is_open
                    assert fleet.problems == {}
                left = changes.get(timeout=PATIENCE_S)
                assert (left.board, left.is_here) == ("A3", False)
                assert isinstance(left.reason, j2a.LinkLost)
                assert len(fleet) == 0
                # What it is tried for again in vain is told once.
                vain = changes.get(timeout=PATIENCE_S)
                assert (vain.board, vain.is_here) == (None, False)

    def test_a_silent_one_delays_none(self):
        url = make_url()
        with (
            silent(url),
            served(make_device("A3")) as other,
            fleet_of(url, other, boot_time=0.5) as fleet,
        ):
            changes = changes_of(fleet)
            fleet.wait("A3", timeout=PATIENCE_S)
            while url not in fleet.problems:
                changes.get(timeout=PATIENCE_S)
            assert isinstance(fleet.problems[url], j2a.CallTimeout)
            assert "A3" in fleet

    def test_one_that_falls_silent_is_gone_and_tried_again(self):
        device, url = make_device("A3"), make_url()
        mute = threading.Event()
        echo = device._execute

        def execute(opcode, payload):
            if mute.is_set():
                mute_over.wait(PATIENCE_S)
            return echo(opcode, payload)

        mute_over = threading.Event()
        device._execute = execute
        with fleet_of(timeout=0.2, heartbeat=0.05) as fleet:
            changes = changes_of(fleet)
            with served(device, url):
                fleet.add(url)
                assert changes.get(timeout=PATIENCE_S).is_here
                mute.set()
                gone = changes.get(timeout=PATIENCE_S)
                assert (gone.board, gone.is_here) == ("A3", False)
                assert isinstance(gone.reason, j2a.CallTimeout)
                mute.clear()
                mute_over.set()
                assert changes.get(timeout=PATIENCE_S).is_here

    def test_one_whose_link_is_stalled_is_gone_and_tried_again(self):
        device, url = make_device("A3"), make_url()
        is_mute, is_over = threading.Event(), threading.Event()
        answer = device._execute

        def execute(opcode, payload):
            if is_mute.is_set():
                is_over.wait(PATIENCE_S)
            return answer(opcode, payload)

        device._execute = execute
        with fleet_of(timeout=1.0, heartbeat=0.5) as fleet:
            changes = changes_of(fleet)
            with served(device, url):
                fleet.add(url)
                assert changes.get(timeout=PATIENCE_S).is_here
                board = fleet["A3"]
                is_mute.set()
                with pytest.raises(j2a.LinkError):  # stalled; on a slow machine gone by then
                    while True:
                        with contextlib.suppress(j2a.CallTimeout):
                            board.echo(timeout=0.0005)
                gone = changes.get(timeout=PATIENCE_S)
                assert (gone.board, gone.is_here) == ("A3", False)
                is_mute.clear()
                is_over.set()
                assert changes.get(timeout=PATIENCE_S).is_here

    def test_one_whose_handler_of_changes_exits_is_kept_and_tried_again(self):
        url, errors = make_url(), queue.SimpleQueue()
        with fleet_of(on_handler_error=lambda *what: errors.put(what)) as fleet:
            fleet.on_change(lambda _change: sys.exit(1))
            changes = changes_of(fleet)
            with served(make_device("A3"), url):
                fleet.add(url)
                here = changes.get(timeout=PATIENCE_S)
                assert fleet["A3"].echo(b"hi") == b"hi"
                error, event = errors.get(timeout=PATIENCE_S)
                assert (type(error), event) == (SystemExit, here)
            gone = changes.get(timeout=PATIENCE_S)
            assert (gone.board, gone.is_here, len(fleet)) == ("A3", False, 0)
            assert changes.get(timeout=PATIENCE_S).board is None  # cannot be opened
            with served(make_device("A3"), url):
                assert changes.get(timeout=PATIENCE_S).is_here

    def test_one_that_exits_when_it_is_asked_who_it_is(self):
        answers = iter([SystemExit(1), "A3"])

        def identify(_client):
            answer = next(answers)
            if isinstance(answer, SystemExit):
                raise answer
            return answer

        with served(make_device()) as url, fleet_of(identify=identify) as fleet:
            changes = changes_of(fleet)
            fleet.add(url)
            change = changes.get(timeout=PATIENCE_S)
            assert (change.is_here, str(change.reason)) == (False, "identify failed: SystemExit: 1")
            assert changes.get(timeout=PATIENCE_S).board == "A3"

    def test_one_that_answers_stays(self):
        heard = threading.Event()
        device = make_device("A3")
        echo = device._execute
        asked = count()

        def execute(opcode, payload):
            if opcode == device.functions["a2jEcho"] and next(asked) == 5:
                heard.set()
            return echo(opcode, payload)

        device._execute = execute
        with served(device) as url, fleet_of(heartbeat=SOON_S) as fleet:
            changes = changes_of(fleet)
            fleet.add(url)
            assert heard.wait(PATIENCE_S)
            assert changes.get_nowait().is_here
            assert changes.empty()

    def test_two_with_one_serial_number(self, caplog):
        with (
            served(make_device("A3")) as first,
            served(make_device("A3")) as second,
            fleet_of(first) as fleet,
        ):
            fleet.wait("A3", timeout=PATIENCE_S)
            changes = changes_of(fleet)
            fleet.add(second)
            change = changes.get(timeout=PATIENCE_S)
            twin = f"A3@{second}"
            assert (change.board, change.url, change.is_here) == (twin, second, True)
            assert (fleet["A3"].url, fleet[twin].url) == (first, second)
            assert fleet.problems == {}
            # The names stay, whoever comes again first.
            for board in ("A3", twin):
                fleet.remove(board)
                assert changes.get(timeout=PATIENCE_S).board == board
            for url, board in ((second, twin), (first, "A3")):
                fleet.add(url)
                assert changes.get(timeout=PATIENCE_S).board == board
                assert fleet[board].url == url
            [warning] = [one for one in caplog.messages if "identity" in one]
            assert twin in warning
            assert "identify=j2a.fleet.by_url" in warning

    def test_a_sample_has_the_place_of_a_second_board(self):
        board = make_device("A3")
        with (
            served(make_device("A3")) as first,
            served(board) as second,
            fleet_of(first) as fleet,
        ):
            fleet.wait("A3", timeout=PATIENCE_S)
            samples = queue.SimpleQueue()
            fleet.on_sample(samples.put)
            fleet.add(second)
            fleet.wait(f"A3@{second}", timeout=PATIENCE_S)
            board.send_sif(1, (5).to_bytes(8, "little") + b"\x07")
            assert samples.get(timeout=PATIENCE_S).board == f"A3@{second}"

    def test_a_second_board_on_the_usb_is_known_by_its_ports(self):
        roster = Roster()
        first, second = Member("usb://A3"), Member("usb://1-2.3")
        assert not roster.is_new_twin(first, "A3")
        roster.come(first, object(), "A3")
        assert roster.is_new_twin(second, "A3")
        assert roster.identity(second, "A3") == "A3@1-2.3"
        assert not roster.is_new_twin(second, "A3")
        # Another board at the same ports has its own serial number.
        assert roster.identity(second, "B7") == "B7"

    def test_two_that_no_place_tells_apart(self):
        with served(make_device()) as first, served(make_device()) as second:
            names = {first: "A3", second: "A3", "x": f"A3@{second}"}
            with (
                served(make_device()) as odd,
                fleet_of(odd, identify=lambda client: names.get(client.url, names["x"])) as fleet,
            ):
                fleet.wait(f"A3@{second}", timeout=PATIENCE_S)
                fleet.add(first)
                fleet.wait("A3", timeout=PATIENCE_S)
                changes = changes_of(fleet)
                fleet.add(second)
                left_out = changes.get(timeout=PATIENCE_S)
                assert (left_out.board, left_out.is_here) == (None, False)
                assert odd in str(left_out.reason)
                assert "identify=j2a.fleet.by_url" in str(fleet.problems[second])

    def test_one_that_is_left_out_is_not_tried_without_a_pause(self):
        asked = queue.SimpleQueue()

        def identify(client):
            asked.put(client.url)
            return f"A3@{second}" if client.url == first else "A3"

        with (
            served(make_device()) as first,
            served(make_device()) as other,
            served(make_device()) as second,
            fleet_of(first, identify=identify, retry=PATIENCE_S) as fleet,
        ):
            fleet.wait(f"A3@{second}", timeout=PATIENCE_S)
            fleet.add(other)
            fleet.wait("A3", timeout=PATIENCE_S)
            changes = changes_of(fleet)
            fleet.add(second)
            changes.get(timeout=PATIENCE_S)
            assert [asked.get_nowait() for _ in range(3)] == [first, other, second]
            with pytest.raises(queue.Empty):
                asked.get(timeout=0.3)

    def test_identities_of_ones_own(self):
        with (
            served(make_device("A3")) as first,
            served(make_device("A3")) as second,
            fleet_of(first, second, identify=by_url) as fleet,
        ):
            fleet.wait(first, second, timeout=PATIENCE_S)
        with (
            served(make_device("A3")) as url,
            fleet_of(identify=lambda client: 1 // 0) as fleet,
        ):
            changes = changes_of(fleet)
            fleet.add(url)
            change = changes.get(timeout=PATIENCE_S)
            assert "identify failed: ZeroDivisionError" in str(change.reason)

    def test_one_that_is_taken_out(self):
        with served(make_device("A3")) as url, fleet_of(url) as fleet:
            fleet.wait("A3", timeout=PATIENCE_S)
            client = fleet["A3"]
            changes = changes_of(fleet)
            fleet.remove("A3")
            with pytest.raises(j2a.UnknownBoard, match=r"'A3' is not here \(here: none\)"):
                fleet["A3"]
            change = changes.get(timeout=PATIENCE_S)
            assert change == j2a.BoardChange("A3", url, is_here=False)
            assert not client.is_open
            fleet.add(url)
            fleet.wait("A3", timeout=PATIENCE_S)

    def test_what_can_be_done_in_a_handler(self):
        done = threading.Event()
        with (
            served(make_device("A3")) as first,
            served(make_device("B7")) as second,
            fleet_of() as fleet,
        ):

            def follow(change):
                if change.board == "A3" and change.is_here:
                    assert fleet["A3"].echo(b"x") == b"x"
                    fleet.add(second)
                elif change.board == "B7" and change.is_here:
                    fleet.remove("A3")
                    fleet.close()
                    done.set()

            fleet.on_change(follow)
            fleet.add(first)
            assert done.wait(PATIENCE_S)

    def test_a_handler_of_samples_closes_the_fleet(self, caplog):
        device, ended = make_device("A3"), threading.Event()
        with served(device) as url, fleet_of(url) as fleet:
            fleet.wait("A3", timeout=PATIENCE_S)
            (member,) = fleet._roster.members.values()
            was_alive = []

            def close(_sample):
                fleet.close()
                was_alive.append(member.thread.is_alive())  # it waits for the end of this handler
                ended.set()

            fleet.on_sample(close)
            device.sense("level", 0, 7)
            assert ended.wait(PATIENCE_S)
            member.thread.join(PATIENCE_S)
            assert not member.thread.is_alive()
        assert was_alive == [True]
        assert caplog.records == []


class TestRoster:
    def test_why_a_board_is_not_here_is_told_once_and_anew_with_another_reason(self):
        roster, member = Roster(), Member("x:")
        reasons = ("no such port", "no such port", "access denied", "access denied", "no such port")
        told = [roster.go(member, None, j2a.LinkError(reason)) for reason in reasons]
        assert [change and str(change.reason) for change in told] == [
            "no such port",
            None,
            "access denied",
            None,
            "no such port",
        ]

    def test_only_echoes_in_a_row_that_get_no_answer_end_a_link(self):
        late, refused = j2a.CallTimeout("late"), j2a.FunctionFailed("refused", code=1, payload=b"")
        heartbeat = Heartbeat()
        for error in (late, refused, late, refused, late):
            assert not heartbeat.failed(error, is_open=True)
        assert heartbeat.failed(late, is_open=True)


class TestArguments:
    @pytest.mark.parametrize("url", ["nothing", "no-scheme://x", ""])
    def test_a_wrong_url(self, url):
        with pytest.raises(j2a.BadUrl):
            j2a.Fleet(url)

    @pytest.mark.parametrize(
        "options",
        [{"timeout": -1}, {"boot_time": "x"}, {"retry": float("nan")}, {"heartbeat": -0.1}],
    )
    def test_a_wrong_option(self, options):
        with pytest.raises(j2a.LocalError):
            j2a.Fleet(**options)

    def test_misuse(self):
        url = make_url()
        with fleet_of(url) as fleet:
            with pytest.raises(j2a.LocalError, match="the fleet has loopback"):
                fleet.add(url)
            with pytest.raises(j2a.LocalError, match="a URL is a text"):
                fleet.add(5)
            with pytest.raises(j2a.UnknownBoard, match="no board 'C9'"):
                fleet.remove("C9")
            with pytest.raises(j2a.LocalError, match="identities, or one number"):
                fleet.wait(1, 2)
            with pytest.raises(j2a.LocalError, match="identities, or one number"):
                fleet.wait(None)
            with pytest.raises(j2a.CallTimeout, match=rf"no board C9 within 0.05 s; {url}: "):
                while not fleet.problems:
                    pass
                fleet.wait("C9", timeout=0.05)
            with pytest.raises(j2a.CallTimeout, match="0 of 2 boards"):
                fleet.wait(2, timeout=0.01)
        fleet.close()
        with pytest.raises(j2a.LocalError, match="is closed"):
            fleet.add(make_url())
        with pytest.raises(j2a.LinkClosed):
            fleet.wait(1)

    def test_nothing_is_left_behind(self):
        before = set(threading.enumerate())
        with served(make_device("A3")) as url, fleet_of(url, make_url()) as fleet:
            fleet.wait("A3", timeout=PATIENCE_S)
            client = fleet["A3"]
        for thread in set(threading.enumerate()) - before:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
        assert not client.is_open


class TestSamples:
    def test_boards_are_told_apart(self):
        left, right = make_device("left"), make_device("right")
        with (
            served(left) as first,
            served(right) as second,
            fleet_of(first, second) as fleet,
        ):
            fleet.wait(2, timeout=PATIENCE_S)
            every, quads, calls = fleet.samples(), fleet.samples("quad"), queue.SimpleQueue()
            subscription = fleet.on_sample(calls.put, "level")
            with every, quads:
                left.sense("quad", 1, 7)
                right.sense("quad", 0, 9)
                right.sense("level", 0, 3)
                found = [every.wait(PATIENCE_S) for _ in range(3)]
                assert {(one.board, one.name, one.values) for one in found} == {
                    ("left", "quad", (None, 7)),
                    ("right", "quad", (9, None)),
                    ("right", "level", (3,)),
                }
                both = [quads.wait(PATIENCE_S) for _ in range(2)]
                assert {one.board for one in both} == {"left", "right"}
                level = calls.get(timeout=PATIENCE_S)
                assert (level.board, level.unit) == ("right", "")
                subscription.cancel()
                right.sense("level", 0, 4)
                assert every.wait(PATIENCE_S).values == (4,)
                assert calls.empty()

    def test_samples_go_on_when_the_board_is_back(self):
        url = make_url()
        with fleet_of(url) as fleet, fleet.samples() as samples:
            for value in (1, 2):
                device = make_device("A3")
                with served(device, url):
                    fleet.wait("A3", timeout=PATIENCE_S)
                    device.sense("level", 0, value)
                    sample = samples.wait(PATIENCE_S)
                    assert (sample.board, sample.values, sample.sequence) == ("A3", (value,), 0)
                    changes = changes_of(fleet)
                while "A3" in fleet:
                    changes.get(timeout=PATIENCE_S)
            fleet.close()
            assert list(samples) == []

    def test_those_that_nobody_takes_are_counted(self):
        device = make_device("A3")
        with (
            served(device) as url,
            fleet_of(url) as fleet,
            fleet.samples("level", max_waiting=2) as few,
            fleet.samples("level") as all_of_them,
        ):
            fleet.wait("A3", timeout=PATIENCE_S)
            for value in range(5):
                device.sense("level", 0, value)
                assert all_of_them.wait(PATIENCE_S).values == (value,)
            assert few.lost == 3
            assert [few.wait(PATIENCE_S).values for _ in range(2)] == [(3,), (4,)]

    @pytest.mark.parametrize("raised", [AttributeError, SystemExit])
    def test_a_handler_that_fails_stops_no_other(self, raised):
        device, errors = make_device("A3"), deque()

        def fail(_sample):
            raise raised

        seen = queue.SimpleQueue()
        with (
            served(device) as url,
            fleet_of(url, on_handler_error=lambda *what: errors.append(what)) as fleet,
        ):
            fleet.on_sample(fail)
            fleet.on_sample(seen.put)
            fleet.wait("A3", timeout=PATIENCE_S)
            device.sense("level", 0, 1)
            sample = seen.get(timeout=PATIENCE_S)
            assert [(type(error), one) for error, one in errors] == [(raised, sample)]


class FakeWatch:
    """Boards that come and go as a test says."""

    def __init__(self):
        self.events = queue.SimpleQueue()

    def __iter__(self):
        return iter(self.events.get, None)

    def close(self):
        self.events.put(None)


class TestUsb:
    def test_boards_come_and_go(self, monkeypatch):
        watch = FakeWatch()
        monkeypatch.setattr(j2a_transports, "watch_usb", lambda: watch)
        with served(make_device("A3")) as url, fleet_of(usb=True) as fleet:
            board = SimpleNamespace(url=url)
            watch.events.put(j2a_transports.UsbArrived(board))
            fleet.wait("A3", timeout=PATIENCE_S)
            changes = changes_of(fleet)
            watch.events.put(j2a_transports.UsbArrived(board))  # is in already
            watch.events.put(j2a_transports.UsbLeft(board))
            watch.events.put(j2a_transports.UsbLeft(board))
            assert not changes.get(timeout=PATIENCE_S).is_here
            assert len(fleet) == 0
            watch.events.put(j2a_transports.UsbArrived(board))
            fleet.wait("A3", timeout=PATIENCE_S)

    def test_without_the_usb(self, monkeypatch):
        def missing():
            raise j2a_transports.MissingExtra("USB", "pyusb", "usb")

        monkeypatch.setattr(j2a_transports, "watch_usb", missing)
        with pytest.raises(j2a.OpenFailed, match="pyusb"):
            j2a.Fleet(usb=True)


@pytest.mark.parametrize(
    ("here", "hint"),
    [
        (
            [("right", "x"), ("left", "quad")],
            r'; did you mean \["left", "quad"\] or \["right", "x"\]\?$',
        ),
        ([], "; no board is here$"),
    ],
)
def test_what_is_near_a_transducer_that_no_board_has(here, hint):
    found = FleetTransducers.fromkeys(here)
    with pytest.raises(j2a.UnknownTransducer, match=hint):
        found["left", "qaud"]
