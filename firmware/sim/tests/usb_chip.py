"""A simulated chip whose registers a test reads and writes, by a firmware that does as told."""

from j2a_sim import AvrSim

UHWCON, USBCON, USBSTA, USBINT = 0xD7, 0xD8, 0xD9, 0xDA
UDCON, UDINT, UDIEN, UDADDR, UDFNUML, UDFNUMH = 0xE0, 0xE1, 0xE2, 0xE3, 0xE4, 0xE5
UEINTX, UENUM, UERST, UECONX, UECFG0X, UECFG1X = 0xE8, 0xE9, 0xEA, 0xEB, 0xEC, 0xED
UESTA0X, UESTA1X, UEIENX, UEDATX, UEBCLX, UEINT = 0xEE, 0xEF, 0xF0, 0xF1, 0xF2, 0xF4
PLLCSR, MCUSR, PLLFRQ, CLKPR, REGCR = 0x49, 0x54, 0x52, 0x61, 0x63

TXINI, STALLEDI, RXOUTI, KILLBK, RXSTPI, NAKOUTI, RWAL, NAKINI, FIFOCON = (
    *(0x01, 0x02, 0x04, 0x04, 0x08),
    *(0x10, 0x20, 0x40, 0x80),
)
EPEN, RSTDT, STALLRQC, STALLRQ = 0x01, 0x08, 0x10, 0x20
SUSPI, SOFI, EORSTI, WAKEUPI, EORSMI, UPRSMI = 0x01, 0x04, 0x08, 0x10, 0x20, 0x40
FRAME, BIT = 16_000, 16 / 12  # cycles at 16 MHz
CONTROL, BULK_OUT, BULK_IN = 0x00, 0x80, 0x81
DOUBLE = 0x04


def size_bits(size: int) -> int:
    """EPSIZE and ALLOC of UECFG1X."""
    return (size.bit_length() - 4) << 4 | 0x02


class Chip:
    """Registers of a chip that runs poke.c, and the host at its cable."""

    def __init__(self, sim: AvrSim) -> None:
        self.sim, self.bus = sim, sim.usb
        self.is_u4 = sim.mcu.endswith("u4")
        sim.run(1000)  # the startup code clears the variables

    def _do(self, what: int, register: int, value: int) -> int:
        self.sim.write_memory("address", register.to_bytes(2, "little"))
        self.sim.write_memory("value", bytes([value]))
        self.sim.write_memory("go", bytes([what]))
        assert self.sim.run_until(lambda: self.variable("go") == 0, 1000, 10)
        return self.variable("value")

    def put(self, register: int, value: int) -> None:
        """Write a register with the CPU."""
        self._do(1, register, value)

    def get(self, register: int) -> int:
        """Read a register with the CPU."""
        return self._do(2, register, 0)

    def pulse(self, register: int, value: int, turns: int) -> None:
        """Write a register with the CPU, and 0 into it 3 * turns + 1 cycles later."""
        self.sim.write_memory("turns", bytes([turns]))
        self._do(3, register, value)

    def variable(self, name: str) -> int:
        """The value of a variable of poke.c."""
        return self.sim.read_memory(name, 1)[0]

    def ms(self, time: float) -> None:
        """Let milliseconds pass."""
        self.sim.run(self.sim.cycles(time / 1000))

    # -- what firmware does -------------------------------------------------------------------

    def power(self) -> None:
        """Start the controller, up to the pull-up."""
        if self.is_u4:
            self.put(UHWCON, 0x01)
        self.put(PLLCSR, 0x12 if self.is_u4 else 0x06)
        self.ms(3)
        self.put(USBCON, 0x90 if self.is_u4 else 0x80)
        self.put(UDCON, 0)

    def start(self, *endpoints: tuple[int, int, int]) -> None:
        """Start the controller, plug it in, reset the bus, and configure endpoint 0 and others."""
        self.power()
        self.bus.plug()
        self.ms(1)
        self.bus.reset()
        self.put(UDINT, 0)
        assert self.endpoint(0, CONTROL, size_bits(8))
        for number, kind, size in endpoints:
            assert self.endpoint(number, kind, size)
        self.bus.clear_toggle()
        self.ms(1.1)

    def endpoint(self, number: int, kind: int, size: int) -> bool:
        """Configure an endpoint; returns CFGOK."""
        self.put(UENUM, number)
        self.put(UECONX, EPEN)
        self.put(UECFG0X, kind)
        self.put(UECFG1X, size)
        return bool(self.get(UESTA0X) & 0x80)

    def select(self, number: int) -> None:
        """Choose an endpoint."""
        self.put(UENUM, number)

    def flags(self) -> int:
        """UEINTX."""
        return self.get(UEINTX)

    def clear(self, flags: int) -> None:
        """Clear flags of UEINTX, leaving KILLBK of an IN endpoint alone."""
        kill = 0 if self.get(UECFG0X) & 0xC1 == BULK_IN else 4
        self.put(UEINTX, (0xFB | kill) & ~flags)

    def fill(self, data: bytes) -> None:
        """Write to the FIFO."""
        for byte in data:
            self.put(UEDATX, byte)

    def send(self, data: bytes) -> None:
        """Fill the bank of an IN endpoint and hand it over."""
        self.clear(TXINI)
        self.fill(data)
        self.clear(FIFOCON)

    def take(self) -> bytes:
        """Read the bank of an OUT endpoint and free it."""
        self.clear(RXOUTI)
        data = bytes(self.get(UEDATX) for _ in range(self.get(UEBCLX)))
        self.clear(FIFOCON)
        return data

    def read_fifo(self, count: int) -> bytes:
        """Read bytes from the FIFO."""
        return bytes(self.get(UEDATX) for _ in range(count))


def in_frame(sim: AvrSim, part: float = 0.1) -> int:
    """Run to a place in the next frame, given as a part of it."""
    frame = sim.usb.frame
    assert sim.run_until(lambda: sim.usb.frame != frame, 2 * FRAME, 1)
    sim.run(int(sim.usb.frame_start + part * FRAME - sim.cycle))
    return sim.cycle
