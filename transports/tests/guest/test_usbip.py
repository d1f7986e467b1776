"""A Linux kernel enumerates and uses the simulated chip, over our USB/IP server."""

import socket
import threading

import pytest
from j2a_sim import AvrSim, UsbipServer

from firmware.sim.tests.conftest import Build, firmware

__all__ = ["firmware"]  # a fixture

pytestmark = [pytest.mark.guest, pytest.mark.avr, pytest.mark.exhaustive]


def test_the_kernel_and_the_chip(guest, firmware: Build):
    elfs = [firmware("usb_board", "atmega32u4", SERIAL=ord(letter)) for letter in "AB"]
    said: list[str] = []
    with AvrSim(elfs[0], "atmega32u4") as one, AvrSim(elfs[1], "atmega32u4") as two:
        server = UsbipServer([one, two], port=0, say=said.append)
        stop = threading.Event()
        # Time goes on for the boards while they are served: not before the guest has started.
        door = socket.create_server(("127.0.0.1", 0))
        bell = door.getsockname()

        def serve() -> None:
            door.accept()[0].close()
            server.serve(stop)

        thread = threading.Thread(target=serve)
        thread.start()
        ports = str(server.port), str(bell[1])
        try:
            done = guest("python", "-m", "transports.tests.guest.inside_usbip", *ports)
        finally:
            stop.set()
            socket.create_connection(bell).close()  # a guest that has failed may not have rung
            thread.join(60)
            door.close()
        assert not thread.is_alive()
        print(done.stdout)
        assert done.stdout.splitlines()[1:] == [
            "transfers",
            "reset",
            "configuration",
            "unplugged in mid call",
            "two boards",
            "a board that went by itself",
        ]
        assert not [text for text in said if text.startswith("dropped")], said
        for sim in (one, two):
            assert sim.usb.counters.fifo_errors == 0
