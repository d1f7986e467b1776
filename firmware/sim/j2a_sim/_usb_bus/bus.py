"""The USB host of a simulated AVR, at the other end of its cable.

In: transfers, single transactions. Out: what came of them; descriptors.
Rules: the methods of UsbBus itself let simulated time pass until they are done, those of UsbPort
only where they say so; the same calls give the same cycles. The wire is a full-speed bus with this
one device: a transaction takes its time, and the transfers of one endpoint follow one another.
"""

from __future__ import annotations

import struct
from typing import Final

from j2a_sim import _build
from j2a_sim._errors import SimError
from j2a_sim._usb_bus.port import BY_HAND, PACKET, UsbPort
from j2a_sim._usb_bus.records import (
    Completion,
    UsbCounters,
    UsbDescriptors,
    UsbError,
    UsbNoAnswer,
    UsbStall,
    UsbTimeout,
    string_indices,
)

__all__ = [
    "Completion",
    "UsbBus",
    "UsbCounters",
    "UsbDescriptors",
    "UsbError",
    "UsbNoAnswer",
    "UsbStall",
    "UsbTimeout",
]

_TOKENS = {"OUT": 0, "IN": 1, "SETUP": 2}
_DEVICE, _CONFIGURATION, _STRING = 1, 2, 3
_GET_DESCRIPTOR, _SET_ADDRESS, _SET_CONFIGURATION = 6, 5, 9
_ATTACH_S: Final = 1.0
_DEBOUNCE_S: Final = 0.1  # USB 2.0, 7.1.7.3: a device that is attached is not reset before
_RECOVERY_S: Final = 0.01  # and gets so much time after a reset
_ADDRESS_S: Final = 0.002  # and after SET_ADDRESS


class UsbBus(UsbPort):
    """The host; `AvrSim.usb`. Endpoints are given by their address, with 0x80 for IN."""

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

    def read(self, endpoint: int, length: int = PACKET, timeout_s: float = 1.0) -> bytes:
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

        Raises:
            SimError: no such token, toggle, endpoint or address.
        """
        if token not in _TOKENS or toggle not in {None, 0, 1}:
            raise SimError(f"{token!r} with toggle {toggle} is no transaction")
        kind = BY_HAND + _TOKENS[token]
        own = 0 if token == "SETUP" else 255
        options = (own if toggle is None else toggle) + 256 * acknowledge
        packet = max(PACKET, len(data))
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
            raise UsbError(
                f"{sim.program.path} on an {sim.mcu} at {sim.frequency_hz} Hz did not attach "
                f"within {_ATTACH_S} s: {self.lacks}"
            )
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
        languages, strings = self._strings(string_indices(device, whole))
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
