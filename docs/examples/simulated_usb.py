"""Finds a simulated USB board by pyusb. Takes an image of the port avr-usb."""

import sys

import j2a_transports
import usb.core
from j2a_sim import AvrSim, SimBackend

import j2a

if len(sys.argv) != 2:
    sys.exit(f"usage: python {sys.argv[0]} IMAGE")

backend = SimBackend(AvrSim(sys.argv[1], "atmega32u4"))
device = usb.core.find(idVendor=0x6666, idProduct=0xCAFE, backend=backend)
print(device.manufacturer, device.product, device.serial_number)

[found] = j2a_transports.usb_boards(backend)
print(found.url, "at", f"{found.speed:g} Mbit/s")

with j2a.Client(j2a_transports.open_usb_device(device)) as board:
    print(board.properties["name"], "has", ", ".join(board.functions))
