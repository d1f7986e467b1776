"""Devices of version 1.0 and chunks that end at the offset 256 or beside it (J2A-MANY-014)."""

from dataclasses import replace

from j2a_spec import constants as c

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import DEMO, FETCH, OLD, STORE
from j2a_conformance.host._host import Host
from j2a_conformance.host._outcomes import spell

from .offsets import _REFUSED, judge_offsets


class UniformChunks(HostCase):
    """Has the host read equal bytes of devices of version 1.0, in chunks that end at the offset 256
    and with a last one that begins there.
    """

    ID = "host.offsets.uniform-chunks"
    EXPECTATION = "The host refuses it: the read at 256 brings what the one at 0 brought."
    REQUIREMENTS = ("J2A-MANY-014",)
    LEVEL = "many"
    DEVICE = OLD

    def _run(self, host: Host) -> None:
        for chunk in (16, 32, 64, 128):
            for size in (256, 257, 256 + chunk // 2, 256 + chunk, 257 + chunk):
                content = b"\xaa" * size
                host.become(replace(OLD, content=content, offset_mask=0xFFFFFFFF, chunk=chunk))
                accepted = (f"data {spell(content)}",) if size == 256 else _REFUSED
                _, requests = host.do(f"read {FETCH} {host.limit_ms}", *accepted)
                judge_offsets(requests)


class WriteChunks(HostCase):
    """Has the host write to devices of version 1.0 that look at the lowest byte of an offset, with
    rooms whose chunks end at the offset 256 or beside it; the last chunk begins before it, there or
    behind it.
    """

    ID = "host.offsets.write-chunks"
    EXPECTATION = "No data are written to an offset above 255."
    REQUIREMENTS = ("J2A-MANY-014",)
    LEVEL = "many"

    def _run(self, host: Host) -> None:
        host.barrier()  # its report is short; that of the case before may be beyond the least room
        for chunk in (26, 32, 64, 85, 127, 128, 129, 249):
            room = (c.PROP_ROOM, str(chunk + c.MANY_HEADER))
            known = (("name", "old"), room) if chunk < c.MANY_DATA else (("name", "old"),)
            host.become(replace(DEMO, offset_mask=0xFF, properties=known))
            most = (c.MAX_PAYLOAD // chunk + 1) * chunk  # the last chunk begins at 255 or before
            for size in (256, most, most + 1, most + chunk, most + chunk + 1):
                accepted: tuple[str, ...] = ("written",)
                if size > c.MAX_PAYLOAD + chunk:
                    accepted = _REFUSED
                elif size > 256:  # a host whose chunks are shorter may have to refuse it
                    accepted += _REFUSED
                _, requests = host.do(f"write {STORE} {size}*5a {host.limit_ms}", *accepted)
                judge_offsets(requests)
