"""Devices of version 1.0 whose chunks end at the offset 256 (J2A-MANY-014)."""

from dataclasses import replace

from j2a_conformance.host._case import HostCase
from j2a_conformance.host._device import FETCH, OLD
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
