"""Boards that are known by the USB ids of their serial port.

In: a vendor and a product id. Out: a name.
Rules: a bridge chip tells the chip, not the board; the names say so.
"""

from typing import Final

_ANY: Final = None

BOARDS: Final[dict[tuple[int, int | None], str]] = {
    (0x2341, 0x0001): "Arduino Uno",
    (0x2341, 0x0010): "Arduino Mega 2560",
    (0x2341, 0x0036): "Arduino Leonardo (bootloader)",
    (0x2341, 0x8036): "Arduino Leonardo",
    (0x2341, 0x0037): "Arduino Micro (bootloader)",
    (0x2341, 0x8037): "Arduino Micro",
    (0x2341, 0x003D): "Arduino Due (programming port)",
    (0x2341, 0x003E): "Arduino Due (native port)",
    (0x2341, 0x0042): "Arduino Mega 2560 R3",
    (0x2341, 0x0043): "Arduino Uno R3",
    (0x2341, 0x0058): "Arduino Nano Every",
    (0x2341, 0x0069): "Arduino Uno R4 Minima",
    (0x2341, 0x1002): "Arduino Uno R4 WiFi",
    (0x2341, _ANY): "Arduino",
    (0x2A03, 0x0042): "Arduino Mega 2560 R3",
    (0x2A03, 0x0043): "Arduino Uno R3",
    (0x2A03, _ANY): "Arduino",
    (0x2E8A, 0x0005): "Raspberry Pi Pico (MicroPython)",
    (0x2E8A, 0x000A): "Raspberry Pi Pico",
    (0x2E8A, 0x000C): "Raspberry Pi Debug Probe",
    (0x2E8A, _ANY): "Raspberry Pi RP2040/RP2350",
    (0x16C0, 0x0483): "Teensy",
    (0x16C0, _ANY): "V-USB or Teensy",
    (0x239A, _ANY): "Adafruit",
    (0x303A, 0x1001): "Espressif ESP32 (built-in USB)",
    (0x303A, _ANY): "Espressif ESP32",
    (0x0483, 0x374B): "ST-Link V2-1 (Nucleo, Discovery)",
    (0x0483, 0x374E): "ST-Link V3",
    (0x0483, 0x5740): "STM32 virtual serial port",
    (0x03EB, 0x2145): "Atmel EDBG (Xplained)",
    (0x03EB, _ANY): "Atmel/Microchip",
    (0x1366, _ANY): "SEGGER J-Link",
    (0x0D28, 0x0204): "DAPLink (micro:bit and others)",
    (0x0403, 0x6001): "FTDI FT232R bridge",
    (0x0403, 0x6010): "FTDI FT2232 bridge",
    (0x0403, 0x6011): "FTDI FT4232 bridge",
    (0x0403, 0x6014): "FTDI FT232H bridge",
    (0x0403, 0x6015): "FTDI FT231X bridge",
    (0x0403, _ANY): "FTDI bridge",
    (0x1A86, 0x5523): "WCH CH341 bridge",
    (0x1A86, 0x55D4): "WCH CH9102 bridge",
    (0x1A86, 0x7523): "WCH CH340 bridge",
    (0x1A86, _ANY): "WCH bridge",
    (0x10C4, 0xEA60): "Silicon Labs CP210x bridge",
    (0x10C4, 0xEA70): "Silicon Labs CP2105 bridge",
    (0x10C4, _ANY): "Silicon Labs bridge",
    (0x067B, 0x2303): "Prolific PL2303 bridge",
    (0x067B, _ANY): "Prolific bridge",
    (0x04D8, 0x000A): "Microchip CDC (MCP2200 and others)",
    (0x04D8, 0x00DD): "Microchip MCP2221 bridge",
}
"""Names by vendor and product id; a product of None stands for all others of the vendor."""


def board_name(vid: int | None, pid: int | None) -> str | None:
    """Return the name of the board or bridge with these USB ids, None if it is not known."""
    if vid is None or pid is None:
        return None
    return BOARDS.get((vid, pid)) or BOARDS.get((vid, None))
