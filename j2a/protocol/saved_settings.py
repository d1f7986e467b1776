"""Settings of transducers that stay while a device is off, as the content of a file.

What flows in and out: for each transducer, by its name, the bytes of each item of a2jTransd that is
a setting; and the content, which is JSON. Rules: the hash of the descriptors stands in it, so that
settings of a device with others are never used; nothing in it raises (J2A-TRANS-019).
"""

from collections.abc import Mapping
from typing import Final

from j2a_spec import constants as c

__all__ = ["ITEMS", "KEYS", "SavedSettings", "dump", "load"]

ITEMS: Final[Mapping[str, int]] = {
    "enabled": c.TRANSD_ENABLED,
    "period": c.TRANSD_PERIOD,
    "decimation": c.TRANSD_DECIMATION,
    "threshold": c.TRANSD_THRESHOLD,
    "topic": c.TRANSD_TOPIC,
    "watchdog": c.TRANSD_WATCHDOG,
}
"""The settings, which are the items that SAVE keeps."""

KEYS: Final[Mapping[int, str]] = {
    c.TRANSD_DECIMATION: "decimation",
    c.TRANSD_THRESHOLD: "threshold",
    c.TRANSD_TOPIC: "topic",
    c.TRANSD_WATCHDOG: "watchdog",
    c.TRANSD_TRIGGER: "trigger",
}
"""Items that only a transducer with this key in its descriptor has."""

SavedSettings = dict[str, dict[int, bytes]]


def dump(settings: SavedSettings, descriptors: bytes) -> bytes:
    """Return the content of the file.

    Args:
        settings: by the name of a transducer the bytes of each item.
        descriptors: what a2jGetTransds returns.
    """
    import json  # noqa: PLC0415 - slow to load, and few devices keep settings

    names = {item: name for name, item in ITEMS.items()}
    table = {
        transducer: {names[item]: value.hex() for item, value in items.items()}
        for transducer, items in settings.items()
    }
    known = {"descriptors": _hash(descriptors), "settings": table}
    return json.dumps(known, indent=1).encode() + b"\n"


def load(content: bytes, descriptors: bytes) -> SavedSettings:
    """Return the settings of a file; none where it is damaged or belongs to other descriptors."""
    import json  # noqa: PLC0415 - as above

    try:
        known = json.loads(content)
        if known["descriptors"] != _hash(descriptors):
            return {}
        return {
            transducer: {ITEMS[name]: bytes.fromhex(value) for name, value in items.items()}
            for transducer, items in known["settings"].items()
        }
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}


def _hash(descriptors: bytes) -> str:
    import hashlib  # noqa: PLC0415 - as above

    return hashlib.sha256(descriptors).hexdigest()
