"""Every number of the protocol, once.

What flows out: plain integers and strings with the specification's names. The C header, the tables
of the documentation and both Python implementations take them from here; `TABLE` is the list that
the generator prints, so a constant that is missing there is missing everywhere.
"""

from dataclasses import dataclass
from typing import Final

from j2a_spec.capabilities import CAPABILITIES, FUNCTIONS, is_part_of

SPEC_VERSION: Final = "1.1"
"""Version of this specification, the value of the property `j2a.spec`."""

# Framing (thesis 7.1.1; SOS is not in the text, it is what the 2014 firmware sends).
SOF: Final = 0x12
SOS: Final = 0xED
ESC: Final = 0x7D
MARKERS: Final = frozenset({SOF, SOS})
STUFFED: Final = frozenset({SOF, SOS, ESC})

# Checksum (thesis 7.1.3).
CHK_OPCODE: Final = 11
CHK_LENGTH: Final = 97

# Sizes, in bytes.
MAX_PAYLOAD: Final = 255
HEADER: Final = 3
MAX_WIRE: Final = 1 + 2 * (1 + 1 + MAX_PAYLOAD + 1) + 1
MANY_HEADER: Final = 6
MANY_DATA: Final = MAX_PAYLOAD - MANY_HEADER
MAX_MAPPING: Final = MAX_PAYLOAD
MIN_ROOM: Final = 32

# Flags of the a2jMany header.
FLAG_LAST: Final = 0x01
FLAG_WRITE: Final = 0x02

# Opcode field of a reply.
ERR_OPCODE: Final = 0xF0
ERR_TIMEOUT: Final = 0xF2
ERR_CHECKSUM: Final = 0xF3
ERR_FRAMING: Final = 0xF4
ERRORS: Final = frozenset({ERR_OPCODE, ERR_TIMEOUT, ERR_CHECKSUM, ERR_FRAMING})
RET_OK: Final = 0x00
RET_MAX: Final = 0xEF
RET_FAILED: Final = 0xFF

# Return values of built-in functions.
ECHO: Final = 0xBA
ECHO_MANY: Final = 0xBE
DEBUG_MORE: Final = 0x01
DEBUG_LOST: Final = 0x02

# Times, in milliseconds.
BYTE_TIMEOUT_MS: Final = 10
BYTE_TIMEOUT_MIN_MS: Final = 9
BYTE_TIMEOUT_MAX_MS: Final = 20

# Site ids: the two payload bytes of our error replies say which check refused the frame.
SITE_OPCODE: Final = 1
SITE_KIND: Final = 2
SITE_TIMEOUT: Final = 3
SITE_CHECKSUM: Final = 4
SITE_MARKER: Final = 5
SITE_ESCAPE: Final = 6
SITE_LOST: Final = 7

# Built-in functions; capabilities.toml has their order and says which are optional.
GET_MAPPING: Final = "a2jGetMapping"
MANY: Final = "a2jMany"
GET_PROPERTIES: Final = "a2jGetProperties"
GET_DEBUG: Final = "a2jDebug"
GET_ECHO: Final = "a2jEcho"
GET_ECHO_MANY: Final = "a2jEchoMany"
GET_INTERFACE: Final = "a2jGetInterface"
GET_TRANSDS: Final = "a2jGetTransds"
TRANSD: Final = "a2jTransd"
CLOCK: Final = "a2jClock"
# Built-in functions in opcode order: all, and those of a device that announces nothing (j2a.caps).
KNOWN_BUILTINS: Final = tuple(function.name for function in FUNCTIONS)
BUILTINS: Final = tuple(
    f.name for f in FUNCTIONS if not (f.capability and CAPABILITIES[f.capability].token)
)
WITH_MANY: Final = frozenset(f.name for f in FUNCTIONS if is_part_of(f, "many"))

CAP_INTERFACE: Final = "interface"
"""The token of j2a.caps for signatures (J2A-IFACE-001)."""
CAP_BOOT: Final = "boot"
"""The token of j2a.caps for the boot SIF (J2A-BOOT-001)."""

CAP_TRANSDUCERS: Final = "transducers"
"""The token of j2a.caps for sensors and actuators (J2A-TRANS-001)."""
CAP_CLOCK: Final = "clock"
"""The token of j2a.caps for a clock that the host disciplines (J2A-CLOCK-001)."""

# The boot SIF: its opcode, the bytes of its payload, and why a device began anew.
BOOT: Final = 0xFF
BOOT_BYTES: Final = 7
BOOT_UNKNOWN: Final = 0
BOOT_POWER: Final = 1
BOOT_PIN: Final = 2
BOOT_BROWNOUT: Final = 3
BOOT_WATCHDOG: Final = 4
BOOT_SOFTWARE: Final = 5

# Transducers: the items of a2jTransd, why it refuses one, and bounds of descriptors.
TRANSD_SAMPLE: Final = 0
TRANSD_ENABLED: Final = 1
TRANSD_PERIOD: Final = 2
TRANSD_DECIMATION: Final = 3
TRANSD_THRESHOLD: Final = 4
TRANSD_TOPIC: Final = 5
TRANSD_WATCHDOG: Final = 6
TRANSD_SET: Final = 7
TRANSD_TRIGGER: Final = 8
TRANSD_SAVE: Final = 9
TRANSD_TIME: Final = 10
TRANSD_NO_ID: Final = 1
TRANSD_NO_ITEM: Final = 2
TRANSD_BAD_LENGTH: Final = 3
TRANSD_BAD_VALUE: Final = 4
TRANSD_BUSY: Final = 5
TRANSD_MAX_ID: Final = 254
TRANSD_MAX_TOPIC: Final = 32
TRANSD_NOT_SAVED: Final = 0
TRANSD_SAVED: Final = 1
TRANSD_SAVING: Final = 2

# The clock: the items of a2jClock, why it refuses one, states, modes and bounds.
CLOCK_EXCHANGE: Final = 0
CLOCK_STATUS: Final = 1
CLOCK_ADJUST: Final = 2
CLOCK_FRAME: Final = 3
CLOCK_NO_ITEM: Final = 1
CLOCK_BAD_LENGTH: Final = 2
CLOCK_BAD_VALUE: Final = 3
CLOCK_FREE: Final = 0
CLOCK_SETTLING: Final = 1
CLOCK_LOCKED: Final = 2
CLOCK_HOLDOVER: Final = 3
CLOCK_SLEW: Final = 0
CLOCK_STEP: Final = 1
CLOCK_MAX_RATE: Final = 10_000_000
CLOCK_MAX_BEHIND: Final = 1 << 31
CLOCK_MAX_SLEW_PPM: Final = 1000
CLOCK_MAX_START_MS: Final = 5
CLOCK_FRAME_WANDER: Final = 5000
CLOCK_FRAME_STEP_S: Final = 2
CLOCK_SETTLED_US: Final = 10
CLOCK_HOLDOVER_S: Final = 10
CLOCK_FRAMES_MS: Final = 100
CLOCK_FRAME_NUMBERS: Final = 2048
CLOCK_NO_FRAME: Final = 0xFFFF
CLOCK_MAX_TURNAROUND: Final = 0xFFFF
CLOCK_UNKNOWN: Final = 0xFFFFFFFF

# USB: the interface for frames, and SyncUSB, the one for the time (LINKS.md, thesis 6.3).
USB_VENDOR: Final = 0x6666
USB_PRODUCT: Final = 0xCAFE
USB_CLASS: Final = 0xFF
USB_SUBCLASS: Final = 0x12
USB_PROTOCOL: Final = 0xEF
USB_IN: Final = 0x81
USB_OUT: Final = 0x02
USB_PACKET: Final = 64
SYNCUSB_SUBCLASS: Final = 0x34
SYNCUSB_PROTOCOL: Final = 0x01
SYNCUSB_OUT: Final = 0x03
SYNCUSB_SIZE: Final = 10
SYNCUSB_NAME: Final = "SyncUSB"
SYNCUSB_REQUEST_TYPE: Final = 0xC1
SYNCUSB_SEEN: Final = 0x01
SYNCUSB_SEEN_SIZE: Final = 6

# Property keys that the specification gives a meaning.
PROP_SPEC: Final = "j2a.spec"
PROP_RXBUF: Final = "j2a.rxbuf"
PROP_ROOM: Final = "j2a.room"
PROP_SELFTEST: Final = "j2a.selftest"
PROP_CAPS: Final = "j2a.caps"
PROP_INTERFACE: Final = "j2a.interface"
PROPERTIES: Final = frozenset(
    {PROP_SPEC, PROP_RXBUF, PROP_ROOM, PROP_SELFTEST, PROP_CAPS, PROP_INTERFACE}
)
"""Every key that starts with `j2a.` (J2A-PROP-009)."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A row of the table of constants: C and documentation name, value, meaning and group."""

    name: str
    value: int
    meaning: str
    group: str


def _rows(group: str, *rows: tuple[str, int, str]) -> tuple[Constant, ...]:
    return tuple(Constant(name, value, meaning, group) for name, value, meaning in rows)


TABLE: Final = (
    *_rows(
        "Framing",
        ("SOF", SOF, "starts a request and a reply"),
        ("SOS", SOS, "starts a server-initiated frame (SIF)"),
        ("ESC", ESC, "escape: the byte after it is sent as its value minus one"),
        ("CHK_OPCODE", CHK_OPCODE, "added to the opcode in the checksum"),
        ("CHK_LENGTH", CHK_LENGTH, "added to the length in the checksum"),
    ),
    *_rows(
        "Sizes in bytes",
        ("MAX_PAYLOAD", MAX_PAYLOAD, "largest payload"),
        ("MAX_WIRE", MAX_WIRE, "largest frame on the wire"),
        ("MANY_HEADER", MANY_HEADER, "header of an a2jMany request or reply"),
        ("MANY_DATA", MANY_DATA, "largest a2jMany chunk"),
        ("MIN_ROOM", MIN_ROOM, "payload of a request that fits into every device"),
    ),
    *_rows(
        "a2jMany flags",
        ("FLAG_LAST", FLAG_LAST, "isLast: the chunk is the last one"),
        ("FLAG_WRITE", FLAG_WRITE, "isWrite: the chunk goes to the device"),
    ),
    *_rows(
        "Opcode field of a reply",
        ("RET_OK", RET_OK, "success, by convention"),
        ("RET_MAX", RET_MAX, "largest value that a function may return freely"),
        ("RET_FAILED", RET_FAILED, "the function failed"),
        ("ERR_OPCODE", ERR_OPCODE, "no such function, or not callable this way"),
        ("ERR_TIMEOUT", ERR_TIMEOUT, "the rest of the request did not come in time"),
        ("ERR_CHECKSUM", ERR_CHECKSUM, "the request's checksum is wrong"),
        ("ERR_FRAMING", ERR_FRAMING, "the request was broken by a marker, an escape or lost bytes"),
        ("ECHO", ECHO, "what a2jEcho returns"),
        ("ECHO_MANY", ECHO_MANY, "what a2jEchoMany returns"),
        ("DEBUG_MORE", DEBUG_MORE, "bit of a2jDebug: more text is pending"),
        ("DEBUG_LOST", DEBUG_LOST, "bit of a2jDebug: text was lost since the last call"),
    ),
    *_rows(
        "Times in milliseconds",
        ("BYTE_TIMEOUT_MS", BYTE_TIMEOUT_MS, "nominal longest pause inside a frame"),
        ("BYTE_TIMEOUT_MIN_MS", BYTE_TIMEOUT_MIN_MS, "a pause up to this is always accepted"),
        ("BYTE_TIMEOUT_MAX_MS", BYTE_TIMEOUT_MAX_MS, "a pause of this ends the frame"),
    ),
    *_rows(
        "Boot SIF",
        ("BOOT", BOOT, "opcode of the boot SIF"),
        ("BOOT_BYTES", BOOT_BYTES, "bytes of its payload"),
        ("BOOT_UNKNOWN", BOOT_UNKNOWN, "cause of the reset: the device cannot tell"),
        ("BOOT_POWER", BOOT_POWER, "cause: the power was switched on"),
        ("BOOT_PIN", BOOT_PIN, "cause: the reset pin"),
        ("BOOT_BROWNOUT", BOOT_BROWNOUT, "cause: the voltage was too low"),
        ("BOOT_WATCHDOG", BOOT_WATCHDOG, "cause: the watchdog"),
        ("BOOT_SOFTWARE", BOOT_SOFTWARE, "cause: the firmware itself, or an update of it"),
    ),
    *_rows(
        "Items of a2jTransd",
        ("TRANSD_SAMPLE", TRANSD_SAMPLE, "newest value of each channel, a sample"),
        ("TRANSD_ENABLED", TRANSD_ENABLED, "whether sample SIFs are sent, `bool`"),
        ("TRANSD_PERIOD", TRANSD_PERIOD, "least time between due times of sample SIFs, `u32 us`"),
        ("TRANSD_DECIMATION", TRANSD_DECIMATION, "every n-th value is taken, `u8` from 1 on"),
        ("TRANSD_THRESHOLD", TRANSD_THRESHOLD, "least difference of values, of the type"),
        ("TRANSD_TOPIC", TRANSD_TOPIC, "name under which hosts publish, `text[32]`, not empty"),
        ("TRANSD_WATCHDOG", TRANSD_WATCHDOG, "silence until an actuator is set to safe, `u16 ms`"),
        ("TRANSD_SET", TRANSD_SET, "first channel `u8`, time `u64 us`, a value for each channel"),
        ("TRANSD_TRIGGER", TRANSD_TRIGGER, "time at which a sensor measures, `u64 us`"),
        ("TRANSD_SAVE", TRANSD_SAVE, "settings that stay without power, `u8`: a state of SAVE"),
        ("TRANSD_TIME", TRANSD_TIME, "the device's clock, `u64 us`"),
    ),
    *_rows(
        "Failures of a2jTransd",
        ("TRANSD_NO_ID", TRANSD_NO_ID, "NO_ID: no transducer has this id"),
        ("TRANSD_NO_ITEM", TRANSD_NO_ITEM, "NO_ITEM: it has no such item to read, or to write"),
        ("TRANSD_BAD_LENGTH", TRANSD_BAD_LENGTH, "BAD_LENGTH: what is written has another length"),
        ("TRANSD_BAD_VALUE", TRANSD_BAD_VALUE, "BAD_VALUE: what is written is out of range"),
        ("TRANSD_BUSY", TRANSD_BUSY, "BUSY: the settings of a transducer are being saved"),
    ),
    *_rows(
        "States of SAVE",
        ("TRANSD_NOT_SAVED", TRANSD_NOT_SAVED, "NOT_SAVED: a reset brings the descriptors' back"),
        ("TRANSD_SAVED", TRANSD_SAVED, "SAVED: a reset brings those of the last write back"),
        ("TRANSD_SAVING", TRANSD_SAVING, "SAVING: those of the last write are being kept"),
    ),
    *_rows(
        "Bounds of transducers",
        ("TRANSD_MAX_ID", TRANSD_MAX_ID, "largest id of a transducer"),
        ("TRANSD_MAX_TOPIC", TRANSD_MAX_TOPIC, "bytes of the longest topic"),
    ),
    *_rows(
        "Items of a2jClock",
        ("CLOCK_EXCHANGE", CLOCK_EXCHANGE, "the local time at which the request was received"),
        ("CLOCK_STATUS", CLOCK_STATUS, "the time, and how good it is; no data"),
        ("CLOCK_ADJUST", CLOCK_ADJUST, "sets the target at a local time"),
        ("CLOCK_FRAME", CLOCK_FRAME, "sets the target at a USB frame; devices with frames only"),
    ),
    *_rows(
        "Failures of a2jClock",
        ("CLOCK_NO_ITEM", CLOCK_NO_ITEM, "NO_ITEM: there is no such item"),
        ("CLOCK_BAD_LENGTH", CLOCK_BAD_LENGTH, "BAD_LENGTH: the request has another length"),
        ("CLOCK_BAD_VALUE", CLOCK_BAD_VALUE, "BAD_VALUE: a field is out of range"),
    ),
    *_rows(
        "States of a clock",
        ("CLOCK_FREE", CLOCK_FREE, "FREE: not adjusted yet, the time is the local time"),
        ("CLOCK_SETTLING", CLOCK_SETTLING, "SETTLING: after a step, or still far from the target"),
        ("CLOCK_LOCKED", CLOCK_LOCKED, "LOCKED: at the target"),
        ("CLOCK_HOLDOVER", CLOCK_HOLDOVER, "HOLDOVER: not adjusted for 10 s"),
    ),
    *_rows(
        "Modes of ADJUST",
        ("CLOCK_SLEW", CLOCK_SLEW, "SLEW: leads to the target without a jump"),
        ("CLOCK_STEP", CLOCK_STEP, "STEP: sets the time to the target at once"),
    ),
    *_rows(
        "Bounds of clocks",
        ("CLOCK_MAX_RATE", CLOCK_MAX_RATE, "largest rate and largest wander, in ppb"),
        ("CLOCK_MAX_BEHIND", CLOCK_MAX_BEHIND, "oldest local time of ADJUST, in us before now"),
        ("CLOCK_MAX_SLEW_PPM", CLOCK_MAX_SLEW_PPM, "largest correction, in ppm"),
        ("CLOCK_MAX_START_MS", CLOCK_MAX_START_MS, "until a correction begins, in ms"),
        (
            "CLOCK_SETTLED_US",
            CLOCK_SETTLED_US,
            "distance from the target that still is LOCKED, in us",
        ),
        ("CLOCK_HOLDOVER_S", CLOCK_HOLDOVER_S, "without an adjustment until HOLDOVER, in s"),
        ("CLOCK_FRAME_WANDER", CLOCK_FRAME_WANDER, "wander of FRAME, in ppb"),
        ("CLOCK_FRAME_STEP_S", CLOCK_FRAME_STEP_S, "distance at which FRAME steps, in s"),
        ("CLOCK_FRAMES_MS", CLOCK_FRAMES_MS, "without a frame until the device has none, in ms"),
        ("CLOCK_FRAME_NUMBERS", CLOCK_FRAME_NUMBERS, "numbers of USB frames"),
        ("CLOCK_NO_FRAME", CLOCK_NO_FRAME, "in place of a frame number: none was seen"),
        ("CLOCK_MAX_TURNAROUND", CLOCK_MAX_TURNAROUND, "turnaround of so many us or more"),
        ("CLOCK_UNKNOWN", CLOCK_UNKNOWN, "in place of an uncertainty: it is unknown"),
    ),
    *_rows(
        "USB",
        ("USB_VENDOR", USB_VENDOR, "vendor id of boards that have none of their own"),
        ("USB_PRODUCT", USB_PRODUCT, "product id of such boards"),
        ("USB_CLASS", USB_CLASS, "class of both interfaces: vendor specific"),
        ("USB_SUBCLASS", USB_SUBCLASS, "subclass of the interface that carries frames"),
        ("USB_PROTOCOL", USB_PROTOCOL, "its protocol"),
        ("USB_IN", USB_IN, "its bulk endpoint to the host, on boards that may choose"),
        ("USB_OUT", USB_OUT, "its bulk endpoint to the board, on boards that may choose"),
        ("USB_PACKET", USB_PACKET, "packet of a bulk endpoint at full speed"),
        ("SYNCUSB_SUBCLASS", SYNCUSB_SUBCLASS, "subclass of the interface SyncUSB"),
        ("SYNCUSB_PROTOCOL", SYNCUSB_PROTOCOL, "its protocol"),
        ("SYNCUSB_OUT", SYNCUSB_OUT, "its interrupt endpoint to the board"),
        ("SYNCUSB_SIZE", SYNCUSB_SIZE, "bytes of a packet of SyncUSB"),
        ("SYNCUSB_REQUEST_TYPE", SYNCUSB_REQUEST_TYPE, "bmRequestType of its request"),
        ("SYNCUSB_SEEN", SYNCUSB_SEEN, "bRequest: which frame the board saw last"),
        ("SYNCUSB_SEEN_SIZE", SYNCUSB_SEEN_SIZE, "bytes of the answer"),
    ),
    *_rows(
        "Site ids of error payloads",
        ("SITE_OPCODE", SITE_OPCODE, "opcode or function index out of range"),
        ("SITE_KIND", SITE_KIND, "function of the other kind"),
        ("SITE_TIMEOUT", SITE_TIMEOUT, "byte timeout"),
        ("SITE_CHECKSUM", SITE_CHECKSUM, "checksum"),
        ("SITE_MARKER", SITE_MARKER, "marker inside a frame"),
        ("SITE_ESCAPE", SITE_ESCAPE, "ESC 0xFF"),
        ("SITE_LOST", SITE_LOST, "received bytes were lost to an overrun"),
    ),
)
