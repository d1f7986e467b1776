"""A bus for USB devices in memory, behind pyusb's backend interface.

In: the devices of `fake_usb`.  Out: a backend for `usb.core`.
Rules: what is unplugged answers nothing; an interface has one owner; a transfer times out as
libusb's do.
"""

from __future__ import annotations

import array
import errno
import time
from types import SimpleNamespace
from typing import Any

import usb.backend

from .fake_usb import FakeDevice, Job, usb_error


class FakeBackend(usb.backend.IBackend):
    """A bus with these devices; what the host asks for is noted in `FakeDevice.calls`.

    Attributes:
        devices: those that are on it.
        broken: whether the devices cannot be listed.
    """

    def __init__(self, *devices: FakeDevice) -> None:
        self.devices = list(devices)
        self.broken = False

    def _ask(self, device: FakeDevice, *call: Any) -> None:
        device.calls.append(call)
        if device.gone:
            raise usb_error(errno.ENODEV)
        if call[0] in device.refuses:
            raise device.refuses[call[0]]

    def enumerate_devices(self) -> list[FakeDevice]:
        if self.broken:
            raise usb_error(errno.EIO)
        return [device for device in self.devices if not device.gone]

    def get_device_descriptor(self, dev: FakeDevice) -> SimpleNamespace:
        if dev.gone:
            raise usb_error(errno.ENODEV)
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x200,
            bDeviceClass=0,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=dev.vendor,
            idProduct=dev.product,
            bcdDevice=0x100,
            iManufacturer=1,
            iProduct=2,
            iSerialNumber=0 if dev.serial is None else 3,
            bNumConfigurations=1,
            bus=dev.bus,
            address=dev.address,
            port_number=None if dev.ports is None else dev.ports[-1],
            port_numbers=dev.ports,
            speed=dev.speed,
        )

    def get_configuration_descriptor(self, dev: FakeDevice, config: int) -> SimpleNamespace:
        if "get_configuration_descriptor" in dev.refuses:
            raise dev.refuses["get_configuration_descriptor"]
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=0,
            bNumInterfaces=len({each.bInterfaceNumber for each in dev.interfaces}),
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=50,
            extra_descriptors=[],
        )

    def get_interface_descriptor(self, dev: FakeDevice, intf: int, alt: int, config: int) -> Any:
        numbers = sorted({each.bInterfaceNumber for each in dev.interfaces})
        settings = [
            each
            for each in dev.interfaces
            if intf < len(numbers) and each.bInterfaceNumber == numbers[intf]
        ]
        return settings[alt]

    def get_endpoint_descriptor(
        self, dev: FakeDevice, ep: int, intf: int, alt: int, config: int
    ) -> Any:
        return self.get_interface_descriptor(dev, intf, alt, config).endpoints[ep]

    def open_device(self, dev: FakeDevice) -> SimpleNamespace:
        self._ask(dev, "open_device")
        if dev.denied:
            raise usb_error(errno.EACCES)
        dev.handles += 1
        return SimpleNamespace(dev=dev, handle=id(dev))

    def close_device(self, dev_handle: Any) -> None:
        dev_handle.dev.calls.append(("close_device",))
        dev_handle.dev.handles -= 1

    def set_configuration(self, dev_handle: Any, config_value: int) -> None:
        self._ask(dev_handle.dev, "set_configuration", config_value)
        dev_handle.dev.configuration = config_value

    def get_configuration(self, dev_handle: Any) -> int:
        self._ask(dev_handle.dev, "get_configuration")
        return dev_handle.dev.configuration

    def set_interface_altsetting(self, dev_handle: Any, intf: int, altsetting: int) -> None:
        self._ask(dev_handle.dev, "set_interface_altsetting", intf, altsetting)

    def claim_interface(self, dev_handle: Any, intf: int) -> None:
        self._ask(dev_handle.dev, "claim_interface", intf)
        if intf in dev_handle.dev.busy | dev_handle.dev.drivers:
            raise usb_error(errno.EBUSY)
        dev_handle.dev.busy.add(intf)

    def release_interface(self, dev_handle: Any, intf: int) -> None:
        dev_handle.dev.busy.discard(intf)
        self._ask(dev_handle.dev, "release_interface", intf)

    def _run(self, dev_handle: Any, ep: int, data: bytes | int, timeout: int) -> Job:
        device = dev_handle.dev
        job = Job(device.pipes[ep], data)
        deadline = time.monotonic() + timeout / 1000
        with device.changed:
            while not job.step():
                if not device.changed.wait(deadline - time.monotonic()):
                    if not job.done:
                        raise usb_error(errno.ETIMEDOUT)
                    break
        return job

    def bulk_write(self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int) -> int:
        return self._run(dev_handle, ep, bytes(data), timeout).done

    def bulk_read(self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        job = self._run(dev_handle, ep, len(buff), timeout)
        buff[: job.done] = array.array("B", job.data)
        return job.done

    # pyusb chooses by the descriptor; that the right one is chosen shows in `calls`.
    def intr_write(self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int) -> int:
        dev_handle.dev.calls.append(("intr_write", ep))
        return self.bulk_write(dev_handle, ep, intf, data, timeout)

    def intr_read(self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        return self.bulk_read(dev_handle, ep, intf, buff, timeout)

    def ctrl_transfer(
        self, dev_handle: Any, request_type: int, request: int, value: int, *rest: Any
    ) -> int:
        """Answer GET_DESCRIPTOR for strings."""
        device = dev_handle.dev
        self._ask(device, "ctrl_transfer", request, value)
        texts = ["", "J2A", "demo board", device.serial or ""]
        index = value & 0xFF
        body = b"\x09\x04" if index == 0 else texts[index].encode("utf-16-le")
        answer = bytes([len(body) + 2, 3]) + body
        data = rest[1]
        data[: len(answer)] = array.array("B", answer)
        return len(answer)

    def clear_halt(self, dev_handle: Any, ep: int) -> None:
        self._ask(dev_handle.dev, "clear_halt", ep)
        with dev_handle.dev.changed:
            dev_handle.dev.pipes[ep].halted = False
            dev_handle.dev.changed.notify_all()

    def is_kernel_driver_active(self, dev_handle: Any, intf: int) -> bool:
        self._ask(dev_handle.dev, "is_kernel_driver_active", intf)
        return intf in dev_handle.dev.drivers

    def detach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        self._ask(dev_handle.dev, "detach_kernel_driver", intf)
        dev_handle.dev.drivers.discard(intf)

    def attach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        self._ask(dev_handle.dev, "attach_kernel_driver", intf)
        dev_handle.dev.drivers.add(intf)
