"""What a device announces: version, capabilities, limits; and clients that meet other versions."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_spec.constants import FLAG_WRITE

import j2a
from j2a.demo import DemoDevice
from j2a.events import Reply
from j2a.io.functions import FunctionTable
from j2a.protocol.announced import Announced
from j2a.protocol.device_info import DEFAULT_MAX_BYTES, DeviceInfo
from j2a.types.transducers import Descriptors

from .support import served
from .test_many import content, drive, know

NO_VERSION = [
    "", "abc", "1", "1.", ".1", "1.1.0", "v1.1", " 1.1", "1.1 ", "01.1", "1.01", "+1.1", "1,1",
    "1.100000", "100000.1", "\u0661.1", "1.1\n",
]  # fmt: skip


def device(version: str, stored: bytes = bytes(700), **more: str) -> DemoDevice:
    made = DemoDevice()
    properties = {"j2a.spec": version, **{key.replace("_", "."): more[key] for key in more}}
    made._table = j2a.Device(properties)._table
    made.many("store")(lambda request: j2a.read_chunk(stored, request))
    return made


@pytest.mark.requirement("J2A-VER-001", "J2A-PROP-005")
@pytest.mark.parametrize("text", NO_VERSION)
def test_another_form_is_version_1_0(text):
    announced = Announced({"j2a.spec": text})
    assert announced.version == (1, 0)
    assert announced.is_supported
    assert not announced.has_long_offsets


@pytest.mark.requirement("J2A-VER-001")
@given(st.integers(0, 99999), st.integers(0, 99999))
def test_versions_are_compared_as_numbers(major, minor):
    announced = Announced({"j2a.spec": f"{major}.{minor}"})
    assert announced.version == (major, minor)
    assert announced.is_supported == (major == 1)
    assert announced.has_long_offsets == (major > 1 or (major == 1 and minor > 0))


@pytest.mark.requirement("J2A-VER-002")
@pytest.mark.parametrize("version", ["1.1", "1.2", "1.10", "1.99999"])
def test_a_later_minor_version_is_used_like_ours(version):
    newer = device(version, j2a_future="x", j2a_caps="future")
    peer = know(newer)
    read = peer.read("store", DEFAULT_MAX_BYTES, None)
    assert drive(newer._execute, read) == bytes(700)


def test_the_version_may_be_the_last_property():
    """Whether an offset above 255 may be sent is known when the properties have come so far."""
    made, requests = j2a.Device(), []
    properties = {"name": "x", "text": "x" * 200, "j2a.spec": "1.1", "long": "x" * 600}
    made._table = FunctionTable(properties, lambda _: (0, b""))
    assert drive(made._execute, know(made).read_properties(), requests) == properties
    assert [int.from_bytes(r[2:6], "little") for r in requests] == [0, 249, 498, 747]


@pytest.mark.requirement("J2A-VER-001")
@pytest.mark.parametrize("version", ["1.0", "abc"])
def test_an_older_or_unreadable_version_is_not_trusted(version):
    older = device(version)
    with pytest.raises(j2a.LegacyLimit):
        drive(older._execute, know(older).read("store", DEFAULT_MAX_BYTES, None))


@pytest.mark.requirement("J2A-MANY-014")
def test_a_device_that_is_met_anew_is_tried_anew():
    honours, perhaps = device("1.0", content(700)), device("1.0")
    peer = know(honours)
    assert drive(honours._execute, peer.read("store", DEFAULT_MAX_BYTES, None)) == content(700)
    peer.take_map(Reply(*perhaps._execute(0, b"")))
    with pytest.raises(j2a.LegacyLimit):
        drive(perhaps._execute, peer.read("store", DEFAULT_MAX_BYTES, None))


class TestAnotherMajorVersion:
    @pytest.mark.requirement("J2A-VER-003")
    @pytest.mark.parametrize("version", ["0.9", "2.0", "10.1"])
    @pytest.mark.parametrize("is_known", [True, False])
    def test_transfers_are_refused(self, version, is_known):
        other = device(version)
        peer = know(other)
        if is_known:
            assert drive(other._execute, peer.read_properties())["j2a.spec"] == version
        requests = []
        short = (lambda p: p.write("store", b"x", None), lambda p: p.echo(b"x", None))
        for steps in (
            *(short if is_known else ()),
            lambda p: p.read("store", DEFAULT_MAX_BYTES, None),
            lambda p: p.write("store", content(700), None),
            lambda p: p.echo(content(700), None),
        ):
            asked = peer if is_known else know(other)
            with pytest.raises(j2a.UnsupportedVersion, match=rf"J2A {version}, .*1\.1") as raised:
                drive(other._execute, steps(asked), requests)
            if is_known:
                assert raised.value.outcome is j2a.Outcome.NOT_SENT
        offsets = [int.from_bytes(r[2:6], "little") for r in requests]
        assert offsets == [] if is_known else max(offsets) <= 255
        assert not any(request[1] & FLAG_WRITE for request in requests)

    @pytest.mark.requirement("J2A-VER-003")
    @pytest.mark.parametrize("version", ["0.9", "2.0", "10.1"])
    @pytest.mark.parametrize("is_known", [True, False])
    def test_its_properties_may_be_read_as_any_data(self, version, is_known):
        other = device(version, long="x" * 600)
        peer = know(other)
        if is_known:
            drive(other._execute, peer.read_properties())
        raw = drive(other._execute, peer.read("a2jGetProperties", DEFAULT_MAX_BYTES, None))
        assert b"j2a.spec\0" + version.encode() + b"\0" in raw
        assert b"long\0" + b"x" * 600 + b"\0" in raw

    @pytest.mark.requirement("J2A-VER-003")
    def test_what_it_announces_counts_as_absent(self):
        said = {"j2a.rxbuf": "64", "j2a.room": "40", "j2a.caps": "future"}
        announced = Announced({"j2a.spec": "2.0", **said})
        assert (announced.rxbuf, announced.room, announced.capabilities) == (0, 255, frozenset())
        ours = Announced({"j2a.spec": "1.1", **said})
        assert (ours.rxbuf, ours.room, ours.capabilities) == (64, 40, {"future"})

    def test_single_calls_go_on(self):
        with served(device("2.0")) as url, j2a.connect(url) as board:
            assert board.properties["j2a.spec"] == "2.0"
            assert board.call("a2jEcho", bytes(200)).payload == bytes(200)
            with pytest.raises(j2a.UnsupportedVersion):
                board.read_many("store")


class TestCapabilities:
    @pytest.mark.requirement("J2A-CAP-002")
    @pytest.mark.parametrize(
        ("text", "tokens"),
        [
            ("", set()),
            ("one", {"one"}),
            ("one two-2 acme.three", {"one", "two-2", "acme.three"}),
            ("  one  one ", {"one"}),
            ("One 1 -x .y \u00e4 a\tb one", {"one"}),
            ("a" * 32 + " " + "b" * 33, {"a" * 32}),
        ],
    )
    def test_what_is_no_token_is_ignored(self, text, tokens):
        assert Announced({"j2a.caps": text}).capabilities == tokens

    @pytest.mark.requirement("J2A-CAP-002")
    def test_clients_show_them(self):
        with served(device("1.1", j2a_caps="future acme.turbo ?")) as url:
            with j2a.connect(url) as board:
                assert board.capabilities == {"interface", "future", "acme.turbo"}
                board.refresh()
                assert board.capabilities == {"interface", "future", "acme.turbo"}

            async def ask():
                async with await j2a.aconnect(url) as board:
                    return await board.capabilities()

            assert asyncio.run(ask()) == {"interface", "future", "acme.turbo"}

    @pytest.mark.requirement("J2A-CAP-001")
    @pytest.mark.parametrize("interface", [False, True])
    @pytest.mark.parametrize("given", ["x clock", "clock x", "transducers x clock", "x"])
    def test_a_device_announces_none_twice(self, given, interface):
        made = j2a.Device(
            {"j2a.caps": given}, clock=0, transducers=Descriptors(), interface=interface
        )
        with served(made) as url, j2a.connect(url) as board:
            tokens = board.properties["j2a.caps"].split(" ")
        assert sorted(tokens) == ["clock", *["interface"] * interface, "transducers", "x"]


@pytest.mark.requirement("J2A-LIMIT-009")
@pytest.mark.parametrize(
    "text", ["", "0", "01", "+1", "-5", "1.0", "x", "\u0665", "1" * 11, "9" * 5000]
)
def test_what_is_no_number_is_absent(text):
    announced = Announced({"j2a.rxbuf": text, "j2a.room": text})
    assert (announced.rxbuf, announced.room) == (0, 255)


@pytest.mark.requirement("J2A-LIMIT-009")
@pytest.mark.parametrize(
    ("text", "room"), [("31", 255), ("32", 32), ("254", 254), ("255", 255), ("9999999999", 255)]
)
def test_a_room_out_of_range_is_absent(text, room):
    assert Announced({"j2a.room": text}).room == room


def test_a_new_map_forgets_the_announcement():
    peer = know(device("2.0"))
    peer.announced = Announced({"j2a.spec": "2.0"})
    peer.take_map(Reply(0, b"a2jGetMapping\0"))
    assert peer.announced.is_supported
    assert DeviceInfo().announced.version == (1, 0)
