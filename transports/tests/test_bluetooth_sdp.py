"""Service discovery: what BlueZ answers, what no server should, and what is registered."""

from __future__ import annotations

import struct
from collections.abc import Callable
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_transports._bluetooth import sdp
from j2a_transports._bluetooth.sdp import SdpError, SerialService

# What BlueZ 5.66 answered about two records: its own "Serial Port" on channel 7, added by
# `sdptool add --channel=7 SP`, and "J2A" on channel 1, registered by this package.
GOLDEN = bytes.fromhex(
    "07000000430040353e3521090004350c350319010035051900030807090100250b536572"
    "69616c20506f72743519090004350c35031901003505190003080109010025034a324100"
)
REQUEST = bytes.fromhex("06 0000 0010 3503 191101 ffff 3506 090004 090100 00")


def response(lists: bytes, number: int = 0, continuation: bytes = b"") -> bytes:
    body = struct.pack(">H", len(lists)) + lists + bytes([len(continuation)]) + continuation
    return struct.pack(">BHH", 7, number, len(body)) + body


def answering(*packets: bytes) -> Callable[[bytes], bytes]:
    answers = iter(packets)
    return lambda request: next(answers)


def element(kind: int, body: bytes) -> bytes:
    return bytes([kind << 3 | 6]) + struct.pack(">H", len(body)) + body


def record(name: bytes, protocols: bytes) -> bytes:
    return element(6, b"\x09\x00\x04" + protocols + b"\x09\x01\x00" + element(4, name))


RFCOMM_5 = bytes.fromhex("350c 3503 190100 3505 190003 0805")


class TestAnswers:
    def test_what_bluez_answers(self) -> None:
        requests = []

        def exchange(request: bytes) -> bytes:
            requests.append(request)
            return GOLDEN

        services = sdp.serial_services(exchange)
        assert services == [SerialService("Serial Port", 7), SerialService("J2A", 1)]
        assert requests == [REQUEST]

    def test_an_answer_in_pieces(self) -> None:
        lists = GOLDEN[7:-1]
        requests = []
        pieces = [lists[at : at + 20] for at in range(0, len(lists), 20)]

        def exchange(request: bytes) -> bytes:
            number = len(requests)
            requests.append(request)
            more = bytes([number] * 3) if number < len(pieces) - 1 else b""
            return response(pieces[number], number, more)

        assert [service.channel for service in sdp.serial_services(exchange)] == [7, 1]
        # Each request after the first brings back what the server has said.
        assert requests[0][-1:] == b"\0"
        assert [request[-4:] for request in requests[1:]] == [
            bytes([3, number, number, number]) for number in range(len(pieces) - 1)
        ]
        assert [request[1:3] for request in requests] == [
            struct.pack(">H", number) for number in range(len(pieces))
        ]

    @pytest.mark.parametrize(
        ("protocols", "channel"),
        [
            (RFCOMM_5, 5),
            # The UUIDs in their long forms.
            (bytes.fromhex("3509 3507 1a00000003 0805"), 5),
            (bytes.fromhex("3515 3513 1c 00000003 0000 1000 8000 00805f9b34fb 0805"), 5),
            # An alternative of two protocol stacks, the first without RFCOMM.
            (bytes.fromhex("3d12 3505 3503 190100 3509 3507 190003 09000a 00"), 10),
        ],
    )
    def test_forms_of_the_protocol_list(self, protocols: bytes, channel: int) -> None:
        answer = response(element(6, record(b"x\0", protocols)))
        assert sdp.serial_services(answering(answer)) == [SerialService("x", channel)]

    @pytest.mark.parametrize(
        "lists",
        [
            b"\x35\x00",
            b"\x00",
            b"\x08\x05",
            element(6, b"\x08\x05"),
            element(6, element(6, b"")),
            element(6, element(6, b"\x09\x00\x04")),
            element(6, element(6, b"\x35\x00\x08\x01")),
            # Channels that RFCOMM does not have, and no channel at all.
            element(6, record(b"x", bytes.fromhex("3507 3505 190003 081f"))),
            element(6, record(b"x", bytes.fromhex("3507 3505 190003 0800"))),
            element(6, record(b"x", bytes.fromhex("3508 3506 190003 2501 61"))),
            element(6, record(b"x", bytes.fromhex("3505 3503 190003"))),
            element(6, record(b"x", bytes.fromhex("3507 3505 190100 0805"))),
        ],
    )
    def test_no_serial_port(self, lists: bytes) -> None:
        assert sdp.serial_services(answering(response(lists))) == []

    def test_a_name_that_is_no_text(self) -> None:
        for name, shown in ((b"\xff", "\N{REPLACEMENT CHARACTER}"), (b"", "")):
            answer = response(element(6, record(name, RFCOMM_5)))
            assert sdp.serial_services(answering(answer)) == [SerialService(shown, 5)]
        nameless = element(6, element(6, b"\x09\x00\x04" + RFCOMM_5))
        assert sdp.serial_services(answering(response(nameless))) == [SerialService("", 5)]


class TestNonsense:
    @pytest.mark.parametrize(
        ("packet", "says"),
        [
            (b"", "cut off"),
            (b"\x07\x00\x00\x00", "cut off"),
            (b"\x07\x00\x00\x00\x00", "cut off"),
            (b"\x07\x00\x00\x00\x01\x00\x00", "lengths"),
            (b"\x01\x00\x00\x00\x02\x00\x03", "refuses the request with error 0003"),
            (b"\x01\x00\x00\x00\x00", "error unknown"),
            (b"\x05" + response(b"\x35\x00")[1:], "packet 0x05 number 0 instead"),
            (response(b"\x35\x00", 1), "packet 0x07 number 1 instead"),
            (b"\x07\x00\x00\x00\x03\x00\x05\x35", "lengths"),
            (b"\x07\x00\x00\x00\x04\x00\x02\x35\x00", "lengths"),
            (b"\x07\x00\x00\x00\x06\x00\x02\x35\x00\x02\x00", "lengths"),
            (response(b"", 0, b"more"), "promises more but sends nothing"),
            (response(b""), "cut off"),
            (response(b"\x35\x00\x00"), "1 bytes follow"),
            (response(b"\x36\x00"), "cut off"),
            (response(b"\x35\x05\x08\x01"), "cut off"),
            (response(b"\x35\x01\x09\x00\x00"), "longer than what holds it"),
            (response(b"\x35\x02\x4a\x00"), "cut off"),
            (response(b"\x48\x00"), "unknown type 9"),
            (response(b"\x18\x00"), "a UUID in its answer has 1 bytes"),
            (response(b"\x35\x00" * 0 + b"\x35" * 1), "cut off"),
        ],
    )
    def test_an_answer_that_makes_no_sense(self, packet: bytes, says: str) -> None:
        with pytest.raises(SdpError, match=says):
            sdp.serial_services(answering(packet))

    def test_nesting_without_end(self) -> None:
        lists = b""
        for _ in range(5000):
            lists = element(6, lists)
        with pytest.raises(SdpError, match="nested too deeply"):
            sdp.serial_services(answering(response(lists)))

    def test_an_answer_without_end(self) -> None:
        rounds = []

        def exchange(size: int) -> Callable[[bytes], bytes]:
            def answer(request: bytes) -> bytes:
                rounds.append(request)
                number = int.from_bytes(request[1:3], "big")
                return response(bytes(size), number, b"more")

            return answer

        with pytest.raises(SdpError, match="does not end after 256 packets"):
            sdp.serial_services(exchange(1))
        assert len(rounds) == 256
        rounds.clear()
        with pytest.raises(SdpError, match="longer than 65536 bytes"):
            sdp.serial_services(exchange(60000))
        assert len(rounds) == 2

    @given(st.lists(st.binary(max_size=100), min_size=1, max_size=4))
    def test_arbitrary_packets(self, packets: list[bytes]) -> None:
        with pytest.raises(SdpError):
            sdp.serial_services(answering(*packets, b""))

    @given(st.binary(max_size=60))
    def test_arbitrary_elements(self, lists: bytes) -> None:
        try:
            services = sdp.serial_services(answering(response(lists)))
        except SdpError:
            return
        assert all(1 <= service.channel <= 30 for service in services)

    @given(st.integers(0, len(GOLDEN) - 1), st.binary(max_size=3))
    def test_a_damaged_answer(self, at: int, replacement: bytes) -> None:
        packet = GOLDEN[:at] + replacement + GOLDEN[at + len(replacement) :]
        try:
            services = sdp.serial_services(answering(packet))
        except (SdpError, StopIteration):
            # The second: it promises more now.
            return
        assert all(1 <= service.channel <= 30 for service in services)


class TestElements:
    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("00", None),
            ("08 ff", 255),
            ("0c" + "00" * 15 + "07", 7),
            ("10 ff", -1),
            ("12 80000000", -(2**31)),
            ("28 00", False),
            ("28 01", True),
            ("19 1101", UUID("00001101-0000-1000-8000-00805f9b34fb")),
            ("25 02 6869", b"hi"),
            ("27 00000001 68", b"h"),
            ("45 01 2f", b"/"),
            ("3d 04 0801 3500", [1, []]),
        ],
    )
    def test_each_type(self, text: str, value: object) -> None:
        assert sdp.parse_element(bytes.fromhex(text)) == value


class TestRegistration:
    def test_what_is_registered_is_what_a_client_finds(self) -> None:
        packet = sdp.registration("J2A \N{GREEK SMALL LETTER MU}", 12)
        kind, number, length = struct.unpack_from(">BHH", packet)
        assert (kind, number, length) == (0x75, 0, len(packet) - 5)
        found = sdp.serial_services(answering(response(element(6, packet[6:]))))
        assert found == [SerialService("J2A \N{GREEK SMALL LETTER MU}", 12)]
        attributes = sdp.parse_element(packet[6:])
        # Servers want them in order; the class is what a client asks for.
        assert attributes[::2] == sorted(attributes[::2])
        assert attributes[1] == [UUID("00001101-0000-1000-8000-00805f9b34fb")]

    def test_a_long_name_is_cut_between_characters(self) -> None:
        packet = sdp.registration("\N{GREEK SMALL LETTER MU}" * 200, 1)
        (found,) = sdp.serial_services(answering(response(element(6, packet[6:]))))
        assert found.name == "\N{GREEK SMALL LETTER MU}" * 127

    def test_the_answer(self) -> None:
        sdp.check_registration(bytes.fromhex("76 0000 0004 00010005"))
        with pytest.raises(SdpError, match="error 0003"):
            sdp.check_registration(bytes.fromhex("01 0000 0002 0003"))
        with pytest.raises(SdpError, match="cut off"):
            sdp.check_registration(b"")
