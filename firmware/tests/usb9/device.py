"""The device under test, and the host's side of it by hand.

In: an ELF file and the name of its chip. Out: control transfers with their ends, single
transactions, frames of the protocol. Rules: all times are simulated ones; the host knows nothing of
the device but what it has read from it.
"""

from __future__ import annotations

from pathlib import Path

from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec import usb
from j2a_spec.oracle import Frame, Incomplete, decode, encode

# bmRequestType: direction, type and recipient (table 9-2).
IN, OUT = 0x80, 0x00
STANDARD, CLASS, VENDOR, RESERVED = 0x00, 0x20, 0x40, 0x60
DEVICE, INTERFACE, ENDPOINT, OTHER = range(4)
# bRequest (table 9-4).
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS = 0, 1, 3, 5
GET_DESCRIPTOR, SET_DESCRIPTOR, GET_CONFIGURATION, SET_CONFIGURATION = 6, 7, 8, 9
GET_INTERFACE, SET_INTERFACE, SYNCH_FRAME = 10, 11, 12
# Feature selectors (table 9-6).
HALT, REMOTE_WAKEUP, TEST_MODE = 0, 1, 2

ADDRESS = 9
CONTROL_MS = 500  # the longest that any stage of a standard request may take (9.2.6.4)
HALF = bytes((c.SOF, 1, 4, 200)) + b"half of a frame"
DEMO = ("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns")
OPCODE = {name: opcode for opcode, name in enumerate((*c.BUILTINS, "a2jGetInterface", *DEMO))}


def setup(kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    """The eight bytes of a SETUP packet (9.3)."""
    numbers = (value, index, length)
    return bytes((kind, request)) + b"".join(number.to_bytes(2, "little") for number in numbers)


class Device:
    """A chip on a bus that has no power yet.

    Attributes:
        sim: the chip.
        bus: its bus.
        packet0: packet size of endpoint 0; 8 until the device descriptor has been read.
        is_torn: a SETUP or a status stage may come while the firmware fills a packet of endpoint 0,
            the rest of which then finds no room; a check that does so says it. Otherwise each
            access to an endpoint's memory has to find a byte, or room for one, see __exit__().
    """

    def __init__(self, elf: Path, mcu: str, boot_ms: float = 30) -> None:
        self.sim = AvrSim(elf, mcu)
        self.bus = self.sim.usb
        self.packet0 = 8
        self.is_torn = False
        self._rest = b""  # the beginning of a frame
        self._heard: list[Frame] = []
        self.pause(boot_ms)

    def close(self) -> None:
        """Free the simulator."""
        self.sim.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        errors = self.bus.counters.fifo_errors
        self.close()
        if error is None and not self.is_torn:
            assert errors == 0, f"{errors} accesses to UEDATX that must not be"

    def pause(self, ms: float) -> None:
        """Let simulated time pass."""
        self.sim.run(self.sim.cycles(ms / 1000))

    # -- states ---------------------------------------------------------------------------------

    def plug(self) -> None:
        """Give the bus power and wait for the pull-up."""
        self.bus.plug()
        assert self.sim.run_until(lambda: self.bus.attached, self.sim.cycles(0.1)), "no pull-up"
        self.pause(100)  # TATTDB: the host waits so long for the contacts

    def reset(self) -> None:
        """Reset by the bus, and the 10 ms that a device has to get ready (7.1.7.5)."""
        self.bus.reset()
        self.pause(10)
        self._forget()

    def to_default(self) -> None:
        """Powered, reset, the packet size of endpoint 0 known."""
        if not self.bus.attached:
            self.plug()
        self.reset()
        self.learn()

    def learn(self) -> None:
        """Read the packet size of endpoint 0 from the first 8 bytes of the device descriptor."""
        self.packet0 = self.get(GET_DESCRIPTOR, usb.DEVICE << 8, length=8)[7]

    def to_address(self, address: int = ADDRESS) -> None:
        """Default, then addressed."""
        self.to_default()
        self.set_address(address)

    def to_configured(self, address: int = ADDRESS) -> None:
        """Addressed, then configured: the bulk endpoints work."""
        self.to_address(address)
        self.configure()

    def set_address(self, address: int) -> None:
        """SET_ADDRESS and the 2 ms after it (9.2.6.3); the host goes on with that address."""
        self.put(SET_ADDRESS, address)
        self.pause(2)
        self.bus.address = address

    def configure(self, value: int = 1) -> None:
        """SET_CONFIGURATION; the host's toggles start anew."""
        self.put(SET_CONFIGURATION, value)
        self.bus.clear_toggle(None)
        self._forget()

    # -- control transfers ------------------------------------------------------------------------

    def control(self, packet: bytes, data: bytes = b"", limit_ms: float = CONTROL_MS):
        """A whole control transfer; returns its completion, None when it has not ended in time."""
        return self.finish(self.bus.submit_control(packet, data, packet=self.packet0), limit_ms)

    def finish(self, transfer: int, limit_ms: float = CONTROL_MS):
        """Wait for a transfer; returns its completion, None (and cancels it) when time is up."""
        end = self.sim.cycle + self.sim.cycles(limit_ms / 1000)
        while self.sim.cycle < end:
            if self.sim.run_until_usb(end - self.sim.cycle):
                for done in self.bus.completed():
                    if done.id == transfer:
                        return done
        self.bus.cancel(transfer)
        self.sim.run_until_usb(self.sim.cycles(0.001))  # a transaction on the wire goes to its end
        for done in self.bus.completed():
            if done.id == transfer and (done.status != "cancelled" or done.data):
                return done
        return None

    def get(self, request: int, value: int = 0, index: int = 0, length: int = 0, to: int = DEVICE):
        """A standard request that is answered with data; returns them."""
        done = self.control(setup(IN | STANDARD | to, request, value, index, length))
        assert done is not None, f"request {request} has no end"
        assert done.status == "ok", f"request {request}: {done.status}"
        assert len(done.data) <= length
        return done.data

    def put(self, request: int, value: int = 0, index: int = 0, to: int = DEVICE) -> None:
        """A standard request without data that is accepted, within 50 ms (9.2.6.4)."""
        done = self.control(setup(OUT | STANDARD | to, request, value, index), limit_ms=50)
        assert done is not None, f"request {request} has no end"
        assert done.status == "ok", f"request {request}: {done.status}"

    def refuses(
        self, kind: int, request: int, value: int = 0, index: int = 0, length: int = 0
    ) -> None:
        """A request error (9.2.7): a stall, which the next request ends."""
        data = b"" if kind & IN else bytes(length)
        what = f"{kind:#04x} {request} {value:#06x} {index:#06x} {length}"
        done = self.control(setup(kind, request, value, index, length), data)
        assert done is not None, f"{what} has no end"
        assert done.status == "stall", f"{what}: {done.status}"
        self.alive()

    def alive(self) -> None:
        """The device answers the next request rightly."""
        done = self.control(setup(IN, GET_DESCRIPTOR, usb.DEVICE << 8, 0, 18))
        assert done is not None
        assert (done.status, len(done.data)) == ("ok", 18)
        usb.device.parse(done.data)

    def status(self, to: int = DEVICE, index: int = 0) -> int:
        """GET_STATUS as a number."""
        data = self.get(GET_STATUS, 0, index, 2, to)
        assert len(data) == 2
        return int.from_bytes(data, "little")

    def halt(self, endpoint: int, on: bool = True) -> None:
        """SET_FEATURE or CLEAR_FEATURE ENDPOINT_HALT; a clear lets the host's toggle start anew."""
        self.put(SET_FEATURE if on else CLEAR_FEATURE, HALT, endpoint, ENDPOINT)
        if not on:
            self.bus.clear_toggle(endpoint)

    # -- single transactions ----------------------------------------------------------------------

    def transact(
        self,
        kind: str,
        endpoint: int = 0,
        data: bytes = b"",
        toggle: int | None = None,
        acknowledge: bool = True,
    ):
        """One transaction that is repeated while it is NAKed; returns handshake and data."""
        end = self.sim.cycle + self.sim.cycles(CONTROL_MS / 1000)
        while True:
            answer = self.bus.transact(kind, endpoint, data, toggle, acknowledge=acknowledge)
            if answer[0] != "NAK" or self.sim.cycle >= end:
                return answer
            self.sim.run(100)

    def once(self, kind: str, endpoint: int = 0, data: bytes = b"", toggle: int | None = None):
        """One transaction; returns its handshake."""
        return self.bus.transact(kind, endpoint, data, toggle)[0]

    def take(self, endpoint: int, toggle: int | None = None) -> bytes:
        """A packet from an endpoint, which has to come with this toggle or that of the host."""
        wrong = self.bus.counters.wrong_toggles
        handshake, data = self.transact("IN", endpoint, toggle=toggle)
        assert handshake == "ACK", f"endpoint {endpoint:#04x}: {handshake}"
        assert self.bus.counters.wrong_toggles == wrong, f"endpoint {endpoint:#04x}: toggle"
        return data

    def lose(self, endpoint: int) -> bytes:
        """A packet from an endpoint whose ACK gets lost; returns it."""
        handshake, data = self.transact("IN", endpoint, acknowledge=False)
        assert handshake == "ACK", f"endpoint {endpoint:#04x}: {handshake}"
        return data

    # -- descriptors ------------------------------------------------------------------------------

    def descriptor(self, kind: int, index: int = 0, language: int = 0) -> bytes:
        """A whole descriptor."""
        return self.get(GET_DESCRIPTOR, kind << 8 | index, language, 255)

    def languages(self) -> list[int]:
        """The language ids of string 0."""
        data = self.descriptor(usb.STRING)[2:]
        return [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]

    def string(self, index: int) -> str:
        """A string in the first language."""
        return str(usb.string.parse(self.descriptor(usb.STRING, index, self.languages()[0])))

    def interfaces(self):
        """The interfaces of the configuration, by the grammar of j2a_spec."""
        return usb.configuration.parse(self.descriptor(usb.CONFIGURATION)).interfaces

    def endpoints(self) -> list[int]:
        """The addresses of all endpoints but 0."""
        return [e.bEndpointAddress for found in self.interfaces() for e in found.endpoints]

    # -- frames -----------------------------------------------------------------------------------

    def send(self, frame: Frame) -> int:
        """Put a frame on the bus; returns the transfer."""
        return self.bus.submit_out(c.USB_OUT, encode(frame))

    def listen(self, count: int, limit_ms: float = 1000, keep: bool = False) -> list[Frame]:
        """So many frames from the device; fewer when time is up.

        Args:
            count: how many.
            limit_ms: how long to wait for them.
            keep: whether the next call returns them again, with those that came since.

        Raises:
            AssertionError: something came that belongs to no frame, or a frame that is broken.
        """
        end = self.sim.cycle + self.sim.cycles(limit_ms / 1000)
        while len(self._heard) < count and self.sim.cycle < end:
            left_ms = (end - self.sim.cycle) / self.sim.frequency_hz * 1000
            done = self.finish(self.bus.submit_in(c.USB_IN, 64), left_ms)
            if done is not None:
                assert done.status in ("ok", "cancelled"), done
                self._hear(done.data)
        found = list(self._heard)
        if not keep:
            self._heard.clear()
        return found

    def _hear(self, data: bytes) -> None:
        self._rest += data
        events = decode(self._rest)
        start = len(self._rest)
        if events and isinstance(events[-1], Incomplete):
            events.pop()
            start = max(self._rest.rfind(bytes((marker,))) for marker in (c.SOF, c.SOS))
        self._rest = self._rest[start:]
        for event in events:
            assert isinstance(event, Frame), event
            self._heard.append(event)

    def _forget(self) -> None:
        self._rest = b""
        self._heard.clear()

    def call(self, function: str, payload: bytes = b"", seq: int = 1) -> Frame:
        """A call and its reply."""
        self.send(Frame(c.SOF, seq, OPCODE[function], payload))
        found = self.listen(1)
        assert found, f"{function} is not answered"
        (reply,) = found
        assert (reply.start, reply.seq) == (c.SOF, seq), reply
        return reply

    def leave_unread(self, payload: bytes = b"unread") -> Frame:
        """An echo whose reply waits in the device; returns that reply."""
        self.bus.write(c.USB_OUT, encode(Frame(c.SOF, 3, OPCODE[c.GET_ECHO], payload)))
        self.pause(2)
        return Frame(c.SOF, 3, c.ECHO, payload)

    def works(self, payload: bytes = b"in both directions") -> None:
        """An echo comes back as it is."""
        reply = self.call(c.GET_ECHO, payload, seq=7)
        assert reply == Frame(c.SOF, 7, c.ECHO, payload)
