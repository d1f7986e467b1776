"""Control transfers by single transactions: stages, toggles, and early ends (8.5.3)."""

from j2a_spec import constants as c
from j2a_spec import usb

from firmware.tests.usb9.checks import Check, listing
from firmware.tests.usb9.device import (
    GET_CONFIGURATION,
    GET_DESCRIPTOR,
    GET_STATUS,
    IN,
    OUT,
    SET_ADDRESS,
    SET_CONFIGURATION,
    SET_DESCRIPTOR,
    VENDOR,
    Device,
    setup,
)

CHECKS: list[Check] = []
check = listing(CHECKS)

SIZE = 9 + 9 + 7 + 7 + 9 + 7  # of the configuration: two interfaces, three endpoints
LONG = setup(IN, GET_DESCRIPTOR, usb.CONFIGURATION << 8, 0, 255)
SHORT = setup(IN, GET_STATUS, 0, 0, 2)
REFUSED = setup(IN | VENDOR, 1, 0, 0, 8)


@check("8.4.6.4")
def setup_is_always_taken(device: Device) -> None:
    """A SETUP is acknowledged in each stage of the transfer before, and after a stall."""
    device.is_torn = True
    device.to_address()
    for _ in range(3):
        for packet in (LONG, SHORT, REFUSED, setup(OUT, SET_CONFIGURATION, 0)):
            for stage in ("", "IN", "OUT"):
                assert device.once("SETUP", 0, packet) == "ACK"
                if stage:
                    device.once(stage, 0, toggle=1)
    device.pause(0.05)  # see setup_twice
    device.alive()


@check("8.5.3")
def setup_repeated(device: Device) -> None:
    """A SETUP that comes again, at whatever cycle, because its ACK was lost is served once."""
    device.is_torn = True
    device.to_configured()
    whole = device.descriptor(usb.CONFIGURATION)
    for wait in range(0, 900, 4):
        for _ in range(2):
            assert device.once("SETUP", 0, LONG) == "ACK"
            device.sim.run(wait)
        got, toggle = b"", 1
        while len(got) < SIZE:
            got, toggle = got + device.take(0, toggle), toggle ^ 1
        assert got == whole, f"{wait} cycles"
        for _ in range(2):
            assert device.once("SETUP", 0, REFUSED) == "ACK"
            device.sim.run(wait)
        assert device.transact("IN", 0, toggle=1)[0] == "STALL", f"{wait} cycles"


@check("5.5.5")
def setup_twice(device: Device) -> None:
    """Of different SETUPs the last one counts, also when it comes 50 us after the one before."""
    device.is_torn = True
    device.to_configured()
    ask = setup(IN, GET_CONFIGURATION, 0, 0, 1)
    for before in (LONG, REFUSED, setup(OUT, SET_CONFIGURATION, 1)):
        for wait in (*range(800, 1100, 4), 3000, 20000):
            for _ in range(wait % 3 + 1):
                assert device.once("SETUP", 0, before) == "ACK"
                device.sim.run(wait)
            assert device.once("SETUP", 0, ask) == "ACK"
            assert device.take(0, 1) == b"\1", f"{wait} cycles after {before.hex()}"
            assert device.transact("OUT", 0, b"", 1)[0] == "ACK"


@check("5.5.5")
def setup_in_the_data_stage(device: Device) -> None:
    """A SETUP in the data stage begins a new transfer; nothing of the old one comes."""
    device.is_torn = True
    device.to_configured()
    for wait in (0, 200, 5000):
        for packets in range(4):
            device.once("SETUP", 0, LONG)
            for number in range(min(packets, SIZE // device.packet0)):
                device.take(0, 1 - number % 2)
            device.sim.run(wait)
            assert device.once("SETUP", 0, SHORT) == "ACK"
            assert len(device.take(0, 1)) == 2
            assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
            device.alive()


@check("5.5.5")
def setup_in_the_status_stage(device: Device) -> None:
    """A SETUP instead of the status stage is a new request, in both directions."""
    device.to_configured()
    for wait in (0, 200, 5000):
        device.once("SETUP", 0, SHORT)
        assert len(device.take(0, 1)) == 2
        device.sim.run(wait)
        device.alive()
        device.once("SETUP", 0, setup(OUT, SET_CONFIGURATION, 1))
        device.sim.run(wait)
        device.alive()


@check("8.5.3")
def early_status_stage(device: Device) -> None:
    """The host may end a data stage early: its empty OUT packet is taken, the rest forgotten."""
    device.is_torn = True
    device.to_configured()
    for packets in range(4):
        device.once("SETUP", 0, LONG)
        for number in range(min(packets, SIZE // device.packet0)):
            device.take(0, 1 - number % 2)
        assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
        device.pause(1)
        device.alive()
        assert len(device.descriptor(usb.CONFIGURATION)) == SIZE


@check("8.5.3")
def toggles(device: Device) -> None:
    """The data stage begins with DATA1, and so does each status stage."""
    device.to_address()
    device.once("SETUP", 0, LONG)
    got, toggle = b"", 1
    while len(got) < SIZE:
        got, toggle = got + device.take(0, toggle), toggle ^ 1
    if SIZE % device.packet0 == 0:
        assert device.take(0, toggle) == b""
    assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
    device.once("SETUP", 0, setup(OUT, SET_CONFIGURATION, 1))
    assert device.take(0, 1) == b""


@check("8.5.3.1")
def status_after_the_work(device: Device) -> None:
    """When the status stage of SET_CONFIGURATION has ended, the endpoints work."""
    device.to_address()
    device.once("SETUP", 0, setup(OUT, SET_CONFIGURATION, 1))
    assert device.take(0, 1) == b""
    device.bus.clear_toggle(None)
    assert device.once("IN", c.USB_IN) == "NAK"
    assert device.once("OUT", c.USB_OUT, b"at once", 0) == "ACK"


@check("8.6.4")
def status_again(device: Device) -> None:
    """The status stage of the host, repeated because its handshake was lost, is acknowledged."""
    device.to_configured()
    device.once("SETUP", 0, SHORT)
    device.take(0, 1)
    assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
    assert device.once("OUT", 0, b"", 1) in ("ACK", "STALL", "NAK")
    device.alive()


@check("8.6.4")
def lost_acknowledgements(device: Device) -> None:
    """A packet of the data stage whose acknowledgement is lost comes again, with its toggle."""
    device.to_configured()
    whole = device.descriptor(usb.CONFIGURATION)
    device.once("SETUP", 0, LONG)
    got, toggle = b"", 1
    while len(got) < SIZE:
        for _ in range(3):
            lost = device.lose(0)
        assert device.take(0, toggle) == lost
        got, toggle = got + lost, toggle ^ 1
    assert got == whole
    device.alive()


@check("8.5.3.3")
def last_acknowledgement_lost(device: Device) -> None:
    """The status stage of the host tells that it has the last packet, whose ACK was lost."""
    device.to_configured()
    device.once("SETUP", 0, SHORT)
    assert len(device.lose(0)) == 2
    assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
    device.alive()
    assert device.get(GET_CONFIGURATION, length=1) == b"\1"


@check("8.5.3")
def data_that_were_not_announced(device: Device) -> None:
    """Data from the host in a request that has none do no harm."""
    device.to_configured()
    for packet in (setup(OUT, SET_CONFIGURATION, 1), SHORT, LONG, setup(OUT, SET_ADDRESS, 9)):
        device.once("SETUP", 0, packet)
        for toggle in (1, 0, 1):
            device.once("OUT", 0, b"notasked", toggle)
            device.sim.run(300)
        device.alive()
    device.to_configured()
    device.works()


@check("8.5.3")
def more_than_announced(device: Device) -> None:
    """An IN beyond the end of the data stage, and data for a refused request, do no harm."""
    device.to_configured()
    device.once("SETUP", 0, SHORT)
    device.take(0, 1)
    for toggle in (0, 1):
        device.once("IN", 0, toggle=toggle)
    device.alive()
    device.once("SETUP", 0, setup(OUT, SET_DESCRIPTOR, 0x0100, 0, 4))
    for toggle in (1, 0, 1, 0):
        device.once("OUT", 0, bytes(device.packet0), toggle)
    device.alive()
    device.works()


@check("8.5.3")
def setup_of_other_lengths(device: Device) -> None:
    """SETUP packets that are not 8 bytes long do no harm."""
    device.to_configured()
    for length in (0, 1, 4, 7):
        device.once("SETUP", 0, LONG[:length])
        device.pause(1)
        device.once("IN", 0, toggle=1)
        device.alive()
    device.works()


@check("5.5.5")
def stages_without_setup(device: Device) -> None:
    """IN and OUT at endpoint 0 without a SETUP before them do no harm."""
    device.to_configured()
    for _ in range(3):
        device.once("IN", 0, toggle=1)
        device.once("OUT", 0, b"x", 1)
        device.once("OUT", 0, b"", 0)
        device.alive()
    device.works()


@check("9.2.6.4")
def slow_host(device: Device) -> None:
    """A host may take its time between the stages, here half a second."""
    device.to_address()
    device.once("SETUP", 0, LONG)
    got, toggle = b"", 1
    while len(got) < SIZE:
        device.pause(500 * device.packet0 / SIZE)
        got, toggle = got + device.take(0, toggle), toggle ^ 1
    if SIZE % device.packet0 == 0:
        assert device.take(0, toggle) == b""
    device.pause(500)
    assert device.transact("OUT", 0, b"", 1)[0] == "ACK"
    assert got == device.descriptor(usb.CONFIGURATION)
