"""A USB/IP client for tests, with layouts of its own, and a server in a thread."""

import socket
import struct
import threading
import time

from j2a_sim import FirmwareStopped, UsbipServer

from transports.tests.guest.attach import Refused, _receive, import_board  # noqa: TID251 - not installed

WAIT_S = 60
BUSY = 2

IN, OUT = 1, 0
ZERO_PACKET = 0x40
_BASIC = struct.Struct(">5I")
_SUBMIT = struct.Struct(">5I I4i 8s")
_UNLINK = struct.Struct(">5I I24x")
_RESULT = struct.Struct(">5I 5i 8x")
RET_SUBMIT, RET_UNLINK = 3, 4


def say_last(connection, data):
    """Send what the server may not like, and wait until it has closed the connection."""
    connection.settimeout(WAIT_S)
    try:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(4096):
            pass
    except TimeoutError:
        raise AssertionError("the server does not close the connection") from None
    except OSError:  # it was closed before all was said
        pass


class Client:
    """A client that has imported a board."""

    def __init__(self, port, busid="1-1"):
        self.socket, self.devid, self.speed = import_board("127.0.0.1", port, busid)
        self.socket.settimeout(60)
        self._seqnum = 0
        self._sent = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def submit(self, endpoint, data_or_length, setup=bytes(8), flags=0, packets=-1):
        """Send a CMD_SUBMIT; returns its sequence number."""
        is_in = isinstance(data_or_length, int)
        data = b"" if is_in else data_or_length
        length = data_or_length if is_in else len(data)
        self._seqnum += 1
        direction = IN if is_in else OUT
        self._sent[self._seqnum] = direction
        head = (1, self._seqnum, self.devid, direction, endpoint)
        self.socket.sendall(_SUBMIT.pack(*head, flags, length, 0, packets, 0, setup) + data)
        return self._seqnum

    def unlink(self, target):
        """Send a CMD_UNLINK; returns its sequence number."""
        self._seqnum += 1
        self.socket.sendall(_UNLINK.pack(2, self._seqnum, self.devid, 0, 0, target))
        return self._seqnum

    def result(self):
        """Return the next result: command, sequence number, status, and data or length."""
        fields = _RESULT.unpack(_receive(self.socket, _RESULT.size))
        command, seqnum, status, actual = fields[0], fields[1], fields[5], fields[6]
        if command == RET_UNLINK:
            return command, seqnum, status
        is_in = self._sent.pop(seqnum) == IN
        return command, seqnum, status, _receive(self.socket, actual) if is_in else actual

    def transfer(self, *args, **options):
        """Submit a transfer and return its status and data or length."""
        seqnum = self.submit(*args, **options)
        command, answered, status, data = self.result()
        assert (command, answered) == (RET_SUBMIT, seqnum)
        return status, data

    def control(self, kind, request, value=0, index=0, data_or_length=b""):
        """Make a control transfer."""
        is_in = isinstance(data_or_length, int)
        length = data_or_length if is_in else len(data_or_length)
        setup = struct.pack("<BBHHH", kind, request, value, index, length)
        return self.transfer(0, data_or_length, setup)


class Served:
    """A server in a thread."""

    def __init__(self, *sims, speed=0.0):
        self.said = []
        self.server = UsbipServer(sims, port=0, speed=speed, say=self.said.append)
        self.port = self.server.port
        self.stop = threading.Event()
        self.error = None
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self):
        try:
            self.server.serve(self.stop)
        except FirmwareStopped as error:
            self.error = error

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.join()

    def join(self):
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()

    def attach(self, busid="1-1"):
        """Import a board, as soon as the client before has been noticed to be gone."""
        end = time.monotonic() + WAIT_S
        while True:
            try:
                return Client(self.port, busid)
            except Refused as error:
                if error.args[0] != BUSY or time.monotonic() > end:
                    raise
                time.sleep(0.01)
