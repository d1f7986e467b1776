"""Over a transport whose time is simulated, every time limit is simulated time."""

import asyncio
import threading
import time

import j2a_transports
import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF

import j2a

from .support import PATIENCE_S


class SlowDevice(j2a_transports.Transport):
    """Answers each request after so many simulated seconds; time passes only in `read`."""

    is_simulated = True

    def __init__(self, takes_s):
        super().__init__("simulated:")
        self.takes_s = takes_s
        self.now_s = 1000.0
        self.due = []
        self._lock = threading.Lock()
        self._closed = False

    def clock(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds

    def read(self, timeout_s):
        time.sleep(0.0005)  # a simulator takes its time, too
        with self._lock:
            if self._closed:
                raise j2a_transports.LinkClosed("simulated: is closed")
            end_s = self.now_s + (0.01 if timeout_s is None else timeout_s)
            if self.due and self.due[0][0] <= end_s:
                self.now_s, data = self.due.pop(0)
                return data
            self.now_s = end_s
            return b""

    def write(self, data):
        with self._lock:
            for request in oracle.decode(bytes(data)):
                reply = oracle.encode(oracle.Frame(SOF, request.seq, 0, b"done"))
                self.due.append((self.now_s + self.takes_s, reply))

    @property
    def closed(self):
        return self._closed

    def close(self):
        self._closed = True


@pytest.mark.parametrize(("takes_s", "limit_s"), [(3.0, 1.0), (6.0, 2.0), (0.5, 0.05)])
def test_a_call_ends_after_its_limit_in_simulated_time(takes_s, limit_s):
    device = SlowDevice(takes_s)
    with j2a.Client(device) as client:
        begun_s = device.now_s
        with pytest.raises(j2a.CallTimeout):
            client.call(1, timeout=limit_s)
        assert begun_s + limit_s <= device.now_s


@pytest.mark.parametrize(("takes_s", "limit_s"), [(3.0, 9.0), (7.0, 8.0)])
def test_a_reply_within_the_limit_in_simulated_time(takes_s, limit_s):
    with j2a.Client(SlowDevice(takes_s)) as client:
        assert client.call(1, timeout=limit_s).payload == b"done"


def test_the_asyncio_client_keeps_simulated_limits_too():
    async def main():
        device = SlowDevice(3.0)
        async with j2a.AsyncClient(device) as client:
            with pytest.raises(j2a.CallTimeout):
                await client.call(1, timeout=1.0)
            assert (await client.call(1, timeout=20.0)).payload == b"done"

    asyncio.run(asyncio.wait_for(main(), PATIENCE_S))
