"""The files of a gadget: configfs says what the device is, FunctionFS carries its endpoints.

In: identity and strings.  Out: `GadgetFiles`, a device that can be bound to the controller.
Rules: whatever was made is undone, also when a step in between fails; what a killed program left
behind under the same name is removed first, and never what a running one uses (a lock tells) or
what has other functions. Errors of the system become `OpenFailed` with what to do.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import sys
from dataclasses import dataclass
from typing import Final

from j2a_transports._base import OpenFailed

from .descriptors import descriptor_block, string_block
from .kernel import Kernel

# Only a device that has no interrupt endpoint left fails so; the others have a reason of their own.
_NO_ENDPOINT: Final = (errno.EINVAL, errno.ENOTSUP, errno.ENODEV)


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of a device as the host reads it.

    Args:
        name: of the gadget in configfs; one running program per name.
        serial: serial number string.
        vendor: vendor id.
        product: product id.
        manufacturer: manufacturer string.
        product_name: product string.
        udc: name of the device controller, None for the only one.
        sync: whether there is the interface SyncUSB.
    """

    name: str
    serial: str
    vendor: int
    product: int
    manufacturer: str
    product_name: str
    udc: str | None
    sync: bool


class GadgetFiles:
    """A gadget that is set up, with its endpoint files open, not yet bound.

    Args:
        url: for messages.
        identity: what the host is to read.
        kernel: where the files are.

    Attributes:
        control: descriptor of `ep0`, which gives events.
        to_host: descriptor of the endpoint to the host.
        from_host: descriptor of the endpoint from the host.
        sync: descriptor of the endpoint of SyncUSB, None without it.

    Raises:
        OpenFailed: it cannot be set up; the message says what to do.
    """

    def __init__(self, url: str, identity: Identity, kernel: Kernel) -> None:
        self._url = url
        self._identity = identity
        self._kernel = kernel
        name = identity.name
        self._gadgets = kernel.config / "usb_gadget"
        self._folder = self._gadgets / name
        self._function = self._folder / "functions" / f"ffs.{name}"
        self._configuration = self._folder / "configs" / "c.1"
        self._mounted = kernel.run / f"j2a-gadget-{name}"
        self._lock: socket.socket | None = None
        self._opened: list[int] = []
        if sys.platform != "linux":
            raise self._failed("USB gadgets exist on Linux only")
        try:
            self._prepare()
            self.udc = self._find_controller()
            self._take_name()
            self._remove_left_over()
            self._describe()
            self._open_endpoints()
        except OSError as error:
            self.remove()
            raise self._explain(error) from error
        except OpenFailed:
            self.remove()
            raise
        self.control, self.to_host, self.from_host = self._opened[:3]
        self.sync = self._opened[3] if identity.sync else None

    def bind(self) -> None:
        """Connect to the bus.

        Raises:
            OpenFailed: the controller is gone, in use, or has too few endpoints.
        """
        try:
            self._kernel.write(self._folder / "UDC", self.udc)
        except OSError as error:
            if error.errno == errno.EBUSY:
                raise self._failed(self._who_uses()) from error
            if self.udc in self._controllers() and error.errno in _NO_ENDPOINT:
                hint = "; sync=0 makes do with two endpoints" if self._identity.sync else ""
                raise self._failed(
                    f"the controller {self.udc} refuses it: {error.strerror}{hint}"
                ) from error
            raise self._explain(error) from error

    def unbind(self) -> None:
        """Leave the bus, which ends every blocked call on the endpoints; not bound is no error."""
        with contextlib.suppress(OSError):
            self._kernel.write(self._folder / "UDC", "\n")

    def remove(self) -> None:
        """Undo everything; may be called again."""
        if self._lock is None:
            return
        self.unbind()
        for descriptor in reversed(self._opened):
            self._kernel.close(descriptor)
        self._opened.clear()
        # Whatever cannot be removed now is a left-over for the next run, which will tell.
        with contextlib.suppress(OSError):
            self._remove_files()
        self._let_go()

    def _prepare(self) -> None:
        if self._gadgets.is_dir():
            return
        self._kernel.load("libcomposite")
        reason = ""
        if not self._gadgets.is_dir() and not self._kernel.is_mounted(self._kernel.config):
            try:
                self._kernel.mount("configfs", "none", self._kernel.config)
            except PermissionError:
                raise
            except OSError as error:
                reason = f" ({error.strerror})"
        if not self._gadgets.is_dir():
            raise self._failed(
                f"the kernel has no USB gadgets{reason}: "
                "sudo modprobe -a libcomposite usb_f_fs loads them"
            )

    def _controllers(self) -> list[str]:
        with contextlib.suppress(FileNotFoundError):
            return sorted(path.name for path in self._kernel.controllers.iterdir())
        return []

    def _find_controller(self) -> str:
        names, wanted = self._controllers(), self._identity.udc
        if not names:
            raise self._failed(
                "there is no USB device controller: this computer has none, or its driver is not "
                "loaded (Raspberry Pi: dtoverlay=dwc2 in config.txt)"
            )
        if wanted is None and len(names) == 1:
            return names[0]
        if wanted in names:
            return wanted
        which = "choose one of the controllers" if wanted is None else f"there is no {wanted}, but"
        raise self._failed(f"{which}: " + ", ".join(f"udc={name}" for name in names))

    def _take_name(self) -> None:
        self._lock = self._kernel.lock(f"j2a-gadget-{self._identity.name}")
        if self._lock is None:
            raise self._failed(
                f"another program is the gadget {self._identity.name}: end it, or take another "
                "name and controller with name= and udc="
            )

    def _remove_left_over(self) -> None:
        if not self._folder.is_dir():
            return
        functions = [path.name for path in (self._folder / "functions").iterdir()]
        if functions not in ([], [self._function.name]):
            # It stays as it is: the lock goes, and with it what remove() would do.
            self._let_go()
            raise self._failed(
                f"{self._folder} has functions of others ({', '.join(functions)}): "
                "take another name with name="
            )
        self.unbind()
        self._remove_files()

    def _let_go(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _describe(self) -> None:
        make, write, identity = self._kernel.make, self._kernel.write, self._identity
        make(self._folder)
        write(self._folder / "idVendor", f"0x{identity.vendor:04x}")
        write(self._folder / "idProduct", f"0x{identity.product:04x}")
        write(self._folder / "bcdDevice", "0x0100")
        strings = self._folder / "strings" / "0x409"
        make(strings)
        write(strings / "manufacturer", identity.manufacturer)
        write(strings / "product", identity.product_name)
        write(strings / "serialnumber", identity.serial)
        make(self._configuration)
        try:
            make(self._function)
        except FileNotFoundError as error:
            raise self._failed(
                "the kernel has no FunctionFS: sudo modprobe usb_f_fs loads it"
            ) from error
        self._kernel.link(self._function, self._configuration / self._function.name)

    def _open_endpoints(self) -> None:
        self._mounted.mkdir(exist_ok=True)
        self._kernel.mount("functionfs", self._identity.name, self._mounted)
        sync = self._identity.sync
        self._opened.append(self._kernel.open(self._mounted / "ep0"))
        for block in (descriptor_block(sync=sync), string_block(sync=sync)):
            self._kernel.send(self._opened[0], block)
        for number in range(1, 4 if sync else 3):
            self._opened.append(self._kernel.open(self._mounted / f"ep{number}"))

    def _remove_files(self) -> None:
        """Remove what `_describe` and `_open_endpoints` make, as far as it is there."""
        if self._mounted.is_dir():
            if self._kernel.is_mounted(self._mounted):
                self._kernel.unmount(self._mounted)
            self._mounted.rmdir()
        if not self._folder.is_dir():
            return
        with contextlib.suppress(FileNotFoundError):
            self._kernel.unlink(self._configuration / self._function.name)
        folders = (
            self._configuration,
            self._function,
            self._folder / "strings" / "0x409",
            self._folder,
        )
        for folder in folders:
            if folder.is_dir():
                self._kernel.remove(folder)

    def _who_uses(self) -> str:
        for path in sorted(self._gadgets.iterdir()):
            if path != self._folder and self._kernel.read(path / "UDC") == self.udc:
                return (
                    f"the controller {self.udc} is used by the gadget {path.name}; "
                    f"free it with: echo | sudo tee {path / 'UDC'}"
                )
        driver = self._kernel.read(self._kernel.controllers / self.udc / "function")
        return (
            f"the controller {self.udc} is used by {driver or 'another driver'}; unload that "
            "module (sudo modprobe -r), such as g_serial or g_ether"
        )

    def _explain(self, error: OSError) -> OpenFailed:
        if isinstance(error, PermissionError):
            return self._failed("the system does not allow it, as in a container without rights")
        where = f" ({error.filename})" if error.filename else ""
        return self._failed(f"cannot make the USB gadget: {error.strerror}{where}")

    def _failed(self, reason: str) -> OpenFailed:
        # Without root the rest of the advice does not help.
        if not self._kernel.is_root():
            reason = f"a USB gadget is made by root: run it as root, with sudo; as it is, {reason}"
        return OpenFailed(f"{self._url}: {reason}")
