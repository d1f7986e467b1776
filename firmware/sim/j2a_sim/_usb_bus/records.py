"""What the simulated USB host tells: errors, ends of transfers, totals, descriptors."""

from __future__ import annotations

from dataclasses import dataclass

from j2a_sim._errors import SimError


class UsbError(SimError):
    """A transfer failed, or no device is attached."""


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


def string_indices(device: bytes, configuration: bytes) -> list[int]:
    """The numbers of the strings that a device and a configuration descriptor name.

    Args:
        device: 18 bytes.
        configuration: with the descriptors that belong to it.

    Returns:
        They, in order, without 0.
    """
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
