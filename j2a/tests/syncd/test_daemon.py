"""The daemon with boards of the tests: all get the same times, and none disturbs another."""

import contextlib
import importlib.util
import pathlib
import socket
import threading
import time
from types import SimpleNamespace

import j2a_transports
import pytest

import j2a
from j2a.cli._sync import _show as show_status
from j2a.clock import Clock, ClockReading
from j2a.io.host_time import HostTime
from j2a.io.threads import start_thread
from j2a.protocol.clock import LOOK_S
from j2a.syncd import daemon as daemon_module
from j2a.syncd import sync_board, url_boards
from j2a.syncd import usb_bus as bus_module
from j2a.syncd.daemon import Daemon
from j2a.syncd.history import History
from j2a.syncd.usb_bus import Bus
from j2a.tests.library.support import served

_spec = importlib.util.spec_from_file_location(
    "fake_port", pathlib.Path(__file__).with_name("fake_port.py")
)
fake_port = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fake_port)
FakeBus, FakePort = fake_port.FakeBus, fake_port.FakePort


@pytest.fixture
def running(monkeypatch):
    """A function that runs a daemon over ports in a list, which the test may change."""
    monkeypatch.setattr(daemon_module, "_LOOK_S", 0.02)
    started = []

    def run(ports, **options):
        one = Daemon(interval_s=0.05, ports=lambda: list(ports), **options)
        started.append((one, start_thread(one.run, "j2a syncd")))
        return one

    yield run
    for one, thread in started:
        one.stop()
        thread.join(60)
        assert not thread.is_alive()


def until(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def row_of(one, place):
    return next((row for row in one.status()["boards"] if row["place"] == place), {})


def rows_of(one):
    return {row["board"]: row for row in one.status()["boards"]}


@pytest.mark.requirement("SYNC-005")
def test_a_board_gets_the_time_at_which_its_frames_began(running):
    bus = FakeBus(ppm=300)
    port = FakePort(bus)
    running([port])
    port.wait_for(5)
    now = time.time_ns() // 1000
    for time_us, frame, arrived in port.packets:
        assert abs(now - time_us) < 60e6
        # A busy machine may hold the daemon up between its look at the clock and the packet.
        assert (arrived - frame) % 2048 < 1000, "too late for the board"
    # Frames are 1 ms of the bus apart, so what was told of the first tells when the last began.
    (first_us, first, began), (last_us, last, ended) = port.packets[0], port.packets[-1]
    frames = (last - first) % 2048 + 2048 * ((ended - began) // 2048)
    assert last_us - first_us == pytest.approx(frames * 1000, abs=2000)


def test_boards_of_a_bus_are_told_the_same(running):
    bus = FakeBus()
    ports = [FakePort(bus, f"1-{n}", address=n) for n in range(1, 5)]
    running(ports)
    for port in ports:
        port.wait_for(5)
    packets = [packet for port in ports for packet in port.packets]
    # Frames begin at least 1 ms apart, so packets about one frame are equal.
    assert len({packet[:2] for packet in packets}) == len({packet[0] // 900 for packet in packets})


@pytest.mark.requirement("SYNC-005")
def test_a_round_has_one_packet():
    now_us = 5e6
    host = HostTime(lambda: now_us, lambda: round(1.7e15 + now_us))
    one = Bus("usb bus 1", 1.0, History(), host)
    for number in range(bus_module.LEAST):
        assert one.packet()[1] is None
        now_us += 1e6
        one.add(1, now_us, now_us + 100, number * 1000 % 2048, 40)
    number, first = one.packet()
    assert first is not None
    now_us += 0.2e6
    assert one.packet() == (number, first)
    # What is sent is of a frame that began less than 500 ms ago, whoever asks when.
    now_us += 0.15e6
    assert one.packet()[1].frame == (first.frame + 350) % 2048
    now_us += 0.65e6
    later, second = one.packet()
    assert later > number
    assert (second.time_us - first.time_us) // 1000 == (second.frame - first.frame) % 2048


def test_a_board_that_got_one_packet_has_no_uncertainty_yet():
    """It has no rate: with 100 ppm it is half a millisecond off before the next one."""
    now_us = 5e6
    host = HostTime(lambda: now_us, lambda: round(1.7e15 + now_us))
    bus = Bus("usb bus 1", 5.0, History(), host)
    boards = [sync_board.SyncBoard(FakePort(FakeBus()), bus) for _ in range(2)]
    for number in range(bus_module.LEAST):
        now_us += 1e6
        bus.add(1, now_us, now_us + 100, number * 1000 % 2048, 40)
    told = []
    for present in (boards[:1], boards, boards):  # the other one is plugged in later
        bus.packet()
        now_us += 1e6
        for board in present:
            board.tell()
        told.append([board.facts()["uncertainty_us"] is not None for board in boards])
    assert told == [[False, False], [True, False], [True, True]]


@pytest.mark.parametrize("change", ["slewed", "set"])
def test_all_boards_hear_at_once_that_the_clock_was_slewed_or_set(change):
    """Of 500 ppm a second would make 500 us; all are told the same, each once."""
    now_us, unix_us = 5e6, 1.7e15
    host = HostTime(lambda: now_us, lambda: round(unix_us))
    bus = Bus("usb bus 1", 5.0, History(), host)

    def run(seconds, rate=0.0):
        nonlocal now_us, unix_us
        now_us += seconds * 1e6
        unix_us += seconds * 1e6 * (1 + rate)

    for number in range(bus_module.LEAST + 1):
        run(1)
        bus.add(1, now_us, now_us + 100, number * 1000 % 2048, 40)
        told, first = bus.packet()
    assert first is not None
    for _ in range(20):
        run(LOOK_S)
        assert not bus.has_news(told)
    if change == "set":
        unix_us += 3_600_000_000
    looks, rate = 0, 0.0005 if change == "slewed" else 0.0
    while not bus.has_news(told):
        run(LOOK_S, rate)
        looks += 1
        assert looks < 4
    number, packet = bus.packet()
    assert number != told
    # The second board, a little later.
    run(0.01, rate)
    assert bus.has_news(told)
    assert bus.packet() == (number, packet)
    assert not bus.has_news(number)
    passed_ms = (packet.frame - first.frame) % 2048
    set_us = 3_600_000_000 if change == "set" else 0
    slewed_us = packet.time_us - first.time_us - set_us - 1000 * passed_ms
    assert 0 <= slewed_us % 2_048_000 <= 250


def test_a_board_of_2014_gets_the_time_by_the_others_of_its_bus(running):
    bus = FakeBus()
    old, young = FakePort(bus, "1-1"), FakePort(bus, "1-2", address=3)
    old.tells = False
    one = running([old, young])
    old.wait_for(3)
    rows = {row["place"]: row for row in one.status()["boards"]}
    assert rows["usb 1-1"]["tells_frames"] is False
    assert rows["usb 1-2"]["tells_frames"] is True


def test_the_status_tells_of_frames_modulo_1024(running, capsys):
    bus = FakeBus()
    short, whole = FakePort(bus, serial="short"), FakePort(FakeBus(), number=2, serial="whole")
    short.modulo = 1024
    one = running([short, whole])
    until(lambda: rows_of(one).get("short", {}).get("frames_modulo") == 1024)
    until(lambda: rows_of(one)["short"]["state"] == "syncing")
    assert rows_of(one)["whole"]["frames_modulo"] == 2048
    show_status(one.status())
    lines = capsys.readouterr().out.splitlines()
    told = [number for number, line in enumerate(lines) if "frames modulo 1024" in line]
    assert [lines[number - 1].split()[0] for number in told] == ["short"]


def test_a_bus_without_a_board_that_tells_frames_gets_nothing(running):
    old = FakePort(FakeBus())
    old.tells = False
    one = running([old])
    until(lambda: "which frame" in (one.status()["boards"] or [{"problem": ""}])[0]["problem"])
    assert old.packets == []


def test_boards_of_usbip_have_frames_of_their_own(running):
    ports = [FakePort(FakeBus(ppm), f"1-{n}", address=n) for n, ppm in ((1, 300), (2, -200))]
    # The second bus is 700 frames ahead, which no line of both can hide.
    ports[1]._frames._start -= 700_000_000
    for port in ports:
        port.frames = f"usb {port.name}"
    one = running(ports)
    for port in ports:
        port.wait_for(5)
    assert {row["state"] for row in one.status()["boards"]} == {"syncing"}
    assert set(one.answer({"command": "history"}, True)["boards"]) == {"usb 1-1", "usb 1-2"}


def test_a_board_with_frames_of_its_own_gets_no_time_and_disturbs_no_other(running):
    bus = FakeBus()
    ports = [FakePort(bus, f"1-{n}", address=n) for n in range(1, 4)]
    one = running(ports)
    for port in ports:
        port.wait_for(3)
    odd = FakePort(FakeBus(), "1-9", address=9)
    odd._frames._start -= 700_000_000
    ports.append(odd)
    until(lambda: "other frames" in str(row_of(one, "usb 1-9").get("problem")))
    counts = [len(port.packets) for port in ports]
    for port, count in zip(ports[:3], counts, strict=False):
        port.wait_for(count + 5)
    assert len(odd.packets) <= counts[3] + 1
    assert {row_of(one, f"usb 1-{n}")["problem"] for n in range(1, 4)} == {None}


def test_a_board_that_hangs_delays_no_other(running):
    bus = FakeBus()
    stuck, well = FakePort(bus, "1-1"), FakePort(bus, "1-2", address=3)
    stuck.blocks = threading.Event()
    running([stuck, well])
    well.wait_for(20)
    assert stuck.packets == []
    stuck.blocks.set()
    stuck.wait_for(1)


def test_a_board_that_takes_no_packet_is_counted_and_tried_again(running, caplog):
    port = FakePort(FakeBus())
    one = running([port])
    port.wait_for(1)
    port.send = lambda *packet: (_ for _ in ()).throw(j2a_transports.WriteTimeout("takes none"))
    until(lambda: one.status()["boards"][0]["lost"] >= 2)
    until(lambda: "packets were lost so far: takes none" in caplog.text)  # which comes behind it
    assert one.status()["boards"][0]["problem"] == "takes none"


def test_boards_come_and_go(running):
    bus = FakeBus()
    first, second = FakePort(bus, "1-1"), FakePort(bus, "1-2", address=3)
    ports = [first]
    one = running(ports)
    first.wait_for(1)
    ports.append(second)
    second.wait_for(1)
    assert len(one.status()["boards"]) == 2
    ports.remove(first)
    until(lambda: len(one.status()["boards"]) == 1)
    assert (first.opened, first.closed) == (1, 1)


@pytest.mark.parametrize("by_us", [3_600_000_000, -3_600_000_000, 250_000])
def test_each_step_of_the_clock_of_this_computer_is_told_once(caplog, by_us):
    now_us = moved_us = 0
    host = HostTime(lambda: now_us, lambda: 1_700_000_000_000_000 + now_us + moved_us)
    one = Daemon(interval_s=1.0, ports=None, host=host)
    for number in range(10):
        now_us, moved_us = number * 1_000_000, by_us if number >= 5 else 0
        one.observe()
    assert one.status()["steps"] == 1
    told = [record.message for record in caplog.records if "was set by" in record.message]
    assert told == [f"the clock of this computer was set by {by_us / 1e6:+.6f} s"]


def test_a_look_that_was_interrupted_is_no_step():
    """Between the readings of the counter and of the clock others may run for a while."""
    now = [0]

    def counter_us():
        if now[0] >= 5_000_000:
            now[0] += 20_000
        return now[0]

    one = Daemon(interval_s=1.0, ports=None, host=HostTime(counter_us, lambda: 10**15 + now[0]))
    one.observe()
    for _ in range(9):
        now[0] += 1_000_000
        one.observe()
    assert one.status()["steps"] == 0


@pytest.mark.skipif(not hasattr(time, "CLOCK_MONOTONIC_RAW"), reason="the system has no such clock")
def test_the_counter_is_one_that_ntp_does_not_slew():
    bus = Bus("usb bus 1", 1.0, History())
    before = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    assert before <= 1000 * bus.now_us() <= time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


def test_a_lost_board_is_opened_anew_when_it_is_there(running):
    port = FakePort(FakeBus())
    running([port])
    port.wait_for(1)
    port.fails = j2a_transports.LinkLost("gone")
    until(lambda: port.closed >= 3)
    port.fails = None
    count = len(port.packets)
    port.wait_for(count + 1)


def test_a_usb_that_cannot_be_listed_is_told_and_tried_again(running, monkeypatch):
    monkeypatch.setattr(daemon_module, "_LOOK_S", 0.02)
    port = FakePort(FakeBus())
    answers = [j2a_transports.OpenFailed("no list"), [port]]

    class Ports(list):
        def __iter__(self):
            answer = answers[0] if len(answers) > 1 else answers[-1]
            if isinstance(answer, Exception):
                raise answer
            return iter(answer)

    one = running(Ports())
    until(lambda: one.status()["problem"] == "no list")
    answers.pop(0)
    port.wait_for(1)
    assert one.status()["problem"] is None


@pytest.mark.parametrize("kind", ["usb", "url"])
def test_a_system_without_a_thread_to_give_is_told_and_asked_again(
    running, board, monkeypatch, kind
):
    module = sync_board if kind == "usb" else url_boards
    begin = module.start_thread

    def refuse(target, name):
        raise j2a.OpenFailed(f"{name}: can't start new thread")

    monkeypatch.setattr(module, "start_thread", refuse)
    port = FakePort(FakeBus())
    one = running([port] if kind == "usb" else [], urls=[board[0]] if kind == "url" else [])
    until(lambda: "new thread" in str(one.status()["problem"]))
    monkeypatch.setattr(module, "start_thread", begin)
    until(lambda: one.status()["boards"] and one.status()["boards"][0]["packets"])
    assert one.status()["problem"] is None


def test_a_usb_that_cannot_be_listed_keeps_no_board_by_url_waiting(running, board):
    class Unlisted(list):
        def __iter__(self):
            raise j2a_transports.OpenFailed("no list")

    one = running(Unlisted(), urls=[board[0]])
    until(lambda: one.status()["boards"] and one.status()["boards"][0]["packets"])
    assert one.status()["problem"] == "no list"


def test_only_the_board_that_is_meant(running):
    bus = FakeBus()
    mine, other = FakePort(bus, "1-1", address=4), FakePort(bus, "1-2", address=5)
    one = running([other, mine], only=(1, 4))
    mine.wait_for(2)
    assert [row["place"] for row in one.status()["boards"]] == ["usb 1-1"]


def test_a_board_that_a_later_instance_names_is_meant_too(running):
    """The wrapper of the thesis (listing 6.2) starts one for each board, with its -b and -d."""
    bus = FakeBus()
    mine, named, other = (FakePort(bus, f"1-{n}", address=n) for n in (4, 5, 6))
    one = running([mine, named, other], only=(1, 4))
    mine.wait_for(2)
    assert (
        "only the user of the daemon"
        in one.answer({"command": "look", "only": [1, 5]}, False)["error"]
    )
    for wrong in (7, [1], [1, "5"], [1.5, 2], [True, 5]):
        assert "bus and address" in one.answer({"command": "look", "only": wrong}, True)["error"]
    one.answer({"command": "look"}, True)  # names nothing, and changes nothing
    assert one.answer({"command": "look", "only": [1, 5]}, True)["added"] == 0
    named.wait_for(2)
    assert {row["place"] for row in one.status()["boards"]} == {"usb 1-4", "usb 1-5"}


def test_requests(running):
    port = FakePort(FakeBus())
    one = running([port])
    port.wait_for(3)
    rounds = one.answer({"command": "history", "board": "usb bus 1"}, False)["rounds"]
    assert rounds and all(len(one) == 4 for one in rounds)
    assert "no command 'x'" in one.answer({"command": "x"}, True)["error"]
    assert "list of texts" in one.answer({"command": "look", "urls": [1]}, True)["error"]
    # A daemon opens programs (exec:) with its own rights, so not everybody may give it URLs.
    refused = one.answer({"command": "look", "urls": ["exec:true"]}, False)
    assert "only the user of the daemon" in refused["error"]
    assert one.answer({"command": "look"}, False)["added"] == 0
    assert "error" in one.answer({"command": "look", "urls": ["nonsense"]}, True)


@pytest.fixture
def serve():
    """A function that serves a device, and returns its URL."""
    with contextlib.ExitStack() as stack:
        yield lambda device: stack.enter_context(served(device, "tcp://127.0.0.1:0"))


@pytest.fixture
def board(serve):
    """The URL of a device with a clock that is 80 ppm fast, and the device."""
    device = j2a.Device(clock=80.0)
    return serve(device), device


def test_a_board_by_url_is_disciplined(running, board):
    url, device = board
    one = running([], urls=[url])
    until(lambda: one.status()["boards"][0]["state"] in ("settling", "locked"))
    assert abs(device.clock_us - time.time_ns() // 1000) < 60e6
    until(lambda: url in one.answer({"command": "history"}, True)["boards"])
    assert one.answer({"command": "look", "urls": [url]}, True)["added"] == 1
    assert len(one.status()["boards"]) == 1


def test_boards_by_url_that_are_silent_delay_no_other(running, serve, board, monkeypatch):
    """They answer when they are opened, and not when they are asked for the clock."""
    silent = [serve(j2a.Device(clock=0.0)) for _ in range(10)]
    asked, may_end = set(), threading.Event()
    discipline = Clock.discipline

    def hang(clock, *args):
        if clock._url not in silent:
            return discipline(clock, *args)
        asked.add(clock._url)
        may_end.wait(60)
        raise j2a.CallTimeout("it is silent")

    monkeypatch.setattr(Clock, "discipline", hang)
    url, _ = board
    ports = []
    one = running(ports, urls=silent)
    until(lambda: asked == set(silent))
    # What comes when all of them hang: a board by URL, one with SyncUSB, and questions.
    assert one.answer({"command": "look", "urls": [url]}, True)["added"] == 1
    ports.append(FakePort(FakeBus()))
    ports[0].wait_for(1)
    rows = {}
    until(
        lambda: (
            rows.update({row["board"]: row for row in one.status()["boards"]})
            or rows[url]["packets"] > 9
        )
    )
    assert rows[url]["state"] in ("settling", "locked")
    assert {rows[name]["state"] for name in silent} == {"waiting"}
    may_end.set()
    until(lambda: "it is silent" in str(one.status()["boards"][1]["problem"]))


def test_a_board_by_url_that_falls_silent_is_locked_no_more():
    """Its link is still open, and what it said last bounds nothing any more."""
    replies, asked = [], threading.Semaphore(0)

    def read():
        asked.release()
        if not replies:
            raise j2a.CallTimeout("no reply")
        return replies.pop()

    keeper = SimpleNamespace(is_running=True, error=None, rounds=1, failures=0)
    client = SimpleNamespace(clock=SimpleNamespace(discipline=lambda _: keeper, read=read))
    fleet = SimpleNamespace(add=lambda _: None, get=lambda _: client)
    replies.append(ClockReading("locked", 1, 0.0, 0.0, 10.0, 50.0, True))
    one = url_boards._LinkBoard("tcp:", 0.01, History())
    one.start(fleet)
    for _ in range(3):  # the third one is asked when the second has failed
        assert asked.acquire(timeout=60)
    one.stop()
    one.thread.join(60)
    row = one.facts(None)
    assert (row["state"], row["uncertainty_us"], row["problem"]) == ("waiting", None, "no reply")


def test_a_board_by_url_that_has_no_clock_is_told(running, serve):
    one = running([], urls=[serve(j2a.Device())])
    until(lambda: "capability clock" in (one.status()["boards"][0]["problem"] or ""))


def test_nothing_is_opened_before_the_daemon_runs():
    """It goes to the background and becomes another user first; threads do not survive a fork."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        url = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        one = Daemon(interval_s=1.0, urls=[url], ports=None)
        assert one.status()["boards"][0]["state"] == "waiting"
        with pytest.raises(TimeoutError):
            server.accept()
        thread = start_thread(one.run, "j2a syncd")
        server.settimeout(60)
        server.accept()[0].close()
        one.stop()
        thread.join(60)


def test_a_board_by_url_that_is_not_there_is_told(running):
    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    one = running([], urls=[f"tcp://127.0.0.1:{number}"])
    until(lambda: "nothing listens there" in (one.status()["boards"][0]["problem"] or ""))
