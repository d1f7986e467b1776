"""Two links of one device at once: the Cortex-M port with LINKS=2, in QEMU, each UART on a socket.

Each host is answered as if it were alone, but for the time that functions of the other one take.
"""

import contextlib
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import accumulate, cycle
from pathlib import Path

import j2a_transports
import pytest
from j2a_conformance import Verdict, load, run
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

FIRMWARE = Path(__file__).parents[1]
DEMO = ("getTime", "add", "store", "ret", "delay", "sif", "sifPeriod", "overruns")
NAMES = [*c.BUILTINS, "a2jGetInterface", *DEMO]
OPCODE = {name: opcode for opcode, name in enumerate(NAMES)}
SIF_PERIODIC = 0x20
RXBUF = 520
PATIENCE_S = 60
QUIET_S = 0.2
SLOW = {  # several thousand frames; the testee cortex-m-two has them on one link
    "frame.interrupted-anywhere",
    "frame.lengths",
    "many.echo-lengths",
    "stuff.escape-ff-anywhere",
}
MANY_FRAMES = {  # tens or hundreds, and what they find is no matter of links
    "error.checksum-before-opcode",
    "error.reserved-codes",
    "error.seq",
    "frame.garbage",
    "frame.interrupted",
    "frame.noise-behind",
    "interface.chunks",
    "mapping.request-payload",
    "many.four-offset-bytes",
    "many.offsets",
    "many.reply-flags",
    "many.store",
    "many.write-flags",
    "many.wrong-function",
    "properties.content",
    "properties.direct",
    "seq.every-value",
    "seq.repeated",
    "stuff.replies",
    "sum.every-wrong-value",
    "types.values",
    "error.opcode-out-of-range",
    "frame.noise",
    "frame.pieces",
    "frame.sos-to-device",
    "sif.every-length",
    "stuff.needless",
    "sum.every-length",
    "types.bools",
    "types.lengths",
    "interface.behind-end",
    "many.called-directly",
    "many.flags",
    "properties.behind-end",
}


@pytest.fixture(scope="module")
def elf(need, make, tmp_path_factory):
    need("arm-none-eabi-gcc")
    need("qemu-system-arm")
    out = tmp_path_factory.mktemp("two")
    result = make(core_as_one=True, PORT="cortex-m", LINKS=2, OUT=out)
    assert result.returncode == 0, result.stderr
    return out / "demo.elf"


class Link:
    """One host's end."""

    def __init__(self, transport):
        self.transport = transport
        self.data = b""

    def send(self, *parts):
        self.transport.write(b"".join(encode(p) if isinstance(p, Frame) else p for p in parts))

    def frames(self, count, limit_s=PATIENCE_S):
        """So many frames, or as many as come within the limit."""
        end_s = time.monotonic() + limit_s
        while True:
            events = decode(self.data)
            whole = [event for event in events if isinstance(event, Frame)]
            if len(whole) >= count and isinstance(events[-1], Frame):
                self.data = b"".join(map(encode, whole[count:]))
                return whole[:count]
            if (left_s := end_s - time.monotonic()) <= 0:
                self.data = b""
                assert len(events) == len(whole), events
                return whole
            self.data += self.transport.read(left_s)

    def call(self, name, payload=b"", seq=1):
        """The payload that a call returns, and the SIFs that come before."""
        self.send(Frame(c.SOF, seq, OPCODE[name], payload))
        frames = []
        while not (frames and frames[-1].start == c.SOF):
            (frame,) = self.frames(1)
            frames.append(frame)
        assert (frames[-1].seq, frames[-1].opcode) == (seq, c.RET_OK)
        return frames[-1].payload, frames[:-1]

    def is_quiet(self):
        return self.frames(1, QUIET_S) == []


@contextlib.contextmanager
def started(elf):
    """Start a device; yields the two ends."""
    listeners = [j2a_transports.listen("tcp://127.0.0.1:0") for _ in range(2)]
    words = ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none"]
    for listener in listeners:
        address = listener.url.removeprefix("tcp://")
        words += ["-serial", f"tcp:{address},nodelay=on"]
    launcher = [sys.executable, FIRMWARE / "ports/common/qemu.py"]
    with subprocess.Popen([*launcher, *words, "-kernel", elf], stdin=subprocess.PIPE) as qemu:
        links = [Link(listener.accept(PATIENCE_S)) for listener in listeners]
        try:
            yield links
        finally:
            for end in (*(link.transport for link in links), *listeners):
                end.close()
            qemu.stdin.close()
            qemu.wait(PATIENCE_S)


@pytest.fixture
def hosts(elf):
    """The two ends; the device is new for each test."""
    with started(elf) as links:
        yield links


def echo(seq, payload=b""):
    return Frame(c.SOF, seq, OPCODE[c.GET_ECHO], payload)


def echoed(seq, payload=b""):
    return Frame(c.SOF, seq, c.ECHO, payload)


def numbered(sifs):
    """What these SIFs carry, once their sequence counters are seen to count from 0."""
    assert [sif.start for sif in sifs] == [c.SOS] * len(sifs)
    assert [sif.seq for sif in sifs] == [n % 256 for n in range(len(sifs))]
    return [(sif.opcode, sif.payload) for sif in sifs]


def test_sifs_go_to_the_link_that_asked(hosts):
    """Each link counts its own."""
    sent = [[], []]
    for n, link in enumerate((0, 1, 0, 0, 1, 0)):
        opcode, payload = 0x30 + link, bytes((n,)) * n
        sent[link] += hosts[link].call("sif", bytes((opcode,)) + payload, seq=n)[1]
        assert sent[link][-1] == Frame(c.SOS, len(sent[link]) - 1, opcode, payload)
    assert [len(numbered(sifs)) for sifs in sent] == [4, 2]
    assert all(host.is_quiet() for host in hosts)


def test_periodic_sifs_on_both(hosts):
    for host, period_ms in zip(hosts, (20, 5), strict=True):
        assert host.call("sifPeriod", bytes((period_ms, 0))) == (b"", [])
    for host in hosts:
        frames = numbered(host.frames(20))
        assert frames == [(SIF_PERIODIC, n.to_bytes(4, "little")) for n in range(20)]
    hosts[0].call("sifPeriod", bytes(2))
    assert hosts[0].is_quiet()
    assert hosts[1].frames(5)  # goes on
    hosts[1].call("sifPeriod", bytes(2))
    assert hosts[1].is_quiet()


def test_errors_stay_on_their_link(hosts, error):
    """Every kind of broken frame on one link, between good frames of the same seqs on the other."""
    good = encode(echo(7, b"abc"))
    wrong_sum = good[:-1] + bytes((good[-1] ^ 1,))
    broken = [
        (wrong_sum, error(7, c.ERR_CHECKSUM, c.SITE_CHECKSUM)),
        (good[:5] + good, error(7, c.ERR_FRAMING, c.SITE_MARKER)),
        (good[:5] + b"\x7d\xff", error(7, c.ERR_FRAMING, c.SITE_ESCAPE)),
        (good[:5], error(7, c.ERR_TIMEOUT, c.SITE_TIMEOUT)),
        (encode(Frame(c.SOF, 7, 0xEE)), error(7, c.ERR_OPCODE, c.SITE_OPCODE)),
    ]
    for bad, other in ((hosts[0], hosts[1]), (hosts[1], hosts[0])):
        for wire, refusal in broken:
            bad.send(wire)
            other.send(echo(7, b"other"))
            assert other.frames(1) == [echoed(7, b"other")]
            assert bad.frames(1) == [refusal]
            if wire.endswith(good):
                assert bad.frames(1) == [echoed(7, b"abc")]
        assert bad.is_quiet()
        assert other.is_quiet()


def test_half_a_frame_delays_nobody(hosts):
    """The longest frame comes in pieces; between them the other host is answered.

    A piece that comes later than the byte timeout, because this machine is busy, spoils an attempt.
    """
    payload = bytes((c.ESC,)) * 255
    for waiting, other in ((hosts[0], hosts[1]), (hosts[1], hosts[0])):
        end_s = time.monotonic() + PATIENCE_S
        for attempt in cycle(range(256)):
            assert time.monotonic() < end_s, "no pause of less than 9 ms in a minute"
            wire = encode(echo(attempt, payload))
            pieces = [wire[at : at + 40] for at in range(0, len(wire), 40)]
            for seq, piece in enumerate(pieces[:-1]):
                waiting.send(piece)
                other.send(echo(seq, b"meanwhile"))
                assert other.frames(1) == [echoed(seq, b"meanwhile")]
            waiting.send(pieces[-1])
            (answer,) = waiting.frames(1)
            if answer == echoed(attempt, payload):
                break
            assert (answer.seq, answer.opcode) == (attempt, c.ERR_TIMEOUT)
            assert waiting.is_quiet()


def test_overruns_are_those_of_the_link(hosts, error):
    """While a function runs for one host, the other one's buffer overflows, and only that one."""
    requests = [echo(seq, b"01234567") for seq in range(20, 100)]
    ends = list(accumulate(len(encode(request)) for request in requests))
    held = sum(end <= RXBUF for end in ends)
    assert RXBUF - ends[held - 1] >= 2  # of the next one, the start and the seq
    # The function begins directly behind the reply to the request that came with it.
    hosts[1].send(echo(1, b""), Frame(c.SOF, 0, OPCODE["delay"], (3000).to_bytes(2, "little")))
    assert hosts[1].frames(1) == [echoed(1, b"")]
    time.sleep(0.2)
    hosts[0].send(*requests)
    hosts[1].send(*requests[:held])
    expected = [echoed(request.seq, request.payload) for request in requests]
    assert hosts[1].frames(held + 1) == [Frame(c.SOF, 0, c.RET_OK), *expected[:held]]
    cut = error(requests[held].seq, c.ERR_FRAMING, c.SITE_LOST)
    assert hosts[0].frames(held + 1) == [*expected[:held], cut]
    assert hosts[0].is_quiet()
    assert hosts[0].call("overruns")[0] == b"\1\0"
    assert hosts[1].call("overruns")[0] == b"\0\0"


@pytest.mark.parametrize(
    "part",
    [
        "functions",
        *(pytest.param(part, marks=pytest.mark.exhaustive) for part in ("time", "frames")),
    ],
)
def test_conformance_of_both_at_once(elf, part):
    """Without debug text, of which there is one for the device: who asks first gets it.

    Those cases that measure time have a round of their own: a function that waits for one host
    keeps the other one waiting. That each link has byte timeouts of its own is seen above, too.
    """

    def part_of(case):
        if case.LEVEL == "timing":
            return "time"
        # Scenarios are sequences of what the other cases send one by one; one in three stays.
        kind, _, number = case.ID.partition("-")
        is_other = kind == "scenario" and int(number) % 3
        return "frames" if is_other or case.ID in MANY_FRAMES else "functions"

    cases = [
        case
        for case in load()
        if case.LEVEL != "debug" and case.ID not in SLOW and part_of(case) == part
    ]

    def judge(chosen, host):
        transport = host.transport
        return run(lambda: transport, chosen, url=transport.url, fresh=part != "time")

    def judge_both(chosen):
        with started(elf) as hosts, ThreadPoolExecutor(max_workers=2) as pool:
            return list(pool.map(partial(judge, chosen), hosts))

    found = judge_both(cases)
    failed = {r.case for each in found for r in each.with_verdict(Verdict.FAILED)}
    if failed:
        # QEMU may have stood still on a busy machine; what is wrong with the links shows again.
        found = judge_both([case for case in cases if case.ID in failed])
    for both in found:
        assert [(r.case, r.reason) for r in both.with_verdict(Verdict.FAILED)] == []
        assert both.conformant
        assert not both.stopped


def test_one_link_costs_nothing(need, make, tmp_path):
    """With all that is about several links edited out of the core, the AVR's image is the same."""
    need("avr-gcc")
    folder = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, folder, ignore=shutil.ignore_patterns("build", "corpus"))
    images, edited = [], []
    for _ in range(2):
        result = make(
            *("-C", folder), PORT="avr-serial", APP="builtins", LINKS=1, OUT=tmp_path / "out"
        )
        assert result.returncode == 0, result.stderr
        elf, image = tmp_path / "out/builtins.elf", tmp_path / "image"
        subprocess.run(["avr-objcopy", "-O", "binary", elf, image], check=True)
        images.append(image.read_bytes())
        edited.append([p.name for p in (folder / "core").rglob("j2a_*.[ch]") if without_links(p)])
        shutil.rmtree(tmp_path / "out")
    assert {"j2a_server.c", "j2a_rx.c"} <= {*edited[0]}
    assert edited[1] == []
    assert len(images[0]) > 1000
    assert images[0] == images[1]


def without_links(path):
    """Edit a source so that it knows of no links; returns whether that changed it."""
    text = path.read_text()
    edited = re.sub(r"\[J2A_LINKS\]|\[j2a_link\]|(?<=j2a_rx_of)\[0\]", "", text)
    edited = re.sub(r"(?ms)^#if J2A_LINKS > 1\n.*?^(?:#else\n(.*?)^)?#endif\n", r"\1", edited)
    path.write_text(edited)
    return edited != text
