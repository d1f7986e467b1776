"""bt:// without Bluetooth: its URLs, what it says when something is missing, what it tries again.

Sockets of the process stand for those of the kernel; guest/inside_bluetooth.py has the real ones.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator
from typing import Any

import j2a_transports
import pytest
from j2a_transports import BadUrl, OpenFailed
from j2a_transports._bluetooth import link, sockets
from j2a_transports._bluetooth.sockets import Adapter

from .suite import PATIENCE_S, read_exactly
from .test_bluetooth_sdp import RFCOMM_5, element, record, response

ADDRESS = "00:1A:7D:DA:71:13"
HERE = [Adapter("hci0", "02:00:00:00:00:01", True), Adapter("hci1", "02:00:00:00:00:02", False)]
LISTS = element(6, record(b"first", RFCOMM_5) + record(b"second", RFCOMM_5[:-1] + b"\x09"))


class Air:
    """Stands for the kernel: what connecting gives, in turn; afterwards it succeeds."""

    def __init__(self) -> None:
        self.outcomes: list[int | OSError] = []
        self.always: int | None = None
        self.adapters = list(HERE)
        self.answer = response(LISTS)
        self.attempts: list[tuple[int, str, int]] = []
        self.timeouts: list[float | None] = []
        self.bound: list[tuple[str, int]] = []
        self.security: list[int] = []
        self.ends: list[socket.socket] = []
        self.others: dict[int, socket.socket] = {}

    def create(self, kind: int) -> socket.socket:
        near, far = socket.socketpair(socket.AF_UNIX, kind)
        self.ends += [near, far]
        self.others[near.fileno()] = far
        return near

    def bind(self, sock: socket.socket, address: str, port: int) -> None:
        self.bound.append((address, port))

    def connect(self, sock: socket.socket, address: str, port: int, timeout: float | None) -> None:
        self.attempts.append((int(sock.type), address, port))
        self.timeouts.append(timeout)
        outcome = self.outcomes.pop(0) if self.outcomes else self.always
        if isinstance(outcome, OSError):
            raise outcome
        if outcome:
            raise OSError(outcome, os.strerror(outcome))
        if sock.type == socket.SOCK_SEQPACKET and self.answer:
            self.others[sock.fileno()].send(self.answer)

    @property
    def far(self) -> socket.socket:
        """The other end of what was connected last."""
        return self.ends[-1]


class Time:
    """A clock that goes on while somebody sleeps, and only then."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def air(monkeypatch: pytest.MonkeyPatch) -> Iterator[Air]:
    fake = Air()
    for name in ("create", "bind", "connect"):
        monkeypatch.setattr(sockets, name, getattr(fake, name))
    monkeypatch.setattr(sockets, "adapters", lambda: fake.adapters)
    monkeypatch.setattr(sockets, "set_security", lambda sock, level: fake.security.append(level))
    monkeypatch.setattr(link, "MOMENT_S", 0.2)
    monkeypatch.setattr(link, "time", Time())
    yield fake
    for end in fake.ends:
        end.close()


class TestUrls:
    @pytest.mark.parametrize(
        "place",
        [
            "",
            "//",
            "//host/1",
            "//00:1A:7D:DA:71/1",
            f"//{ADDRESS}:1",
            f"//{ADDRESS}0",
            f"/{ADDRESS}",
        ]
        + [f"//{ADDRESS}/{channel}" for channel in ("0", "31", "x", "1/", "-1", "001", "99999")],
    )
    def test_a_wrong_one_gets_an_example(self, place: str) -> None:
        with pytest.raises(BadUrl, match="for example bt://00:1A:7D:DA:71:13/1; `bluetoothctl dev"):
            j2a_transports.open(f"bt:{place}")

    @pytest.mark.parametrize("text", [ADDRESS, f"{ADDRESS}/1", "AA:BB:CC:DD:EE:FF"])
    def test_an_address_alone_gets_the_url_that_was_meant(self, text: str) -> None:
        with pytest.raises(BadUrl, match=rf"did you mean bt://{text} \?"):
            j2a_transports.open(text)

    @pytest.mark.parametrize("place", ["//host/1", "//hci0/31", "hci0:1", "//5", f"//{ADDRESS}/x"])
    def test_a_wrong_place_to_listen_gets_an_example(self, place: str) -> None:
        with pytest.raises(BadUrl, match="expected bt: for any adapter and channel, or"):
            j2a_transports.listen(f"bt:{place}")

    @pytest.mark.parametrize(
        ("options", "says"),
        [
            ("adapter=me", "takes the address of an adapter of this machine, or its name, such as"),
            ("security=secret", "takes one of LOW, MEDIUM, HIGH"),
            ("connect_timeout=0", "takes a number of seconds above 0, or none"),
            (
                "baud=5",
                "unknown option 'baud'; bt has: adapter, connect_timeout, security, service",
            ),
            ("service=x", "give a channel or service=NAME, not both"),
        ],
    )
    def test_options(self, options: str, says: str) -> None:
        with pytest.raises(BadUrl, match=says):
            j2a_transports.open(f"bt://{ADDRESS}/1?{options}")

    @pytest.mark.parametrize(
        "url", [f"bt://{ADDRESS}/7", f"bt:{ADDRESS}/07", f"BT://{ADDRESS.lower()}/7"]
    )
    def test_forms(self, air: Air, url: str) -> None:
        with j2a_transports.open(url) as near:
            assert air.attempts == [(socket.SOCK_STREAM, ADDRESS, 7)]
            assert air.bound == []
            assert near.url == url
            near.write(b"hello")
            assert air.far.recv(100) == b"hello"
            air.far.send(b"there")
            assert read_exactly(near, 5) == b"there"

    def test_the_adapter_and_the_security_level_are_set_before_connecting(self, air: Air) -> None:
        for adapter in ("hci1", HERE[1].address):
            url = f"bt://{ADDRESS}/1?adapter={adapter}&security=high"
            j2a_transports.open(url).close()
        assert air.bound == [(HERE[1].address, 0)] * 2
        assert air.security == [3, 3]

    def test_an_adapter_where_the_system_does_not_tell_which_there_are(self, air: Air) -> None:
        air.adapters.clear()
        j2a_transports.open(f"bt://{ADDRESS}/1?adapter=02:00:00:00:00:0a").close()
        assert air.bound == [("02:00:00:00:00:0A", 0)]
        with pytest.raises(OpenFailed, match="no adapter hci5; there is: none that is known"):
            j2a_transports.open(f"bt://{ADDRESS}/1?adapter=hci5")


class TestLookUp:
    @pytest.mark.requirement("SPP-002")
    @pytest.mark.parametrize(("option", "channel"), [("", 5), ("?service=second", 9)])
    def test_without_a_channel_the_device_is_asked(
        self, air: Air, option: str, channel: int
    ) -> None:
        j2a_transports.open(f"bt://{ADDRESS}{option}").close()
        assert air.attempts == [
            (socket.SOCK_SEQPACKET, ADDRESS, 1),
            (socket.SOCK_STREAM, ADDRESS, channel),
        ]

    def test_it_is_asked_each_time(self, air: Air) -> None:
        for channel in (5, 6):
            air.answer = response(element(6, record(b"", RFCOMM_5[:-1] + bytes([channel]))))
            j2a_transports.open(f"bt://{ADDRESS}/").close()
        assert [port for _, _, port in air.attempts] == [1, 5, 1, 6]

    def test_a_name_that_it_does_not_have(self, air: Air) -> None:
        says = r"named 'third'; it has 'first' \(channel 5\), 'second' \(channel 9\), or give"
        with pytest.raises(OpenFailed, match=says):
            j2a_transports.open(f"bt://{ADDRESS}?service=third")

    def test_no_serial_port(self, air: Air) -> None:
        air.answer = response(b"\x35\x00")
        with pytest.raises(OpenFailed, match="publishes no serial port; start the program there"):
            j2a_transports.open(f"bt://{ADDRESS}")

    def test_nonsense(self, air: Air) -> None:
        air.answer = b"nonsense"
        with pytest.raises(OpenFailed, match=f"lengths .* not fit; .*, often 1: bt://{ADDRESS}/1"):
            j2a_transports.open(f"bt://{ADDRESS}")

    def test_no_answer(self, air: Air) -> None:
        air.answer = b""
        with pytest.raises(OpenFailed, match=r"no answer within 0\.1 s"):
            j2a_transports.open(f"bt://{ADDRESS}?connect_timeout=0.1")

    def test_no_server(self, air: Air) -> None:
        air.always = errno.ECONNREFUSED
        with pytest.raises(OpenFailed, match=f"tells no services; give the channel, .*{ADDRESS}/1"):
            j2a_transports.open(f"bt://{ADDRESS}")

    def test_a_system_without_l2cap_sockets(
        self, air: Air, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(sockets, "_NATIVE", True)
        monkeypatch.setattr(sockets, "LINUX", False)
        with pytest.raises(OpenFailed, match=f"no sockets to ask .*, often 1: bt://{ADDRESS}/1"):
            j2a_transports.open(f"bt://{ADDRESS}")
        j2a_transports.open(f"bt://{ADDRESS}/1").close()


class TestFailures:
    @pytest.mark.parametrize(
        ("number", "says", "again"),
        [
            (errno.EHOSTDOWN, "does not answer: is it switched on", True),
            (errno.ETIMEDOUT, "does not answer: is it switched on", True),
            (errno.ECONNREFUSED, "refuses channel 3: start what listens there", True),
            (errno.EBUSY, "channel 3 is in use; close the other program", True),
            (errno.ECONNRESET, "cannot connect to channel 3: Connection reset", True),
            (errno.EACCES, f"`bluetoothctl pair {ADDRESS}`; if it was", False),
            (errno.EBADE, f"`bluetoothctl pair {ADDRESS}`; if it was", False),
            (errno.EPROTONOSUPPORT, "kernel has no Bluetooth: `sudo modprobe rfcomm`", False),
            (errno.EHOSTUNREACH, "the adapter went away", False),
            (errno.ENETDOWN, "the adapter went away", False),
            (errno.EOPNOTSUPP, "cannot connect to channel 3: Operation not supported", False),
        ],
    )
    def test_each_says_what_to_do_and_what_may_pass_is_tried_again(
        self, air: Air, number: int, says: str, again: bool
    ) -> None:
        air.always = number
        with pytest.raises(OpenFailed, match=says):
            j2a_transports.open(f"bt://{ADDRESS}/3?connect_timeout=0.3")
        assert (len(air.attempts) > 1) is again
        assert all(end.fileno() < 0 for end in air.ends[::2])
        # The next attempt has less time than the one before.
        assert air.timeouts == sorted(air.timeouts, reverse=True)

    @pytest.mark.parametrize("number", [errno.EHOSTDOWN, errno.EBUSY, errno.ECONNREFUSED])
    def test_what_passes_ends_in_a_link(self, air: Air, number: int) -> None:
        air.outcomes = [number, number]
        with j2a_transports.open(f"bt://{ADDRESS}/3") as near:
            assert len(air.attempts) == 3
            air.far.send(b"x")
            assert near.read(PATIENCE_S) == b"x"

    def test_a_refusal_is_believed_before_the_time_is_over(
        self, air: Air, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Waiting for ever is for a device that is not there yet."""
        monkeypatch.setattr(link, "_FIRST_PAUSE_S", 0.001)
        air.outcomes = [errno.EHOSTDOWN] * 5
        air.always = errno.ECONNREFUSED
        with pytest.raises(OpenFailed, match="refuses"):
            j2a_transports.open(f"bt://{ADDRESS}/3?connect_timeout=none")
        assert set(air.timeouts) == {None}

    def test_an_attempt_that_takes_too_long(self, air: Air) -> None:
        air.outcomes = [TimeoutError("timed out")]
        with pytest.raises(OpenFailed, match=r"no answer within 0\.5 s: is it switched on"):
            j2a_transports.open(f"bt://{ADDRESS}/3?connect_timeout=0.5")

    @pytest.mark.parametrize(
        ("adapters", "says"),
        [
            ([], "no Bluetooth adapter is there: plug one in"),
            ([HERE[1]], "switched off: `bluetoothctl power on`, before that `sudo rfkill unblock"),
        ],
    )
    def test_no_adapter(self, air: Air, adapters: list[Adapter], says: str) -> None:
        air.adapters = adapters
        air.always = errno.EHOSTUNREACH
        with pytest.raises(OpenFailed, match=says):
            j2a_transports.open(f"bt://{ADDRESS}/3")

    def test_no_bluetooth_in_the_kernel(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def create(kind: int) -> socket.socket:
            raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))

        monkeypatch.setattr(sockets, "create", create)
        for url in (f"bt://{ADDRESS}/3", f"bt://{ADDRESS}"):
            with pytest.raises(
                OpenFailed, match="no Bluetooth: `sudo modprobe rfcomm`; a container"
            ):
                j2a_transports.open(url)
        with pytest.raises(OpenFailed, match="no Bluetooth: `sudo modprobe rfcomm`; a container"):
            j2a_transports.listen("bt:///1")

    def test_a_python_without_bluetooth(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sockets, "_NATIVE", False)
        monkeypatch.setattr(sockets, "LINUX", False)
        for function in (j2a_transports.open, j2a_transports.listen):
            with pytest.raises(OpenFailed, match="this Python has no Bluetooth sockets"):
                function(f"bt://{ADDRESS}/3")

    def test_a_link_that_ends_at_once(self, air: Air, monkeypatch: pytest.MonkeyPatch) -> None:
        def fails(*arguments: Any) -> None:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

        monkeypatch.setattr(link.PolledTransport, "__init__", fails)
        with pytest.raises(OpenFailed, match="Too many open files"):
            j2a_transports.open(f"bt://{ADDRESS}/3")
        assert air.ends[0].fileno() < 0
