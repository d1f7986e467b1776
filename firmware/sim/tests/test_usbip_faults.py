"""What a client of the USB/IP server may send: nothing of it harms the next client."""

import contextlib
import socket
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from j2a_sim import UsbipServer
from j2a_sim._usbip import server, session
from j2a_transports import OpenFailed

from firmware.sim.tests.usbip_client import WAIT_S, say_last

pytestmark = pytest.mark.avr


@pytest.mark.parametrize(
    ("host", "says"),
    [
        ("127.0.0.1", "Address already in use: another program listens there"),
        ("192.0.2.1", "Cannot assign requested address$"),
        ("j2a.invalid", "Name or service not known$|Temporary failure in name resolution$"),
    ],
)
def test_where_it_cannot_listen(usb_board, host, says):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(OpenFailed, match=rf"^cannot listen on {host}:{port}: ({says})"):
            UsbipServer([usb_board()], host, port)


@settings(max_examples=15)
@given(st.binary(min_size=1, max_size=200))
def test_nonsense_instead_of_a_request(served, data):
    with socket.create_connection(("127.0.0.1", served.port)) as connection:
        say_last(connection, data)
    with served.attach() as client:
        assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")


field = st.one_of(st.integers(0, 20), st.integers(0, 0xFFFFFFFF))


@settings(max_examples=25)
@given(
    st.sampled_from([1, 1, 1, 2, 3, 4, 0, 0xFFFFFFFF]),
    st.lists(field, min_size=8, max_size=8),
    st.booleans(),
    st.binary(min_size=8, max_size=100),
)
def test_nonsense_as_a_command(served, command, fields, knows_devid, rest):
    """Whatever comes costs the connection at most; the next client has a board that works."""
    with served.attach() as client:
        if knows_devid:
            fields[1] = client.devid
        message = struct.pack(">9I", command, *fields) + rest
        say_last(client.socket, message)
    with served.attach() as client:
        assert client.control(0x00, 9, 1) == (0, 0)
        assert client.transfer(2, b"x") == (0, 1)
        assert client.transfer(1, 64) == (0, b"x")


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ((7, 1, None, 0, 0), "no command: 00000007"),
        ((3, 1, None, 0, 0), "command 3 is none of a client"),
        ((1, 1, None, 2, 0), "direction 2"),
        ((1, 1, None, 0, 16), "endpoint 16"),
        ((1, 1, 99, 0, 0), "device 0x63 was not imported"),
        ((1, 1, None, 0, 0, 0, -1), "-1 bytes in a transfer"),
        ((1, 1, None, 0, 0, 0, 1 << 30), "bytes in a transfer"),
        ((1, 1, None, 0, 0, 0, 0, 0, 1 << 30), "packets in a transfer"),
    ],
)
def test_what_a_client_is_dropped_for(served, fields, says):
    with served.attach() as client:
        fields = [client.devid if f is None else f for f in fields] + [0] * (10 - len(fields))
        client.socket.sendall(struct.pack(">5I I4i 8x", *fields))
        assert client.socket.recv(1) == b""
    served.attach().socket.close()
    assert any(says in text for text in served.said), served.said


def test_a_sequence_number_in_use(served):
    with served.attach() as client:
        for _ in range(2):
            client.socket.sendall(
                struct.pack(">5I I4i 8x", 1, 5, client.devid, 1, 1, 0, 64, 0, -1, 0)
            )
        assert client.socket.recv(1) == b""


def test_too_many_transfers(served):
    with served.attach() as client, pytest.raises(ConnectionError):
        for _ in range(300):
            client.submit(1, 64)
        while True:
            client.result()


def test_clients_that_say_nothing_hold_nobody_up(served):
    with contextlib.ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection(("127.0.0.1", served.port)))
            for _ in range(server.MOST_ASKING + 1)
        ]
        with served.attach() as client:
            assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")
        silent[0].settimeout(WAIT_S)
        assert silent[0].recv(1) == b""  # the oldest made room


@pytest.mark.parametrize("said", [b"", b"\x01\x11\x80"])
def test_a_client_has_to_ask_in_time(served, monkeypatch, said):
    monkeypatch.setattr(server, "REQUEST_TIMEOUT_S", 0.1)
    with socket.create_connection(("127.0.0.1", served.port)) as connection:
        connection.settimeout(WAIT_S)
        connection.sendall(said)
        assert connection.recv(1) == b""


def test_who_imports_a_board_and_leaves_it_alone_loses_it(served, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(session, "FIRST_COMMAND_S", 0.1)
        with served.attach() as silent:
            assert silent.socket.recv(1) == b""
    with served.attach() as client:
        assert client.control(0x80, 8, 0, 0, 1) == (0, b"\1")
