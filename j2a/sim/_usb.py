"""The USB host of a simulated AVR, at the other end of its cable.

In: VBUS, resets, transfers, single transactions. Out: what came of them, with cycles; descriptors.
Rules: `submit_*` takes no simulated time, the transfers go on while the simulator runs, and the
same calls give the same cycles. The other methods that say so let simulated time pass. The wire is
a full-speed bus with this one device: a transaction takes its time, and the transfers of one
endpoint follow one another.
"""

from __future__ import annotations

import ctypes
import struct
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from j2a.sim import _build
from j2a.sim._errors import SimError

if TYPE_CHECKING:
    from j2a.sim._avr import AvrSim

_CONTROL, _OUT, _IN, _BY_HAND = 0, 1, 2, 3
_TOKENS = {"OUT": 0, "IN": 1, "SETUP": 2}
_STATUS = ("ok", "stall", "no_answer", "cancelled", "overflow", "nak")
_OFF, _IDLE, _RESET, _ACTIVE, _SUSPENDED, _RESUMING = range(6)
_PACKET: Final = 64
_DEVICE, _CONFIGURATION, _STRING = 1, 2, 3
_GET_DESCRIPTOR, _SET_ADDRESS, _SET_CONFIGURATION = 6, 5, 9
_ATTACH_S: Final = 1.0
_DEBOUNCE_S: Final = 0.1  # USB 2.0, 7.1.7.3: a device that is attached is not reset before
_RECOVERY_S: Final = 0.01  # and gets so much time after a reset
_ADDRESS_S: Final = 0.002  # and after SET_ADDRESS


class UsbError(SimError):
    """A transfer failed, or there is nobody to talk to."""


class UsbStall(UsbError):  # noqa: N818 - the name says what happened
    """The device answered STALL."""


class UsbNoAnswer(UsbError):  # noqa: N818
    """The device did not answer, three times."""


class UsbTimeout(UsbError):  # noqa: N818
    """The device answered NAK for too long.

    Attributes:
        data: what had come in until then.
    """

    def __init__(self, text: str, data: bytes = b"") -> None:
        super().__init__(text)
        self.data = data


@dataclass(frozen=True, slots=True)
class Completion:
    """What came of a transfer.

    Attributes:
        id: what submit_*() returned.
        status: "ok", "stall", "no_answer", "cancelled" or "overflow" (more came than was asked).
        data: what came in; b"" for OUT.
        transferred: bytes that went in or out, without the setup packet.
        cycle: when the last transaction was over.
        naks: how often the device answered NAK.
    """

    id: int
    status: str
    data: bytes
    transferred: int
    cycle: int
    naks: int


@dataclass(frozen=True, slots=True)
class UsbCounters:
    """Totals since the start.

    Attributes:
        transactions: what was on the wire, starts of frames excepted.
        naks: those that the device answered with NAK.
        sofs: starts of frames.
        bytes_in: bytes that the host took.
        bytes_out: bytes that the device took.
        wrong_toggles: packets dropped by either side because their data toggle was a repetition's.
        fifo_errors: accesses of the firmware to UEDATX with nothing to read, or no room to write.
    """

    transactions: int
    naks: int
    sofs: int
    bytes_in: int
    bytes_out: int
    wrong_toggles: int
    fifo_errors: int


@dataclass(frozen=True, slots=True)
class UsbDescriptors:
    """What a device tells about itself.

    Attributes:
        device: the device descriptor, 18 bytes.
        configuration: the configuration descriptor with all that belongs to it.
        strings: the strings that those two name, by index, in the first language of the device.
        languages: the languages of its strings, such as 0x0409.
    """

    device: bytes
    configuration: bytes
    strings: dict[int, str]
    languages: tuple[int, ...]

    @property
    def packet0(self) -> int:
        """The packet size of endpoint 0."""
        return self.device[7]


def _string_indices(device: bytes, configuration: bytes) -> list[int]:
    found = set(device[14:17])
    at = 0
    while at + 2 <= len(configuration) and configuration[at] >= 2:
        kind = configuration[at + 1]
        if kind == 2:
            found.add(configuration[at + 6])
        elif kind == 4:
            found.add(configuration[at + 8])
        at += configuration[at]
    return sorted(found - {0})


class UsbBus:
    """The host; `AvrSim.usb`. Endpoints are given by their address, with 0x80 for IN.

    Attributes:
        packet0: the packet size of endpoint 0, 8 until enumerate() has learned it.
    """

    def __init__(self, sim: AvrSim, lib: ctypes.CDLL, lock: threading.RLock) -> None:
        self._sim, self._lib, self._lock = sim, lib, lock
        self.packet0 = 8
        self._taken: dict[int, Completion] = {}  # of others, while a method waits for its own

    @property
    def _host(self) -> int:
        return int(self._lib.sim_usb(self._sim._handle))

    # -- the port -----------------------------------------------------------------------------

    def plug(self) -> None:
        """Switch VBUS on; frames begin with the first reset."""
        with self._lock:
            self._lib.usb_host_plug(self._host, 1)

    def unplug(self) -> None:
        """Switch VBUS off: all transfers end with "no_answer"."""
        with self._lock:
            self._lib.usb_host_plug(self._host, 0)

    @property
    def attached(self) -> bool:
        """Whether VBUS is there and the chip has pulled D+ up."""
        return bool(self._lib.usb_host_attached(self._host))

    @property
    def active(self) -> bool:
        """Whether frames go out; else it waits for a reset, is in one, or is suspended."""
        return int(self._lib.usb_host_state(self._host)) == _ACTIVE

    @property
    def suspended(self) -> bool:
        """Whether the bus is suspended; a device can end that by remote wake-up."""
        return int(self._lib.usb_host_state(self._host)) == _SUSPENDED

    def reset(self, ms: float = 10) -> None:
        """Reset the bus, which takes `ms` of simulated time; address and toggles start anew.

        Transfers that were under way end with "cancelled".

        Raises:
            UsbError: nothing is attached, or it went away meanwhile.
        """
        if not self.attached:
            raise UsbError("nothing is attached that could be reset")
        with self._lock:
            self._lib.usb_host_reset(self._host, self._sim.cycles(ms / 1000))
        self._pass(_RESET, "reset")

    def suspend(self) -> None:
        """Stop frames and transfers from now on; the chip notices after 3 ms."""
        with self._lock:
            self._lib.usb_host_suspend(self._host)

    def resume(self) -> None:
        """End suspend, with 20 ms of signalling in simulated time; else nothing happens.

        Raises:
            UsbError: the device went away meanwhile.
        """
        if not self.suspended:
            return
        with self._lock:
            self._lib.usb_host_resume(self._host)
        self._pass(_RESUMING, "resume")

    def _pass(self, state: int, what: str) -> None:
        while self._lib.usb_host_state(self._host) == state:
            self._sim.run(self._sim.cycles(0.0001))
        if not self.active:
            raise UsbError(f"the device went away during the {what}")

    @property
    def frame(self) -> int:
        """The number of the last start of frame, 0..2047."""
        return int(self._lib.usb_host_frame(self._host))

    @property
    def frame_start(self) -> float:
        """The cycle at which that frame began; the chip has it 35 bit times later."""
        return float(self._lib.usb_host_frame_start(self._host))

    @property
    def frame_cycles(self) -> float:
        """Cycles of a frame by the host's clock; settable, from the next frame on."""
        return float(self._lib.usb_host_frame_cycles(self._host))

    @frame_cycles.setter
    def frame_cycles(self, cycles: float) -> None:
        if not 0.5 <= cycles * 1000 / self._sim.frequency_hz <= 2:
            raise SimError(f"frame_cycles {cycles} is not about a millisecond")
        self._lib.usb_host_set_frame_cycles(self._host, cycles)

    @property
    def address(self) -> int:
        """The address that transfers go to, 0..127; settable."""
        return int(self._lib.usb_host_address(self._host))

    @address.setter
    def address(self, address: int) -> None:
        if not 0 <= address <= 127:
            raise SimError(f"USB address {address} is out of range 0..127")
        self._lib.usb_host_set_address(self._host, address)

    def clear_toggle(self, endpoint: int | None = None) -> None:
        """Set the host's data toggle of an endpoint, or of all, to DATA0."""
        self._lib.usb_host_clear_toggle(self._host, -1 if endpoint is None else endpoint)

    @property
    def counters(self) -> UsbCounters:
        """Totals since the start."""
        values = (ctypes.c_uint64 * len(_build.USB_COUNTERS))()
        self._lib.usb_host_counters(self._host, values)
        return UsbCounters(**dict(zip(_build.USB_COUNTERS, values, strict=True)))

    # -- transfers ----------------------------------------------------------------------------

    def _submit(  # noqa: PLR0917 - as the C function
        self,
        kind: int,
        endpoint: int,
        address: int | None,
        packet: int,
        data: bytes | None,
        length: int,
        options: int = 0,
        setup: bytes | None = None,
    ) -> int:
        number = endpoint & 0x7F
        if not 0 <= number <= 15 or not 0 <= endpoint <= 0x8F:
            raise SimError(f"endpoint 0x{endpoint:02x} is no endpoint address")
        if not 1 <= packet <= 1023:
            raise SimError(f"packet size {packet} is out of range 1..1023")
        if address is not None and not 0 <= address <= 127:
            raise SimError(f"USB address {address} is out of range 0..127")
        with self._lock:
            to = -1 if address is None else address
            found = self._lib.usb_host_submit(
                self._host, kind, number, to, packet, setup, data, length, options
            )
            if found < 0:
                raise SimError("out of memory for a USB transfer")
            return int(found)

    def submit_control(
        self,
        setup: bytes,
        data: bytes = b"",
        *,
        address: int | None = None,
        packet: int | None = None,
    ) -> int:
        """Begin a control transfer: setup, data stage, status stage.

        Args:
            setup: the 8 bytes of the setup packet; wLength says how much is read.
            data: what is written, wLength bytes.
            address: None: `address` at the time of each transaction.
            packet: the size of packets; None: `packet0`.

        Returns:
            The transfer's id.

        Raises:
            SimError: setup or data have another length.
        """
        if len(setup) != 8:
            raise SimError(f"a setup packet has 8 bytes, not {len(setup)}")
        length = int.from_bytes(setup[6:8], "little")
        if len(data) != (0 if setup[0] & 0x80 else length):
            raise SimError(f"the setup packet says {length} bytes, and there are {len(data)}")
        size = packet or self.packet0
        return self._submit(_CONTROL, 0, address, size, data or None, length, 0, bytes(setup))

    def submit_out(
        self,
        endpoint: int,
        data: bytes,
        *,
        packet: int = _PACKET,
        zero_packet: bool = False,
        address: int | None = None,
    ) -> int:
        """Begin to write to an endpoint; b"" is one packet without data.

        Args:
            endpoint: its address.
            data: the bytes.
            packet: the size of packets.
            zero_packet: follow up full packets with one without data.
            address: as for submit_control().

        Returns:
            The transfer's id.
        """
        if endpoint & 0x80:
            raise SimError(f"endpoint 0x{endpoint:02x} is an IN endpoint")
        return self._submit(
            _OUT, endpoint, address, packet, bytes(data), len(data), int(zero_packet)
        )

    def submit_in(
        self, endpoint: int, length: int, *, packet: int = _PACKET, address: int | None = None
    ) -> int:
        """Begin to read from an endpoint, until a short packet or `length` bytes have come.

        Args:
            endpoint: its address, with 0x80 or without.
            length: in bytes.
            packet: the size of packets.
            address: as for submit_control().

        Returns:
            The transfer's id.
        """
        return self._submit(_IN, endpoint, address, packet, None, length)

    def cancel(self, id: int) -> None:
        """End a transfer with "cancelled"; nothing happens when it has ended already.

        What it has on the wire goes to its end first, at most 52 us, and may complete it.
        """
        with self._lock:
            self._lib.usb_host_cancel(self._host, id)

    @property
    def pending(self) -> int:
        """How many transfers are under way."""
        return int(self._lib.usb_host_pending(self._host))

    @property
    def readable(self) -> int:
        """How many completions completed() would return."""
        return int(self._lib.usb_host_completed(self._host)) + len(self._taken)

    def _take(self) -> Completion:
        values = (ctypes.c_uint64 * 5)()
        self._lib.usb_host_look(self._host, values)
        number, status, transferred, cycle, naks = values
        data = (ctypes.c_uint8 * transferred)()
        incoming = self._lib.usb_host_take(self._host, data)
        got = bytes(data) if incoming else b""
        return Completion(number, _STATUS[status], got, transferred, cycle, naks)

    def completed(self) -> list[Completion]:
        """Take the transfers that have ended since the last call, in the order of their ends."""
        with self._lock:
            done = list(self._taken.values())
            self._taken.clear()
            for _ in range(int(self._lib.usb_host_completed(self._host))):
                done.append(self._take())
            return done

    # -- blocking in simulated time -----------------------------------------------------------

    def _wait(self, number: int, timeout_s: float, what: str) -> Completion:
        """Run until that transfer has ended; others that end meanwhile are kept."""
        end = self._sim.cycle + self._sim.cycles(timeout_s)
        cancelled = False
        while True:
            with self._lock:
                while self._lib.usb_host_completed(self._host):
                    done = self._take()
                    self._taken[done.id] = done
                if number in self._taken:
                    done = self._taken.pop(number)
                    if done.status == "cancelled" and cancelled:
                        raise UsbTimeout(f"{what}: not done after {timeout_s} s", done.data)
                    return done
                left = end - self._sim.cycle
                if left > 0:
                    self._sim._run(left, _build.STOP_USB)
                elif not cancelled:
                    cancelled = True
                    self.cancel(number)
                else:
                    self._sim._run(self._sim.cycles(0.001), _build.STOP_USB)

    def _finish(self, number: int, timeout_s: float, what: str) -> bytes:
        done = self._wait(number, timeout_s, what)
        if done.status == "stall":
            raise UsbStall(f"{what}: STALL")
        if done.status == "no_answer":
            raise UsbNoAnswer(f"{what}: no answer")
        if done.status != "ok":
            raise UsbError(f"{what}: {done.status}")
        return done.data

    def control(  # noqa: PLR0917 - the fields of a setup packet
        self,
        request_type: int,
        request: int,
        value: int = 0,
        index: int = 0,
        data_or_length: bytes | int = 0,
        timeout_s: float = 5.0,
    ) -> bytes:
        """Make a control transfer in simulated time.

        Args:
            request_type: bmRequestType, with 0x80 to read.
            request: bRequest.
            value: wValue.
            index: wIndex.
            data_or_length: the bytes to write, or how many to read at most.
            timeout_s: simulated seconds that it may take.

        Returns:
            What was read; b"" when nothing was asked for.

        Raises:
            UsbStall, UsbNoAnswer, UsbTimeout: what became of it; UsbError: more came than asked.
        """
        data = b"" if isinstance(data_or_length, int) else bytes(data_or_length)
        length = data_or_length if isinstance(data_or_length, int) else len(data)
        setup = struct.pack("<BBHHH", request_type, request, value, index, length)
        what = f"control request 0x{request_type:02x} {request} 0x{value:04x}"
        return self._finish(self.submit_control(setup, data), timeout_s, what)

    def write(
        self, endpoint: int, data: bytes, timeout_s: float = 1.0, zero_packet: bool = False
    ) -> None:
        """Write to an endpoint in simulated time; arguments as for submit_out(), errors as for
        control()."""
        number = self.submit_out(endpoint, data, zero_packet=zero_packet)
        self._finish(number, timeout_s, f"write to endpoint 0x{endpoint:02x}")

    def read(self, endpoint: int, length: int = _PACKET, timeout_s: float = 1.0) -> bytes:
        """Read from an endpoint in simulated time; arguments as for submit_in(), errors as for
        control()."""
        number = self.submit_in(endpoint, length)
        return self._finish(number, timeout_s, f"read from endpoint 0x{endpoint:02x}")

    def transact(
        self,
        token: str,
        endpoint: int,
        data: bytes = b"",
        toggle: int | None = None,
        address: int | None = None,
        *,
        acknowledge: bool = True,
    ) -> tuple[str | None, bytes]:
        """Make one transaction in simulated time, for odd sequences.

        Args:
            token: "SETUP", "OUT" or "IN".
            endpoint: its number or address.
            data: of SETUP and OUT.
            toggle: 0 or 1; None: the host's own. After an ACK the host goes on from there.
            address: None: `address`.
            acknowledge: False: the host's ACK of an IN gets lost.

        Returns:
            "ACK", "NAK", "STALL" or None (no answer), and the data of IN. A packet of IN with the
            wrong toggle is acknowledged and counted.
        """
        kind = _BY_HAND + _TOKENS[token]
        own = 0 if token == "SETUP" else 255
        options = (own if toggle is None else toggle) + 256 * acknowledge
        packet = max(_PACKET, len(data))
        number = self._submit(kind, endpoint, address, packet, data or None, len(data), options)
        done = self._wait(number, 1.0, token)
        answers = {"ok": "ACK", "nak": "NAK", "stall": "STALL", "no_answer": None}
        if done.status not in answers:
            raise UsbError(f"{token} on endpoint 0x{endpoint:02x}: {done.status}")
        return answers[done.status], done.data

    # -- enumeration --------------------------------------------------------------------------

    def descriptor(self, kind: int, index: int = 0, language: int = 0, length: int = 255) -> bytes:
        """Read a descriptor in simulated time.

        Args:
            kind: its type, such as 1 for the device.
            index: which one.
            language: of a string.
            length: how much to read at most.

        Returns:
            What the device sent; errors as for control().
        """
        return self.control(0x80, _GET_DESCRIPTOR, kind << 8 | index, language, length)

    def enumerate(self, address: int = 1, configuration: int = 1) -> UsbDescriptors:
        """Plug the device in and make it ready, as a host does.

        VBUS, waiting for the pull-up and 100 ms more, reset, the first 8 bytes of the device
        descriptor, SET_ADDRESS, all descriptors and strings, SET_CONFIGURATION.

        Args:
            address: the device's.
            configuration: the value to set; 0: leave it in the address state.

        Returns:
            The descriptors.

        Raises:
            UsbError: nothing was attached within a second; otherwise as for control().
        """
        sim = self._sim
        self.plug()
        if not sim.run_until(lambda: self.attached, sim.cycles(_ATTACH_S)):
            raise UsbError(f"the firmware did not attach within {_ATTACH_S} s")
        sim.run(sim.cycles(_DEBOUNCE_S))
        self.reset()
        sim.run(sim.cycles(_RECOVERY_S))
        self.packet0 = 8
        start = self.descriptor(_DEVICE, length=8)
        if len(start) != 8:
            raise UsbError(f"the device descriptor begins with {len(start)} bytes only")
        self.packet0 = start[7]
        self.control(0, _SET_ADDRESS, address)
        sim.run(sim.cycles(_ADDRESS_S))
        self.address = address
        device = self.descriptor(_DEVICE, length=18)
        head = self.descriptor(_CONFIGURATION, length=9)
        if len(device) != 18 or len(head) != 9:
            raise UsbError("the device or configuration descriptor is too short")
        whole = self.descriptor(_CONFIGURATION, length=head[2] | head[3] << 8)
        languages, strings = self._strings(_string_indices(device, whole))
        if configuration:
            self.control(0, _SET_CONFIGURATION, configuration)
            self.clear_toggle()
        return UsbDescriptors(device, whole, strings, languages)

    def _strings(self, indices: list[int]) -> tuple[tuple[int, ...], dict[int, str]]:
        if not indices:
            return (), {}
        first = self.descriptor(_STRING)[2:]
        languages = struct.unpack(f"<{len(first) // 2}H", first[: len(first) // 2 * 2])
        if not languages:
            raise UsbError("the device has strings in no language")
        texts = {i: self.descriptor(_STRING, i, languages[0])[2:] for i in indices}
        return languages, {i: text.decode("utf-16-le") for i, text in texts.items()}
