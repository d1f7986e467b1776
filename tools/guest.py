"""Run one command in a Linux guest of its own, with USB and Bluetooth that need no hardware.

tools/guest.py [options] -- COMMAND [ARGUMENT ...]

What flows in: a command line. What flows out: what it prints, and its exit code; 124 when the time
is over, 125 when the guest cannot run. Rules: Debian's kernel runs in QEMU, emulated unless --kvm;
it sees the host's files at the same paths, read-only, and can write to /run, /tmp and /dev/shm;
the command runs as root of the guest in the folder of the repository with .venv in its PATH;
10.0.2.2 is the host's 127.0.0.1.
"""

import argparse
import contextlib
import os
import secrets
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import guest_kernel
from guest_kernel import GuestError

ROOT = Path(__file__).resolve().parent.parent
QEMU = "qemu-system-x86_64"
PACKAGES = {QEMU: "qemu-system-x86", "busybox": "busybox-static", "setpriv": "util-linux"}
TIMED_OUT, CANNOT_RUN = 124, 125
LAST_S = 5.0
# What keeps the kernel from doing work that no job needs. Its clock is not the time stamp counter,
# whose rate it would measure while other programs make it wait, and get wrong.
COMMAND_LINE = (
    "console=ttyS0 quiet panic=-1 mitigations=off nokaslr clocksource=hpet"
    # Jobs may read the registers of an emulated controller beside its driver.
    " iomem=relaxed"
)


def tool(name: str) -> str:
    """Return the path of a program; GuestError says what to install."""
    found = shutil.which(name)
    if found is None:
        raise GuestError(f"{name} is missing: install the package {PACKAGES[name]}")
    return found


def job_script(command: Sequence[str]) -> str:
    """Return the shell script that runs `command` in the guest."""
    variables = {
        "PATH": f"{ROOT}/.venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": "/run",
        "LANG": "C.UTF-8",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUNBUFFERED": "1",
        "J2A_GUEST": "1",
    }
    there = shlex.quote(str(ROOT))
    return f"{script_of(variables)}cd {there}\nexec {shlex.join(command)}\n"


def script_of(variables: Mapping[str, str]) -> str:
    """Return the shell script that sets and exports variables."""
    return "".join(f"export {name}={shlex.quote(value)}\n" for name, value in variables.items())


def archive(kernel: Path, settings: Mapping[str, str], job: str) -> bytes:
    """Return the initramfs: the modules in `kernel`, variables for the start, and the script."""
    modules = {path.stem: path.read_bytes() for path in kernel.glob("*.ko")}
    order = [one for one in guest_kernel.load_order(guest_kernel.WANTED, modules) if modules[one]]
    return guest_kernel.initramfs(
        {
            "bin/busybox": Path(tool("busybox")).read_bytes(),
            "init": (ROOT / "tools/guest_init.sh").read_bytes(),
            "settings": script_of(settings).encode(),
            "job": job.encode(),
            "modules/order": "\n".join(order).encode(),
            **{f"modules/{name}.ko": modules[name] for name in order},
            "dev/console": os.makedev(5, 1),
            **{f"{folder}/.keep": b"" for folder in ("proc", "sys", "host")},
        }
    )


def machine(
    folder: Path, kernel: Path, *, cpus: int, memory: int, kvm: bool, more: Sequence[str] = ()
) -> list[str]:
    """Return the command line of QEMU: its standard output is the guest's port "job"."""
    options = {
        "accel": "kvm" if kvm else "tcg",
        "cpu": "qemu64,+rdrand",
        "m": str(memory),
        "smp": str(cpus),
        "kernel": str(kernel / "vmlinux"),
        "initrd": str(folder / "initramfs"),
        "append": COMMAND_LINE,
        "serial": f"file:{folder / 'console'}",
        "display": "none",
        "monitor": "none",
        "virtfs": "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
        "netdev": "user,id=net,ipv6=off",
        "chardev": "stdio,id=job,signal=off",
    }
    devices = (
        "virtio-net-pci,netdev=net,romfile=",
        "virtio-serial-pci",
        "virtserialport,chardev=job,name=job",
    )
    return [
        # However this program ends, the kernel ends QEMU with it; also if it has ended already.
        *(tool("setpriv"), "--pdeathsig=KILL"),
        *("/bin/sh", "-c", '[ "$PPID" = "$0" ] && exec "$@"', str(os.getpid())),
        *(tool(QEMU), "-nodefaults", "-no-reboot"),
        *(word for name, value in options.items() for word in (f"-{name}", value)),
        *(word for device in devices for word in ("-device", device)),
        *more,
    ]


@contextlib.contextmanager
def process(command: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start QEMU; it never outlives the block."""
    # Its port counts as connected while the input is open.
    started = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        yield started
    finally:
        started.kill()
        started.wait()


class Output:
    """What comes out of the guest: the job's output, and at last its exit code.

    Args:
        token: a word that no job prints; the last line begins with it.

    Attributes:
        code: the exit code, None as long as it has not come.
    """

    def __init__(self, token: str) -> None:
        self.code: int | None = None
        self._end = f"\n{token} exit ".encode()
        self._kept = b""

    def feed(self, data: bytes) -> bytes:
        """Take what came; return what can be shown. The start of a possible last line is kept."""
        self._kept += data
        before, found, after = self._kept.partition(self._end)
        if found and after.endswith(b"\n"):
            self.code = int(after)
            self._kept = b""
            return before
        last = len(before) if found else self._kept.rfind(b"\n")
        if last < 0 or not (found or self._end.startswith(self._kept[last:])):
            last = len(self._kept)
        shown, self._kept = self._kept[:last], self._kept[last:]
        return shown

    def rest(self) -> bytes:
        """Return what was kept, when nothing more comes."""
        return self._kept


def read_job(qemu: subprocess.Popen[bytes], token: str, deadline: float) -> int | None:
    """Show what the job prints until it ends; return its exit code, None if QEMU ended before.

    Raises:
        TimeoutError: `deadline` (of time.monotonic) has passed.
    """
    assert qemu.stdout is not None
    output = Output(token)
    with selectors.DefaultSelector() as selector:
        selector.register(qemu.stdout, selectors.EVENT_READ)
        while output.code is None:
            data = b""
            in_time = selector.select(max(0.0, deadline - time.monotonic()))
            if in_time:
                data = os.read(qemu.stdout.fileno(), 65536)
            show(output.feed(data))
            if not data:
                show(output.rest())
                if in_time:
                    return None
                raise TimeoutError
    return output.code


def run(args: argparse.Namespace) -> int:
    """Boot the guest, run the command, and return its exit code."""
    for name in PACKAGES:
        tool(name)
    kernel = guest_kernel.kernel(guest_kernel.cache_folder())
    start_s = time.monotonic()
    token = secrets.token_hex(8)
    with tempfile.TemporaryDirectory(prefix="j2a-guest-") as scratch:
        folder = Path(scratch)
        settings = {"token": token, "here": str(ROOT)}
        job = job_script(args.command)
        (folder / "initramfs").write_bytes(archive(kernel, settings, job))
        command = machine(
            folder,
            kernel,
            cpus=args.cpus,
            memory=args.memory,
            kvm=args.kvm,
            more=shlex.split(args.qemu),
        )
        with process(command) as qemu:
            try:
                code = read_job(qemu, token, start_s + args.timeout)
                if code is None:
                    # Its output may end a moment before it does.
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        qemu.wait(LAST_S)
            except TimeoutError:
                code = TIMED_OUT
                print(f"\nguest: no end after {args.timeout} s: killed", file=sys.stderr)
        console = folder / "console"
        log = console.read_text("utf-8", "replace").strip() if console.exists() else ""
        if log and (code in (None, TIMED_OUT) or args.verbose):
            print(f"guest: messages of the kernel:\n{log}", file=sys.stderr)
        if args.verbose:
            print(f"guest: {time.monotonic() - start_s:.1f} s", file=sys.stderr)
        if code is None:
            print(f"guest: QEMU has ended early, exit code {qemu.returncode}", file=sys.stderr)
            return CANNOT_RUN
        return code


def count(text: str) -> int:
    """Return a whole number from 1 up, for argparse."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return value


def show(data: bytes) -> None:
    """Print at once."""
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


def main() -> int:
    """Read the command line, run the guest, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--timeout", type=count, default=60, metavar="S", help="seconds (60)")
    parser.add_argument("--cpus", type=count, default=1, help="processors of the guest (1)")
    parser.add_argument("--memory", type=count, default=768, metavar="MIB", help="memory (768)")
    parser.add_argument("--kvm", action="store_true", help="let the host's processor run the guest")
    parser.add_argument("--qemu", default="", metavar="WORDS", help="more arguments for QEMU")
    parser.add_argument("--verbose", action="store_true", help="show the kernel's messages, too")
    parser.add_argument("command", nargs="+", metavar="COMMAND", help="the command to run")
    args = parser.parse_args()

    def ended(*_: object) -> NoReturn:
        raise SystemExit(128 + signal.SIGTERM)

    signal.signal(signal.SIGTERM, ended)
    try:
        return run(args)
    except GuestError as error:
        print(f"guest: {error}", file=sys.stderr)
        return CANNOT_RUN
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


if __name__ == "__main__":
    sys.exit(main())
