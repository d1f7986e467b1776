"""The stack that ARM and RISC-V use in QEMU under a load, against the bound from the compiler.

In: the demo, and the load that the AVR's stack is measured under. Out: the bound holds, and is
not far above what was seen. QEMU's memory is zero at first, so what is not zero was written.
When an interrupt comes depends on this machine, so what is seen is a test and no figure.
"""

import json
import shlex
import socket
import sys
import time
from pathlib import Path

import j2a_transports
import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from firmware.verify.budget import avr_run, builds, runs, sizes

FIRMWARE = Path(__file__).parents[1]

ENTRY_BYTES = 12  # of the function table: two pointers and the kind
PATIENCE_S = 40
REPLY_S, TRIES = 2, 10
FREE = {  # from where to where the stack may grow
    "cortex-m": ("cortex_m_bss_end", "cortex_m_stack_top"),
    "riscv": ("bss_end", "stack_top"),
}


def memory(control, start, size, path):
    """Read physical memory by QEMU's own protocol."""
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(PATIENCE_S)
        link.connect(str(control))
        lines = link.makefile("rw")
        lines.readline()  # its greeting
        save = {"val": start, "size": size, "filename": str(path)}
        for command, arguments in (("qmp_capabilities", {}), ("pmemsave", save)):
            lines.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
            lines.flush()
            while "return" not in (answer := json.loads(lines.readline())):
                assert "error" not in answer, answer
    return path.read_bytes()


def answered(link, seq):
    """Whether the reply comes; SIFs may come before it."""
    got = b""
    end = time.monotonic() + REPLY_S
    while time.monotonic() < end:
        got += link.read(0.2)
        if any(
            isinstance(event, Frame) and (event.start, event.seq) == (c.SOF, seq)
            for event in decode(got)
        ):
            return True
    return False


@pytest.mark.avr
@pytest.mark.parametrize("port", ["cortex-m", "riscv"])
def test_bound_holds(port, missing, need, tmp_path):
    (build,) = (build for build in builds.load() if build.name == f"{port}/demo")
    try:
        bound = runs.measure(build, tmp_path, FIRMWARE).figures["bound"]
    except builds.ToolMissing as error:
        missing(str(error))
    need(build.emulator[0])
    elf = tmp_path / build.name / "demo.elf"
    symbols = sizes.symbols(elf)
    start, end = (symbols[name][0] for name in FREE[port])
    control = tmp_path / "qmp"
    words = [sys.executable, FIRMWARE / "ports/common/qemu.py", *build.emulator, "-kernel", elf]
    words += ["-qmp", f"unix:{control},server=on,wait=off"]
    with j2a_transports.open("exec:" + shlex.join(map(str, words))) as link:
        tables = (symbols[name][1] // ENTRY_BYTES for name in ("j2a_builtins", "j2a_functions"))
        functions = sum(tables) - 1  # the last one is no function
        for number, (opcode, payload) in enumerate(
            avr_run.requests(functions, has_many=True, room=c.MAX_PAYLOAD)
        ):
            # What follows makes interrupts come while the device works. QEMU's wire is faster than
            # a real one, so a device may lose bytes of it, and then is asked again.
            request = encode(Frame(c.SOF, number % 256, opcode, payload)) + bytes(40)
            for _ in range(TRIES):
                link.write(request)
                if answered(link, number % 256):
                    break
            else:
                raise AssertionError(f"no reply to opcode {opcode}")
        free = memory(control, start, end - start, tmp_path / "memory")
    used = len(free.lstrip(b"\0"))
    assert bound / 2 < used <= bound
