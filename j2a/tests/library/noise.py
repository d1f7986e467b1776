"""Connecting to noise instead of a device, in virtual time.

    python -m j2a.tests.library.noise --seeds 1000

Each seed is one `connect` to random bytes of a kind and a rate. None may be taken for a device.
"""

import argparse
import sys
from collections import Counter
from random import Random

from j2a_spec import oracle
from j2a_spec.constants import SOF

import j2a
from j2a.io.client_base import ClientBase
from j2a.protocol.session import Session
from j2a.protocol.transfer import Transfer

RATES = (100, 5760, 100_000)
"""Bytes a second."""
BOOT_S = 5.0
_STEP_S = 0.02


def random_bytes(random: Random, size: int) -> bytes:
    """Return bytes of which each is as likely."""
    return random.randbytes(size)


def few_bits(random: Random, size: int) -> bytes:
    """Return what a wrong speed makes: a few values, start bytes among them."""
    values = bytes((0x12, 0x00, 0xF0, 0xFF, 0x7D, random.randrange(256)))
    return bytes(random.choices(values, k=size))


def random_frames(random: Random, size: int) -> bytes:
    """Return whole frames with random content, half of them refusals."""
    data = b""
    while len(data) < size:
        code = random.choice((0xF0, random.randrange(256)))
        payload = random.randbytes(random.choice((0, 2, random.randrange(20))))
        data += oracle.encode(oracle.Frame(SOF, random.randrange(256), code, payload))
    return data


KINDS = (random_bytes, few_bits, random_frames)


class Noise(ClientBase):
    """A client at whose link there is nothing but noise."""

    def __init__(self, random: Random, kind, rate: int) -> None:
        self._begin("noise:", 1.0, 1, None)
        # The seed decides what a client draws by chance, so that a bad end can be repeated.
        self._session = Session(first_seq=random.randrange(256))
        self.random, self.kind, self.rate = random, kind, rate
        self.now = 0.0

    def connect(self) -> None:
        self.do(self._connect(BOOT_S, 0))

    def do(self, transfer: Transfer) -> None:
        limits = self._device_limits(self.now, BOOT_S)
        try:
            [request] = next(transfer)
            while True:
                try:
                    reply = self.call(*self._arguments(request, limits, self.now))
                except j2a.J2AError as error:
                    [request] = transfer.throw(error)
                else:
                    [request] = transfer.send([reply])
        except StopIteration:
            pass

    def call(self, what: str, opcode: int, payload: bytes, limit_s: float) -> j2a.Reply:
        call = self._session.start_call(
            what, opcode, payload, now=self.now, timeout_s=limit_s, waiter=object()
        )
        while not call.has_ended:
            self._session.receive(self.kind(self.random, int(self.rate * _STEP_S) or 1))
            self.now += _STEP_S
            self._session.handle_timeout(self.now)
        if call.error is not None:
            raise call.error
        return call.reply


def outcome_of(seed: int, kind, rate: int) -> str:
    """Return the name of the error that connecting ends with, "a device" without one."""
    noise = Noise(Random(f"{seed} {kind.__name__} {rate}"), kind, rate)
    try:
        noise.connect()
    except j2a.J2AError as error:
        return type(error).__name__
    return "a device"


def main() -> int:
    """Connect for each seed, kind and rate; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1000, help="how many (1000)")
    options = parser.parse_args()
    is_bad = False
    for kind in KINDS:
        for rate in RATES:
            if rate == max(RATES) and kind is random_frames:
                continue  # the oracle that makes them is slow
            ends = Counter(outcome_of(seed, kind, rate) for seed in range(options.seeds))
            print(f"{kind.__name__:16}{rate:8} B/s  ", dict(ends), flush=True)
            is_bad = is_bad or "a device" in ends
    return is_bad


if __name__ == "__main__":
    sys.exit(main())
