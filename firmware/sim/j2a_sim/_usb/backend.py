"""A backend of pyusb whose devices are simulated boards: pyusb's own API without a kernel.

In: the calls of pyusb. Out: what the firmware answers, and the errors that libusb has.
Rules: any number of threads may call at once; each board is run on its own, by a thread that waits
for it (see `driver`), and simulated time passes for a board only while a call for it waits.
Timeouts are in simulated milliseconds, which pass no faster than real ones while nothing moves.
"""

from __future__ import annotations

import array
import errno
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Final, NoReturn

import usb.backend
import usb.core

from j2a_sim._avr import AvrSim
from j2a_sim._errors import SimError
from j2a_sim._usb.descriptors import IN, SETUP, Described
from j2a_sim._usb.driver import UsbHost
from j2a_sim._usb.transfer import CLEAR_FEATURE, SET_CONFIGURATION, SET_INTERFACE, Transfer

BUS: Final = 1
SPEED_FULL: Final = 2  # as libusb counts
ADDRESSES: Final = 127

# Error codes of libusb with the errno and the text that pyusb gives them.
_IO: Final = (-1, errno.EIO, "Input/output error")
_INVALID: Final = (-2, errno.EINVAL, "Invalid parameter")
_NO_DEVICE: Final = (-4, errno.ENODEV, "No such device (it may have been disconnected)")
_NOT_FOUND: Final = (-5, errno.ENOENT, "Entity not found")
_BUSY: Final = (-6, errno.EBUSY, "Resource busy")
_TIMEOUT: Final = (-7, errno.ETIMEDOUT, "Operation timed out")
_OVERFLOW: Final = (-8, errno.EOVERFLOW, "Overflow")
_PIPE: Final = (-9, errno.EPIPE, "Pipe error")
_Error = tuple[int, int, str]
_BY_STATUS: Final[dict[str, _Error]] = {
    "stall": _PIPE,
    "no_answer": _IO,
    "overflow": _OVERFLOW,
    "cancelled": _IO,
    "timeout": _TIMEOUT,
    "invalid": _INVALID,
    "unplugged": _NO_DEVICE,
    "stopped": _IO,
}


def _fail(error: _Error) -> NoReturn:
    code, number, text = error
    kind = usb.core.USBTimeoutError if error is _TIMEOUT else usb.core.USBError
    raise kind(text, code, number)


@dataclass(eq=False)
class _Device:
    """One stay of a board on the bus: a board that comes back is another device.

    Attributes:
        host: its host.
        port: where it is plugged in, from 1.
        address: its address.
        claims: the handle that each interface is claimed by.
    """

    host: UsbHost
    port: int
    address: int
    gone: bool = False
    claims: dict[int, _Handle] = field(default_factory=dict)

    @property
    def alive(self) -> bool:
        return not self.gone and self.host.present

    def configuration(self, index: int) -> Described:
        """The configuration with this index; IndexError when there is none, as pyusb expects."""
        found = self.host.descriptors
        if found is None:
            _fail(_NO_DEVICE)
        return found.configurations[index]


@dataclass(eq=False)
class _Handle:
    """An opened device."""

    device: _Device


def _described(part: Described, **more: object) -> SimpleNamespace:
    return SimpleNamespace(**part.fields, extra_descriptors=list(part.extra), **more)


class SimBackend(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """One or several simulated boards, as a backend for `usb.core.find(backend=...)`.

    The boards are plugged in, enumerated and configured, as an operating system does it.

    Args:
        sims: the simulators; nothing else may run them.
        speed: 0: as fast as possible while something moves on the bus, and real time while nothing
            does; otherwise simulated seconds per second at most.

    Raises:
        SimError: a chip has no USB, or its firmware does not attach or answer.
    """

    def __init__(self, sims: AvrSim | Sequence[AvrSim], *, speed: float = 0.0) -> None:
        super().__init__()
        boards = [sims] if isinstance(sims, AvrSim) else list(sims)
        self._hosts = [UsbHost(sim, speed=speed) for sim in boards]
        self._lock = threading.Lock()  # for what is on the bus, and who has claimed what
        self._last_address = 0
        self._devices: dict[UsbHost, _Device] = {}
        for sim in boards:
            self.plug(sim)

    def plug(self, sim: AvrSim) -> None:
        """Plug a board in, again or for the first time; it gets a new address.

        Raises:
            SimError: the firmware does not attach or answer.
        """
        host = self._host(sim)
        with self._lock:
            taken = {device.address for device in self._devices.values() if device.alive}
            address = self._last_address
            while (address := address % ADDRESSES + 1) in taken:
                pass
            self._last_address = address
        self.unplug(sim)
        host.plug(address)
        with self._lock:
            self._devices[host] = _Device(host, self._hosts.index(host) + 1, address)

    def unplug(self, sim: AvrSim) -> None:
        """Unplug a board: calls that wait for it, and all later ones, fail with ENODEV."""
        host = self._host(sim)
        with self._lock:
            device = self._devices.pop(host, None)
            if device is not None:
                device.gone = True
        host.unplug()

    def _host(self, sim: AvrSim) -> UsbHost:
        for host in self._hosts:
            if host.sim is sim:
                return host
        raise SimError("this simulator is none of the backend's")

    # -- pyusb's interface, documented in usb.backend.IBackend ---------------------------------

    def enumerate_devices(self) -> Iterator[_Device]:
        """Give the boards that are plugged in."""
        with self._lock:
            devices = [device for device in self._devices.values() if device.alive]
        return iter(devices)

    def get_parent(self, dev: _Device) -> None:
        """No hub is simulated."""
        return

    def get_device_descriptor(self, dev: _Device) -> SimpleNamespace:
        """Return the device descriptor with the place of the device."""
        found = dev.host.descriptors
        if found is None:
            _fail(_NO_DEVICE)
        return SimpleNamespace(
            **found.device,
            bus=BUS,
            address=dev.address,
            port_number=dev.port,
            port_numbers=(dev.port,),
            speed=SPEED_FULL,
        )

    def get_configuration_descriptor(self, dev: _Device, config: int) -> SimpleNamespace:
        """Return a configuration by its index."""
        return _described(dev.configuration(config))

    def get_interface_descriptor(
        self, dev: _Device, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return an interface by the indices of it and of its alternate setting."""
        return _described(self._interface(dev, intf, alt, config))

    def get_endpoint_descriptor(
        self, dev: _Device, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return an endpoint by its index."""
        endpoint = self._interface(dev, intf, alt, config).parts[ep]
        return _described(endpoint, bRefresh=0, bSynchAddress=0)

    @staticmethod
    def _interface(dev: _Device, intf: int, alt: int, config: int) -> Described:
        parts = dev.configuration(config).parts
        numbers = list(dict.fromkeys(part.fields.bInterfaceNumber for part in parts))
        settings = [p for p in parts if p.fields.bInterfaceNumber == numbers[intf]]
        return settings[alt]

    def open_device(self, dev: _Device) -> _Handle:
        """Open a device; it may be open more than once."""
        if not dev.alive:
            _fail(_NO_DEVICE)
        return _Handle(dev)

    def close_device(self, dev_handle: _Handle) -> None:
        """Close a device, and give its claimed interfaces free."""
        claims = dev_handle.device.claims
        with self._lock:
            for interface in [i for i, handle in claims.items() if handle is dev_handle]:
                del claims[interface]

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Set a configuration; not while an interface is claimed."""
        device = self._alive(dev_handle)
        if device.claims:
            _fail(_BUSY)
        found = device.host.descriptors
        if config_value and (found is None or found.configuration(config_value) is None):
            _fail(_NOT_FOUND)
        self._control(device, (0x00, SET_CONFIGURATION, config_value, 0))

    def get_configuration(self, dev_handle: _Handle) -> int:
        """Return the value of the configuration that is set; 0: none."""
        return self._alive(dev_handle).host.configuration

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        """Set an alternate setting of a claimed interface."""
        device = self._alive(dev_handle)
        if device.claims.get(intf) is not dev_handle:
            _fail(_NOT_FOUND)
        self._control(device, (0x01, SET_INTERFACE, altsetting, intf))

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Claim an interface, unless another handle has it."""
        device = self._alive(dev_handle)
        found = device.host.descriptors
        active = found and found.configuration(device.host.configuration)
        if not active or intf not in {p.fields.bInterfaceNumber for p in active.parts}:
            _fail(_NOT_FOUND)
        with self._lock:
            if device.claims.setdefault(intf, dev_handle) is not dev_handle:
                _fail(_BUSY)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Give a claimed interface free."""
        device = self._alive(dev_handle)
        with self._lock:
            if device.claims.get(intf) is not dev_handle:
                _fail(_NOT_FOUND)
            del device.claims[intf]

    def bulk_write(
        self, dev_handle: _Handle, ep: int, intf: int, data: array.array[int], timeout: int
    ) -> int:
        """Write to an endpoint; returns how many bytes went before the timeout."""
        transfer = Transfer(ep, data=data.tobytes())
        return self._transfer(self._alive(dev_handle), transfer, timeout).transferred

    def bulk_read(
        self, dev_handle: _Handle, ep: int, intf: int, buff: array.array[int], timeout: int
    ) -> int:
        """Read until a short packet, the end of the buffer, or the timeout; returns how much."""
        transfer = Transfer(ep, length=len(buff) * buff.itemsize)
        return self._fill(buff, self._transfer(self._alive(dev_handle), transfer, timeout))

    # A host controller asks both kinds of endpoints alike; they differ in how often.
    intr_write = bulk_write
    intr_read = bulk_read

    def ctrl_transfer(  # noqa: PLR0917 - pyusb's interface
        self,
        dev_handle: _Handle,
        bmRequestType: int,  # noqa: N803 - pyusb's names
        bRequest: int,  # noqa: N803
        wValue: int,  # noqa: N803
        wIndex: int,  # noqa: N803
        data: array.array[int],
        timeout: int,
    ) -> int:
        """Make a control transfer; returns the bytes of its data stage."""
        length = len(data) * data.itemsize
        to_host = bool(bmRequestType & IN)
        transfer = self._control(
            self._alive(dev_handle),
            (bmRequestType, bRequest, wValue, wIndex),
            length if to_host else data.tobytes(),
            timeout,
        )
        return self._fill(data, transfer) if to_host else length

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """Clear the halt of an endpoint, on both sides."""
        self._control(self._alive(dev_handle), (0x02, CLEAR_FEATURE, 0, ep))

    def reset_device(self, dev_handle: _Handle) -> None:
        """Reset the bus; address and configuration are set again."""
        try:
            self._alive(dev_handle).host.reset()
        except SimError:
            _fail(_NOT_FOUND)

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """There is no kernel."""
        return False

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        """Fail, as there is none to detach."""
        _fail(_NOT_FOUND)

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        """Fail, as there is none to attach."""
        _fail(_NOT_FOUND)

    # -- transfers ----------------------------------------------------------------------------

    @staticmethod
    def _alive(handle: _Handle) -> _Device:
        if not handle.device.alive:
            _fail(_NO_DEVICE)
        return handle.device

    @staticmethod
    def _transfer(device: _Device, transfer: Transfer, timeout_ms: int) -> Transfer:
        """Run a transfer; what it has moved before a timeout is no error, as in libusb."""
        transfer.timeout_s = timeout_ms / 1000 if timeout_ms else None
        device.host.submit(transfer)
        device.host.wait(transfer)
        is_partial = transfer.status == "timeout" and transfer.transferred > 0
        if transfer.status != "ok" and not (is_partial and not transfer.setup):
            _fail(_BY_STATUS[transfer.status])
        return transfer

    def _control(
        self,
        device: _Device,
        request: tuple[int, int, int, int],
        data_or_length: bytes | int = b"",
        timeout_ms: int = 1000,
    ) -> Transfer:
        data = b"" if isinstance(data_or_length, int) else data_or_length
        length = data_or_length if isinstance(data_or_length, int) else len(data_or_length)
        if length > 0xFFFF:
            _fail(_INVALID)
        names = ("bmRequestType", "bRequest", "wValue", "wIndex", "wLength")
        setup = SETUP.build(dict(zip(names, (*request, length), strict=True)))
        transfer = Transfer(0, data=data, length=length, setup=setup)
        return self._transfer(device, transfer, timeout_ms)

    @staticmethod
    def _fill(buffer: array.array[int], transfer: Transfer) -> int:
        memoryview(buffer).cast("B")[: transfer.transferred] = transfer.received
        return transfer.transferred
