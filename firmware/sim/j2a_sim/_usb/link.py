"""A transport into the USB of simulated firmware, in this process: `sim:fw.elf?link=usb`.

In: bytes for the firmware. Out: what it answers. Time and waiting are those of `_timed_link`.
Rules: the host plugs and enumerates the chip and finds the interface of a board by its class; its
transfers towards the host are always submitted, several packets long, so a firmware that does not
end what it sends with a short packet is not heard, as at a real host; a write is one transfer, to a
bulk endpoint with a packet of no bytes at the end when its last packet is a full one. A stall, a
packet that is too long, or a chip that does not answer any more ends the link.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

from j2a_spec import constants as c
from j2a_spec.usb import BULK, INTERRUPT

from j2a_sim._errors import SimError
from j2a_sim._timed_link import TimedLink
from j2a_sim._usb.descriptors import IN, PACKET_MASK, TYPE_MASK, Described, parse_configuration

# Of the interface that carries frames.
BOARD: Final = (c.USB_CLASS, c.USB_SUBCLASS, c.USB_PROTOCOL)
# Two transfers, so that the next one is there when one ends, as at a host with more than one
# request block; each of several packets.
TRANSFERS: Final = 2
TRANSFER_PACKETS: Final = 8
CONFIGURATION: Final = 1
# bmRequestType, bRequest and wValue of CLEAR_FEATURE(ENDPOINT_HALT).
CLEAR_HALT: Final = (0x02, 1, 0)
_WHY: Final = {
    "stall": "the board stalled endpoint 0x{:02x}",
    "no_answer": "the board does not answer on endpoint 0x{:02x}: unplugged, or not configured",
    "overflow": "a packet of endpoint 0x{:02x} was longer than its descriptor allows",
    "cancelled": "a bus reset or the end of the power cancelled the transfers of 0x{:02x}",
}


class LinkEndpoint(NamedTuple):
    """An endpoint of a link: its address, its largest packet in bytes, whether it is a bulk one."""

    address: int
    packet: int
    bulk: bool


def find_endpoints(configuration: Described) -> tuple[LinkEndpoint, LinkEndpoint]:
    """Find the endpoints of a board's interface.

    Args:
        configuration: what the device has told.

    Returns:
        The endpoint to the host, then that to the board.

    Raises:
        SimError: there is no interface FF/12/EF with two such endpoints.
    """
    for interface in configuration.parts:
        i = interface.fields
        if (i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol) != BOARD:
            continue
        usable = [
            LinkEndpoint(
                e.fields.bEndpointAddress,
                e.fields.wMaxPacketSize & PACKET_MASK,
                e.fields.bmAttributes & TYPE_MASK == BULK,
            )
            for e in interface.parts
            if e.fields.bmAttributes & TYPE_MASK in {BULK, INTERRUPT}
        ]
        to_host = [e for e in usable if e.address & IN]
        to_board = [e for e in usable if not e.address & IN]
        if to_host and to_board:
            return to_host[0], to_board[0]
        raise SimError("the interface FF/12/EF lacks a bulk endpoint in one direction")
    raise SimError("the firmware has no USB interface of class FF, subclass 12, protocol EF")


class UsbLink(TimedLink):
    """The USB of a simulated AVR as a transport.

    A read returns what one transfer has brought, at most 8 packets.

    Args:
        sim: the simulator; the chip is plugged in, enumerated and configured here.
        url: for messages.
        patience_s: see SimLink.
        speed: see SimLink.

    Attributes:
        sim: the simulator; `sim.usb` is the bus, which must not be given other transfers.

    Raises:
        SimError: the chip has no USB, or the firmware does not attach, answer, or describe itself
            as a board.
    """

    def _set_up(self) -> None:
        self._bus = self.sim.usb
        found = self._bus.enumerate(configuration=CONFIGURATION)
        to_host, to_board = find_endpoints(parse_configuration(found.configuration))
        self._in, self._in_packet, _ = to_host
        self._out, self._out_packet, self._out_is_bulk = to_board
        for endpoint in (self._in, self._out):
            self._bus.control(*CLEAR_HALT, endpoint)
            self._bus.clear_toggle(endpoint)
        self._transfers: dict[int, int] = {}  # id: endpoint
        self._came: deque[bytes] = deque()
        for _ in range(TRANSFERS):
            self._listen()

    def _listen(self) -> None:
        length = self._in_packet * TRANSFER_PACKETS
        self._transfers[self._bus.submit_in(self._in, length, packet=self._in_packet)] = self._in

    def _send(self, data: bytes) -> None:
        if data:
            # An interrupt endpoint gets no empty packet (USB-015).
            full = self._out_is_bulk and len(data) % self._out_packet == 0
            number = self._bus.submit_out(
                self._out, data, packet=self._out_packet, zero_packet=full
            )
            self._transfers[number] = self._out

    @property
    def _readable(self) -> bool:
        return bool(self._came)

    def _run_until_readable(self, cycles: int) -> None:
        self.sim.run_until_usb(cycles, wakeable=True)
        self._sort()

    def _run(self, cycles: int) -> None:
        # Not further than a transfer, so that the next one is submitted in time.
        self._run_until_readable(cycles)

    def _sort(self) -> None:
        """Take the completed transfers: keep what came, submit anew, end at a fault."""
        fault = ""
        for done in self._bus.completed():
            endpoint = self._transfers.pop(done.id, None)
            if endpoint is None:
                continue
            if endpoint & IN and done.data:
                self._came.append(bytes(done.data))
            if done.status != "ok":
                fault = fault or _WHY[done.status].format(endpoint)
            elif endpoint & IN:
                self._listen()
        if fault:
            raise SimError(fault)
        if not self._bus.enabled:
            raise SimError("the board is unplugged")

    def _collect(self) -> bytes:
        return self._came.popleft()
