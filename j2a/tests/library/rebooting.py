"""A device that can be replaced by another one while the link stays."""

import threading

import j2a_transports
from j2a_spec import grammar, oracle
from j2a_spec.constants import BOOT, SOF, SOS

from .support import PATIENCE_S


def boot_payload(device, cause=4, count=2):
    return grammar.BOOT.build(
        {"cause": cause, "count": count, "hash": int(device._table.interface_hash, 16)}
    )


class Rebooting:
    """The device's end of a link; requests are executed by the functions of a `j2a.Device`.

    Attributes:
        near: the host's end.
        requests: frames that came, with the device that executed each, or None.
        is_mute: requests are taken and neither executed nor answered.
    """

    def __init__(self, device):
        self.near, self.far = j2a_transports.pair()
        self.device = device
        self.requests = []
        self.is_mute = False
        self._sif_seq = 0
        self._lock = threading.Lock()
        self._came = threading.Condition(self._lock)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self.far.close()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _run(self):
        data = b""
        try:
            while True:
                data += self.far.read(PATIENCE_S)
                *events, data = _split(data)
                for frame in events:
                    with self._lock:
                        self._take(frame)
        except j2a_transports.TransportError:
            pass

    def _take(self, frame):
        executed_by = None
        if not self.is_mute:
            code, payload = self.device._execute(frame.opcode, frame.payload)
            executed_by = self.device
            self._write(oracle.Frame(SOF, frame.seq, code, payload))
        self.requests.append((frame, executed_by))
        self._came.notify_all()

    def _write(self, *frames):
        self.far.write(b"".join(map(oracle.encode, frames)))

    def wait_for_request(self, number):
        with self._came:
            assert self._came.wait_for(lambda: len(self.requests) >= number, PATIENCE_S)
            return self.requests[number - 1][0]

    def sif(self, opcode, payload=b""):
        with self._lock:
            self._sif(opcode, payload)

    def _sif(self, opcode, payload):
        self._write(oracle.Frame(SOS, self._sif_seq, opcode, payload))
        self._sif_seq = (self._sif_seq + 1) % 256

    def skip_sifs(self, number):
        """Count SIFs that the link has lost."""
        self._sif_seq = (self._sif_seq + number) % 256

    def reset(self, device=None, *, says=True, payload=None):
        """Begin anew, with other firmware perhaps, and say so or not."""
        with self._lock:
            self.device = device or self.device
            self.is_mute = False
            self._sif_seq = 0
            if says:
                self._sif(BOOT, boot_payload(self.device) if payload is None else payload)

    def reply(self, frame, code=0, payload=b""):
        with self._lock:
            self._write(oracle.Frame(SOF, frame.seq, code, payload))

    @property
    def executed(self):
        """How many requests have been executed."""
        with self._lock:
            return sum(by is not None for _, by in self.requests)


def _split(data):
    """Return the frames in a stream, and what is left of it."""
    frames, taken = [], 0
    for end in range(1, len(data) + 1):
        events = oracle.decode(data[taken:end])
        if len(events) == 1 and isinstance(events[0], oracle.Frame):
            frames.append(events[0])
            taken = end
    return [*frames, data[taken:]]
