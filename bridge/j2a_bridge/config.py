"""What a bridge shall do, as one TOML file or the command line says it.

What flows in: a file, or arguments. What flows out: a `Config`.
Rules: without a file everything is published under sensible names; a word that is not known is an
error that names it and what is near.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import j2a_transports
from j2a_spec.nearest import did_you_mean

from j2a import J2AError, LocalError
from j2a.io.opening import link_error
from j2a_bridge.sink_request import SinkRequest

__all__ = [
    "CLOCKS",
    "MESSAGES",
    "NAMES",
    "BoardConfig",
    "Config",
    "SensorConfig",
    "check_url",
    "load_config",
]

_LEAST_HZ: Final = 1e-6
_MOST_HZ: Final = 1e6
"""Times have microseconds."""
_MOST_CHARACTERS: Final = 1 << 20
CLOCKS: Final = ("discipline", "follow", "off")
NAMES: Final = ("short", "board")
MESSAGES: Final = (
    "auto",
    "raw",
    "sensor_msgs/FluidPressure",
    "sensor_msgs/Illuminance",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/MagneticField",
    "sensor_msgs/NavSatFix",
    "sensor_msgs/Range",
    "sensor_msgs/RelativeHumidity",
    "sensor_msgs/Temperature",
)
"""What a sensor can be published as; standard ones may also have "/msg/" in them."""


@dataclass(frozen=True, slots=True)
class SensorConfig:
    """What is asked of one transducer.

    Attributes:
        topic: in place of that of its descriptor.
        rate_hz: so many samples a second at the most; None for all.
        message: "auto", "raw", or a standard message; see `j2a_bridge.topics.Topic`.
        is_published: it is.
    """

    topic: str = ""
    rate_hz: float | None = None
    message: str = "auto"
    is_published: bool = True


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """What is asked of one board.

    Attributes:
        url: where it is; "" for one that is known by its identity alone.
        identity: its serial number; "" for any.
        name: among the topics; "" for its own.
        transducers: by name.
    """

    url: str = ""
    identity: str = ""
    name: str = ""
    transducers: Mapping[str, SensorConfig] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Config:
    """What a bridge shall do.

    Attributes:
        boards: to open, or what is asked of those that are found.
        sinks: where samples go.
        usb: also take all boards on the USB of this computer.
        names: "short" or "board": whether the board's name stands before that of a transducer;
            "" for "short" with one URL alone.
        clock: "discipline" sets the clocks of boards, "follow" only knows them, or "off".
    """

    boards: tuple[BoardConfig, ...] = ()
    sinks: tuple[SinkRequest, ...] = ()
    usb: bool = False
    names: str = ""
    clock: str = "discipline"

    @property
    def urls(self) -> tuple[str, ...]:
        """Of the boards to open."""
        return tuple(board.url for board in self.boards if board.url)

    @property
    def with_board(self) -> bool:
        """Whether topics begin with the name of the board."""
        if self.names:
            return self.names == "board"
        return self.usb or len(self.urls) != 1


def check_url(url: str) -> None:
    """Refuse the URL of a board that could never be opened; one of a board that is away is right.

    Raises:
        BadUrl: it is malformed; the message says what to write.
        OpenFailed: its driver does not load.
    """
    try:
        j2a_transports.check(url)
    except j2a_transports.TransportError as error:
        raise link_error(error) from None


class _WrongKeyError(LocalError):
    """A key of the file, or its value, is wrong."""

    def __init__(self, message: str, key: str) -> None:
        super().__init__(message)
        self.key = key


def load_config(path: Path) -> Config:
    """Read a file.

    Raises:
        LocalError: it is wrong; the message has its name, the line where that is certain, and what
            is wrong.
        OSError: it cannot be read.
    """
    text = ""
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_MOST_CHARACTERS + 1)
        if len(text) > _MOST_CHARACTERS:
            raise LocalError(f"it has more than {_MOST_CHARACTERS} characters")
        config = _config(tomllib.loads(text))
    except RecursionError:
        raise LocalError(f"{path}: tables and lists are nested too deep") from None
    except _WrongKeyError as error:
        raise LocalError(f"{path}{_place(text, error.key)}: {error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, LocalError) as error:
        raise LocalError(f"{path}: {error}") from None
    return replace(config, sinks=tuple(replace(one, source=f"{path}: ") for one in config.sinks))


def _place(text: str, key: str) -> str:
    """Return the line in which a key of a TOML file stands, such as ", line 3".

    tomllib tells no lines, so it is looked for as a word; "" where that is in several lines, or in
    none.
    """
    word = re.compile(rf"(?<![\w-]){re.escape(key)}(?![\w-])")
    found = [number for number, line in enumerate(text.split("\n"), 1) if word.search(line)]
    return f", line {found[0]}" if key and len(found) == 1 else ""


def _config(table: Mapping[str, Any]) -> Config:
    _check(
        table, "the file", {"boards": list, "sinks": list, "usb": bool, "names": str, "clock": str}
    )
    names, clock = table.get("names", ""), table.get("clock", "discipline")
    _one_of("names", "names", names, ("", *NAMES))
    _one_of("clock", "clock", clock, CLOCKS)
    boards = tuple(_board(one) for one in table.get("boards", ()))
    for key, values in (
        ("url", [one.url for one in boards]),
        ("serial", [one.identity for one in boards]),
    ):
        twice = {value for value in values if value and values.count(value) > 1}
        if twice:
            raise LocalError(f"two [[boards]] have the {key} {min(twice)!r:.60}")
    return Config(
        boards,
        tuple(_sink(one) for one in table.get("sinks", ())),
        table.get("usb", False),
        names,
        clock,
    )


def _board(table: Any) -> BoardConfig:
    _check(table, "[[boards]]", {"url": str, "serial": str, "name": str, "transducers": dict})
    if not table.get("url") and not table.get("serial"):
        raise LocalError("[[boards]] has a url, or the serial of one that is found on the USB")
    if table.get("url"):
        try:
            check_url(table["url"])
        except J2AError as error:
            raise LocalError(f"url of [[boards]]: {error}") from None
    transducers = {name: _sensor(name, one) for name, one in table.get("transducers", {}).items()}
    return BoardConfig(
        table.get("url", ""), table.get("serial", ""), table.get("name", ""), transducers
    )


def _sensor(name: str, table: Any) -> SensorConfig:
    kinds = {"topic": str, "rate": (int, float), "message": str, "publish": bool}
    _check(table, f"the transducer {name}", kinds)
    rate = table.get("rate")
    if rate is not None and not _LEAST_HZ <= rate <= _MOST_HZ:
        raise _WrongKeyError(
            f"the rate of {name} is a number of samples a second, not {rate!r:.40}", "rate"
        )
    message = table.get("message", "auto")
    _one_of("message", f"the message of {name}", message.replace("/msg/", "/"), MESSAGES)
    return SensorConfig(
        table.get("topic", ""),
        None if rate is None else float(rate),
        message,
        table.get("publish", True),
    )


def _sink(table: Any) -> SinkRequest:
    if isinstance(table, str):
        return SinkRequest.parse(table)
    if not isinstance(table, dict) or not isinstance(table.get("use"), str):
        raise LocalError('[[sinks]] says which one, as in use = "ros2"')
    if not isinstance(table.get("to", ""), str):
        raise LocalError(f"to of [[sinks]] is a text, not {table['to']!r:.60}")
    options = {key: value for key, value in table.items() if key not in ("use", "to")}
    return SinkRequest(table["use"], table.get("to", ""), options)


def _check(table: Any, where: str, kinds: Mapping[str, Any]) -> None:
    if not isinstance(table, Mapping):
        raise LocalError(f"{where} is a table, not {table!r:.60}")
    for key, value in table.items():
        if key not in kinds:
            raise _WrongKeyError(f"{where} has no {key!r:.60}; {_near(key, kinds)}", key)
        if not isinstance(value, kinds[key]) or (
            isinstance(value, bool) and kinds[key] is not bool
        ):
            raise _WrongKeyError(f"{key} of {where} cannot be {value!r:.60}", key)


def _one_of(key: str, what: str, value: str, allowed: Iterable[str]) -> None:
    if value not in allowed:
        listed = ", ".join(one for one in allowed if one)
        raise _WrongKeyError(f"{what} is one of {listed}, not {value!r:.60}", key)


def _near(key: str, known: Iterable[str]) -> str:
    known = list(known)
    return did_you_mean(key, known) or f"there are: {', '.join(known)}"
