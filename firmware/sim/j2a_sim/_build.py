"""Compiles and loads the C half of the simulator on first use.

In: the C files in the folder chip, the system's C compiler, simavr's headers and library.
Out: the loaded library with its functions typed, shared by all simulators of the process.
The result is kept per user, named by a hash of the sources, the compiler command, and simavr's
version and headers: any change compiles anew, and processes that start at the same time each
write their own file and rename it into place, so none ever loads half a library. The file ends in
a hash of what is before it, which loaders ignore; a damaged file is compiled anew, because loading
one can crash the process.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

from j2a_sim._errors import SimError, ToolMissing

COUNTERS = (
    "bytes_in",
    "bytes_out",
    "overruns",
    "unheard",
    "rx_framing_errors",
    "tx_framing_errors",
    "tx_ignored",
    "queued",
)
USB_COUNTERS = (
    "transactions",
    "naks",
    "sofs",
    "bytes_in",
    "bytes_out",
    "wrong_toggles",
    "fifo_errors",
)
STOP_OUTPUT, STOP_SPAN, STOP_USB = 1, 2, 4
STATES = ("limbo", "stopped", "running", "sleeping", "step", "step", "done", "crashed")

_CHIP = Path(__file__).parent / "chip"
_PACKAGES = "on Debian and Ubuntu: apt install gcc libc6-dev libsimavr-dev"


def cache_directory() -> Path:
    """The folder that keeps the compiled library: `$XDG_CACHE_HOME/j2a`, or `~/.cache/j2a`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "j2a"


def _pkg_config() -> tuple[list[str], str]:
    """Compiler flags and version of simavr; the plain places when pkg-config is not installed."""
    tool = shutil.which("pkg-config")
    if tool:
        found = subprocess.run(
            [tool, "--cflags", "--libs", "simavr"], capture_output=True, text=True, check=False
        )
        version = subprocess.run(
            [tool, "--modversion", "simavr"], capture_output=True, text=True, check=False
        )
        if found.returncode == 0 and version.returncode == 0:
            return shlex.split(found.stdout), version.stdout.strip()
    return ["-I/usr/include/simavr", "-I/usr/local/include/simavr", "-lsimavr"], "unknown"


def _header_stamp(flags: list[str]) -> str:
    """Contents of the headers whose structures the shim was compiled with."""
    places = [flag[2:] for flag in flags if flag.startswith("-I")]
    stamps = []
    for place in places:
        header = Path(place) / "sim_avr.h"
        if header.is_file():
            stamps.append(hashlib.sha256(header.read_bytes()).hexdigest())
            for name in ("avr_uart.h", "avr_usb.h"):
                stamps.append(hashlib.sha256((header.parent / name).read_bytes()).hexdigest())
    if not stamps:
        raise ToolMissing(f"simavr's header sim_avr.h is not installed; {_PACKAGES}")
    return "".join(stamps)


def _not_writable(folder: Path, error: OSError) -> SimError:
    return SimError(f"cannot write to {folder}: {error.strerror}; set XDG_CACHE_HOME")


def _sealed(library_file: bytes) -> bytes:
    return library_file + hashlib.sha256(library_file).digest()


def _intact(path: Path) -> bool:
    try:
        data = path.read_bytes()
    except OSError:
        return False
    return data == _sealed(data[: -hashlib.sha256().digest_size])


def build() -> Path:
    """Compile the shim unless an up-to-date and undamaged one is cached.

    Returns:
        The path of the shared library.

    Raises:
        ToolMissing: no compiler, or no simavr development files.
        SimError: the compiler failed for another reason; its messages are in the text.
    """
    compiler = shlex.split(os.environ.get("CC", "")) or ["cc"]
    command = [*compiler, "-std=gnu11", "-O2", "-shared", "-fPIC"]
    flags, version = _pkg_config()
    digest = hashlib.sha256(repr((command, flags, version, platform.machine())).encode())
    digest.update(_header_stamp(flags).encode())
    sources = sorted(_CHIP.glob("*.[ch]"))
    for path in sources:
        digest.update(path.name.encode() + path.read_bytes())
    target = cache_directory() / f"simavr-shim-{digest.hexdigest()[:24]}.so"
    if _intact(target):
        return target
    if shutil.which(compiler[0]) is None:
        raise ToolMissing(f"no C compiler {compiler[0]!r} to build the simulator; {_PACKAGES}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        workplace = tempfile.TemporaryDirectory(prefix="build-", dir=target.parent)
    except OSError as error:
        raise _not_writable(target.parent, error) from None
    with workplace as folder:
        made = Path(folder) / target.name
        modules = [str(path) for path in sources if path.suffix == ".c"]
        result = subprocess.run(
            [*command, *modules, *flags, "-lm", "-o", str(made)],
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode:
            missing = "sim_avr.h" in result.stderr or "-lsimavr" in result.stderr
            kind = ToolMissing if missing else SimError
            hint = f"; {_PACKAGES}" if missing else ""
            raise kind(f"cannot compile the simulator's shim{hint}:\n{result.stderr.strip()}")
        try:
            made.write_bytes(_sealed(made.read_bytes()))
            made.replace(target)
        except OSError as error:
            raise _not_writable(target.parent, error) from None
    return target


@functools.cache
def library() -> ctypes.CDLL:
    """Load the shim, compiling it when needed.

    Returns:
        The library with argument and result types set.

    Raises:
        ToolMissing: no compiler, or no simavr.
        SimError: it does not compile or load.
    """
    path = build()
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        raise SimError(f"cannot load the simulator's shim {path}: {error}; {_PACKAGES}") from None
    integer = ctypes.c_int
    pointer, u8, u32, u64 = ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint32, ctypes.c_uint64
    u8s, u64s = ctypes.POINTER(u8), ctypes.POINTER(u64)
    text = ctypes.c_char_p
    types: dict[str, tuple[object, list[object]]] = {
        "sim_new": (
            pointer,
            [
                text,
                u32,
                ctypes.c_char,
                ctypes.c_double,
                text,
                u32,
                u32,
                text,
                text,
                ctypes.c_size_t,
            ],
        ),
        "sim_free": (None, [pointer]),
        "sim_reset": (None, [pointer]),
        "sim_run": (ctypes.c_int, [pointer, u64, ctypes.c_int]),
        "sim_cycle": (u64, [pointer]),
        "sim_pc": (u32, [pointer]),
        "sim_illegal": (ctypes.c_int, [pointer]),
        "sim_spans_on": (ctypes.c_int, [pointer]),
        "sim_data": (pointer, [pointer]),
        "sim_data_size": (u32, [pointer]),
        "sim_flash_size": (u32, [pointer]),
        "sim_log": (text, [pointer]),
        "sim_feed": (ctypes.c_int, [pointer, text, u32]),
        "sim_bit_cycles": (ctypes.c_double, [pointer]),
        "sim_char_bits": (ctypes.c_uint, [pointer]),
        "sim_receiver_on": (ctypes.c_int, [pointer]),
        "sim_counters": (None, [pointer, u64s]),
        "sim_out_count": (u32, [pointer]),
        "sim_span_count": (u32, [pointer]),
        "sim_take_out": (None, [pointer, u32, u8s, u64s]),
        "sim_take_spans": (None, [pointer, u8s, u64s, u64s]),
        "sim_interrupt": (ctypes.c_int, [pointer, ctypes.c_int, u64s]),
        "sim_clear_interrupts": (None, [pointer]),
        "sim_pin": (ctypes.c_int, [pointer, ctypes.c_char, ctypes.c_int]),
        "sim_pin_level": (ctypes.c_int, [pointer, ctypes.c_int]),
        "sim_watch": (None, [pointer, ctypes.c_int]),
        "sim_edge_count": (u32, [pointer, ctypes.c_int]),
        "sim_take_edges": (None, [pointer, ctypes.c_int, u64s, u8s]),
        "sim_waiting": (u32, [pointer]),
        "sim_drive": (None, [pointer, u64, ctypes.c_int, ctypes.c_int]),
        "sim_has_adc": (ctypes.c_int, [pointer]),
        "sim_conversions": (u64, [pointer]),
        "sim_set_volts": (None, [pointer, u64, ctypes.c_int, ctypes.c_double]),
        "sim_set_references": (None, [pointer, ctypes.c_double, ctypes.c_double]),
        "sim_usb": (pointer, [pointer]),
        "usb_host_plug": (None, [pointer, integer]),
        "usb_host_attached": (integer, [pointer]),
        "usb_host_set_counting": (None, [pointer, integer]),
        "usb_host_set_suspend_flags": (None, [pointer, integer]),
        "usb_host_lacks": (integer, [pointer]),
        "usb_host_state": (integer, [pointer]),
        "usb_host_reset": (None, [pointer, u64]),
        "usb_host_suspend": (None, [pointer]),
        "usb_host_resume": (None, [pointer]),
        "usb_host_frame": (u32, [pointer]),
        "usb_host_frame_start": (ctypes.c_double, [pointer]),
        "usb_host_frame_cycles": (ctypes.c_double, [pointer]),
        "usb_host_set_frame_cycles": (None, [pointer, ctypes.c_double]),
        "usb_host_address": (integer, [pointer]),
        "usb_host_set_address": (None, [pointer, integer]),
        "usb_host_clear_toggle": (None, [pointer, integer]),
        "usb_host_submit": (
            integer,
            [pointer, integer, integer, integer, u32, text, text, u32, integer],
        ),
        "usb_host_cancel": (None, [pointer, integer]),
        "usb_host_pending": (u32, [pointer]),
        "usb_host_completed": (u32, [pointer]),
        "usb_host_look": (None, [pointer, u64s]),
        "usb_host_take": (integer, [pointer, u8s]),
        "usb_host_counters": (None, [pointer, u64s]),
    }
    for name, (result, arguments) in types.items():
        function = getattr(lib, name)
        function.restype = result
        function.argtypes = arguments
    return lib
