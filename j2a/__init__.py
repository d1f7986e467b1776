"""J2A: call functions of a microcontroller, over any byte stream.

`connect(url)` gives a blocking `Client`, `aconnect(url)` an `AsyncClient`, and a `Device` is the
other side in Python. Importing this loads no driver.
"""

from typing import TYPE_CHECKING

from j2a.client import Client, Function, connect
from j2a.device import Device
from j2a.errors import (
    BadUrl,
    BatchClosed,
    BatchError,
    BatchLost,
    BatchTimeout,
    ByteTimeoutRefused,
    CallTimeout,
    ChecksumRefused,
    DamageReported,
    DeviceRestarted,
    Fail,
    FramingRefused,
    FunctionFailed,
    InterfaceChanged,
    J2AError,
    LegacyLimit,
    LinkClosed,
    LinkError,
    LinkLost,
    LinkStalled,
    LocalError,
    NoClock,
    OpcodeRefused,
    OpenFailed,
    Outcome,
    PayloadTooLong,
    ProtocolError,
    RegistrationError,
    RemoteError,
    SignatureError,
    UnknownBoard,
    UnknownFunction,
    UnknownTransducer,
    UnsupportedVersion,
    WrongArgument,
)
from j2a.events import (
    Counters,
    Frame,
    FrameError,
    Reading,
    Reply,
    ResetCause,
    Restart,
    Sample,
    Sif,
)
from j2a.io.blocking_transducers import Actuator, Sensor
from j2a.io.functions import ManyReply, ManyRequest, read_chunk
from j2a.io.handlers import Subscription
from j2a.io.streams import SifStream
from j2a.io.transds_file import load_transds
from j2a.protocol.roster import BoardChange
from j2a.protocol.trace import Trace
from j2a.types.annotations import Length, f32, f64, i8, i16, i32, i64, u8, u16, u32, u64
from j2a.types.arrays import Batch
from j2a.types.transducers import Descriptors, Transducer

if TYPE_CHECKING:
    from j2a.aio import (
        AsyncActuator,
        AsyncClient,
        AsyncFunction,
        AsyncSensor,
        AsyncSifStream,
        aconnect,
    )
    from j2a.aio_fleet import AsyncFleet
    from j2a.fleet import Fleet

    __version__: str

__all__ = [
    "Actuator",
    "AsyncActuator",
    "AsyncClient",
    "AsyncFleet",
    "AsyncFunction",
    "AsyncSensor",
    "AsyncSifStream",
    "BadUrl",
    "Batch",
    "BatchClosed",
    "BatchError",
    "BatchLost",
    "BatchTimeout",
    "BoardChange",
    "ByteTimeoutRefused",
    "CallTimeout",
    "ChecksumRefused",
    "Client",
    "Counters",
    "DamageReported",
    "Descriptors",
    "Device",
    "DeviceRestarted",
    "Fail",
    "Fleet",
    "Frame",
    "FrameError",
    "FramingRefused",
    "Function",
    "FunctionFailed",
    "InterfaceChanged",
    "J2AError",
    "LegacyLimit",
    "Length",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LinkStalled",
    "LocalError",
    "ManyReply",
    "ManyRequest",
    "NoClock",
    "OpcodeRefused",
    "OpenFailed",
    "Outcome",
    "PayloadTooLong",
    "ProtocolError",
    "Reading",
    "RegistrationError",
    "RemoteError",
    "Reply",
    "ResetCause",
    "Restart",
    "Sample",
    "Sensor",
    "Sif",
    "SifStream",
    "SignatureError",
    "Subscription",
    "Trace",
    "Transducer",
    "UnknownBoard",
    "UnknownFunction",
    "UnknownTransducer",
    "UnsupportedVersion",
    "WrongArgument",
    "aconnect",
    "connect",
    "f32",
    "f64",
    "i8",
    "i16",
    "i32",
    "i64",
    "load_transds",
    "read_chunk",
    "u8",
    "u16",
    "u32",
    "u64",
]


# Who uses none of these does not pay for loading them: asyncio takes longer than all of this
# package.
_LAZY = {
    "aio": (
        "AsyncActuator",
        "AsyncClient",
        "AsyncFunction",
        "AsyncSensor",
        "AsyncSifStream",
        "aconnect",
    ),
    "aio_fleet": ("AsyncFleet",),
    "fleet": ("Fleet",),
}


def __getattr__(name: str) -> object:
    from importlib import import_module  # noqa: PLC0415

    for module, names in _LAZY.items():
        if name in names:
            return getattr(import_module(f"j2a.{module}"), name)
    if name in ("aio_fleet", "fleet"):  # for j2a.fleet.by_url
        return import_module(f"j2a.{name}")
    if name == "__version__":
        from importlib import metadata  # noqa: PLC0415 - slow to load, rarely used

        return metadata.version("j2a")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
