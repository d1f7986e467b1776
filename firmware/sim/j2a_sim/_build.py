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

from j2a_sim import _prototypes
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
STOP_OUTPUT, STOP_SPAN, STOP_USB, STOP_WAKE = 1, 2, 4, 8
STATES = ("limbo", "stopped", "running", "sleeping", "step", "step", "done", "crashed")

_CHIP = Path(__file__).parent / "chip"
_HEADERS = ("simavr_shim.h", "usb_host.h")  # declare what Python calls
_PACKAGES = "on Debian and Ubuntu: apt install gcc libc6-dev libsimavr-dev"


def cache_directory() -> Path:
    """The folder that keeps what was compiled: `$XDG_CACHE_HOME/j2a`, or `~/.cache/j2a`."""
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


def not_writable(folder: Path, error: OSError) -> SimError:
    """What to say when a folder of the cache cannot be written to."""
    return SimError(f"cannot write to {folder}: {error.strerror}; set XDG_CACHE_HOME")


def _sealed(library_file: bytes) -> bytes:
    return library_file + hashlib.sha256(library_file).digest()


def _intact(path: Path) -> bool:
    try:
        data = path.read_bytes()
    except OSError:
        return False
    return data == _sealed(data[: -hashlib.sha256().digest_size])


def _compiler() -> list[str]:
    """The command that starts the C compiler: `$CC`, or cc."""
    given = os.environ.get("CC", "")
    try:
        return shlex.split(given) or ["cc"]
    except ValueError as error:
        raise SimError(f"CC={given} is no command: {error}") from None


def build() -> Path:
    """Compile the shim unless an up-to-date and undamaged one is cached.

    Returns:
        The path of the shared library.

    Raises:
        ToolMissing: no compiler, or no simavr development files.
        SimError: the compiler failed for another reason; its messages are in the text. Or CC is
            no command.
    """
    compiler = _compiler()
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
        raise not_writable(target.parent, error) from None
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
            raise not_writable(target.parent, error) from None
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
    for name in _HEADERS:
        _prototypes.apply(lib, (_CHIP / name).read_text("utf-8"))
    return lib
