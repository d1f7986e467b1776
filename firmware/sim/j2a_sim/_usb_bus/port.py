"""The port of the simulated USB host and its transfers, as they are begun and ended.

In: VBUS, resets, suspend, transfers. Out: their ends, with cycles.
Rules: beginning a transfer takes no simulated time; it goes on while the simulator runs.
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from j2a_sim import _build
from j2a_sim._core import AvrCore
from j2a_sim._errors import SimError
from j2a_sim._usb_bus.records import Completion, UsbCounters, UsbError

_CONTROL, _OUT, _IN, BY_HAND = 0, 1, 2, 3
_STATUS = ("ok", "stall", "no_answer", "cancelled", "overflow", "nak")
_FRAMES, _LOST = 2048, 0x10000
_OFF, _IDLE, _RESET, _ACTIVE, _SUSPENDED, _RESUMING = range(6)
PACKET: Final = 64
_LENGTH_MAX: Final = 2**31 - 1
# Why a chip is not attached, in the order of usb_device_lacks().
_NOT_ON: Final = "the firmware never switched USB on: was it built with USB, and for this MCU?"
LACKS: Final = (
    "",
    "the PLL that clocks USB does not lock: was it built for another crystal or MCU?",
    _NOT_ON,
    "the firmware keeps itself detached from the bus (DETACH in UDCON)",
    "its pads have no power or see no VBUS (UVREGE in UHWCON, OTGPADE in USBCON, REGCR), "
    "or are set to low speed",
)


class UsbPort:
    """The port of the host, and the transfers; see UsbBus.

    Attributes:
        packet0: the packet size of endpoint 0, 8 until enumerate() has learned it.
        BYTE_COUNT_MODELS: see counting.
        SUSPEND_FLAGS: see suspend_flags.
    """

    BYTE_COUNT_MODELS: Final = ("bank", "banks", "setup as 0", "setup as 8")
    SUSPEND_FLAGS: Final = ("exclusive", "independent")

    def __init__(self, sim: AvrCore, lib: ctypes.CDLL, lock: threading.RLock) -> None:
        self._sim, self._lib, self._lock = sim, lib, lock
        self.packet0 = 8
        self._counting = self.BYTE_COUNT_MODELS[0]
        self._suspend_flags = self.SUSPEND_FLAGS[0]
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
    def lacks(self) -> str:
        """Why the chip pulls no line up, as a sentence; "" when it does."""
        return LACKS[self._lib.usb_host_lacks(self._host)]

    @property
    def switched_on(self) -> bool:
        """Whether the firmware has begun to use USB."""
        return self.lacks != _NOT_ON

    @property
    def counting(self) -> str:
        """How the chip's UEBCLX counts where the data sheet leaves it open; settable.

        "bank": what the CPU has read or written of its bank; firmware should bear the others, too.
        "banks": for an IN endpoint also what waits in its other bank. "setup as 0", "setup as 8":
        for a SETUP always the same number.
        """
        return self._counting

    @counting.setter
    def counting(self, name: str) -> None:
        if name not in self.BYTE_COUNT_MODELS:
            raise SimError(f"counting {name!r} is none of {', '.join(self.BYTE_COUNT_MODELS)}")
        self._counting = name
        with self._lock:
            self._lib.usb_host_set_counting(self._host, self.BYTE_COUNT_MODELS.index(name))

    @property
    def suspend_flags(self) -> str:
        """How the chip's SUSPI and WAKEUPI act on each other; settable.

        "exclusive": each clears the other when it is set, as the data sheet says and firmware such
        as LUFA's needs. "independent": firmware clears them; it should bear that, too.
        """
        return self._suspend_flags

    @suspend_flags.setter
    def suspend_flags(self, name: str) -> None:
        if name not in self.SUSPEND_FLAGS:
            raise SimError(f"suspend_flags {name!r} is none of {', '.join(self.SUSPEND_FLAGS)}")
        self._suspend_flags = name
        with self._lock:
            self._lib.usb_host_set_suspend_flags(self._host, self.SUSPEND_FLAGS.index(name))

    @property
    def enabled(self) -> bool:
        """Whether the host has reset the device that is attached; one that was away for 2.5 us
        needs another reset."""
        return int(self._lib.usb_host_state(self._host)) not in {_OFF, _IDLE}

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

    def plan_frames(
        self, starts: Sequence[float], numbers: Sequence[int], lost: Sequence[bool] | None = None
    ) -> None:
        """Say when the next frames start, such as those of a bus that several chips are on.

        Takes the place of what was planned. Behind the last start frames go on every
        `frame_cycles`, and starts that have passed when a reset or a resume ends are left out.

        Args:
            starts: the cycles, rising; the first one behind `frame_start`.
            numbers: of the frames, 0..2047.
            lost: which starts the chip does not see; None: it sees all.

        Raises:
            SimError: the lengths differ, or starts do not rise.
        """
        count = len(starts)
        losses = [False] * count if lost is None else lost
        if len(numbers) != count or len(losses) != count:
            raise SimError(f"{count} frames start, and there are {len(numbers)} numbers")
        if not all(map(math.isfinite, starts)) or any(b <= a for a, b in pairwise(starts)):
            raise SimError("the starts of frames do not rise")
        packed = [n % _FRAMES + _LOST * bool(x) for n, x in zip(numbers, losses, strict=True)]
        with self._lock:
            if self._lib.usb_host_plan_frames(
                self._host,
                (ctypes.c_double * count)(*starts),
                (ctypes.c_uint32 * count)(*packed),
                count,
            ):
                raise SimError("out of memory for the starts of frames")

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
        if not 0 <= length <= _LENGTH_MAX:
            raise SimError(f"a transfer of {length} bytes is out of range 0..{_LENGTH_MAX}")
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
        packet: int = PACKET,
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
        self, endpoint: int, length: int, *, packet: int = PACKET, address: int | None = None
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
