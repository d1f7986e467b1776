"""Debian's kernel for the test guest, and the archive that it unpacks as its first file system.

What flows in: the Debian package that linux-image-amd64 depends on, by apt-get. What flows out: the
uncompressed kernel and the modules of WANTED in a cache, and the bytes of an initramfs. Rules: a
filled cache needs no network and no apt; a damaged one is made anew; two runs at once make it only
once; nothing needs root.
"""

import fcntl
import hashlib
import json
import lzma
import os
import re
import shutil
import stat
import struct
import subprocess
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

# What is loaded at the start, in this order; each brings what it needs itself.
WANTED = (
    *("virtio_pci", "virtio_console", "9pnet_virtio", "9p", "virtio_net"),
    # USB: devices of USB/IP servers, a gadget with a host controller of its own, a kernel driver.
    *("vhci-hcd", "dummy_hcd", "libcomposite", "usb_f_fs", "usbserial"),
    # Controllers that QEMU emulates, and a view of what passes.
    *("xhci_pci", "ehci_pci", "uhci_hcd", "usbmon"),
    # Bluetooth: pairing takes its ciphers and hashes from the kernel by sockets.
    *("hci_vhci", "bluetooth", "rfcomm", "algif_hash", "algif_skcipher", "cmac", "ecb"),
)
MANIFEST = "manifest.json"
# The fields of a bzImage, from the boot protocol of x86: where its header says "HdrS", how many
# sectors of set-up code there are, and where the compressed kernel is behind them.
HEADER, SECTORS, PAYLOAD = 0x202, 0x1F1, 0x248


class GuestError(Exception):
    """The guest cannot run here; the message says what to do."""


def cache_folder() -> Path:
    """Return the folder for everything that the guest keeps."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "j2a" / "guest"


def kernel(folder: Path) -> Path:
    """Return the folder below `folder` with `vmlinux` and the modules; make it if need be.

    Raises:
        GuestError: it is not there and could not be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / "lock"):
        for found in sorted(folder.glob("linux-image-*"), key=lambda path: path.stat().st_mtime):
            if is_whole(found):
                return found
            shutil.rmtree(found)
        for unfinished in folder.glob("new-*"):
            shutil.rmtree(unfinished)
        return _fetch(folder)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Wait until no other process is in this block with the same `path`."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def is_whole(folder: Path) -> bool:
    """Are all files of this kernel there and unchanged, with all modules that are wanted?"""
    try:
        manifest: dict[str, str] = json.loads((folder / MANIFEST).read_text("utf-8"))
        return {f"{plain(name)}.ko" for name in WANTED} <= manifest.keys() and all(
            _digest(folder / name) == digest for name, digest in manifest.items()
        )
    except (OSError, ValueError):
        return False


def _fetch(folder: Path) -> Path:
    """Download the kernel, keep the few files of it that are needed, and return their folder."""
    for tool in ("apt-get", "apt-cache", "dpkg"):
        if shutil.which(tool) is None:
            raise GuestError(f"{tool} is missing: the guest's kernel is a package of Debian")
    listed = _run(folder, "apt-cache", "depends", "linux-image-amd64")
    found = re.search(r"Depends: (linux-image-\d\S*)", listed)
    if found is None:
        raise GuestError("apt-cache does not know linux-image-amd64: run apt-get update")
    package = found[1]
    with tempfile.TemporaryDirectory(dir=folder, prefix="new-") as scratch:
        # Programs of apt may run as another user, who has to reach the folder.
        new = Path(scratch)
        _run(new, "apt-get", "download", "-q", package)
        (archive,) = new.glob("*.deb")
        _run(new, "dpkg", "-x", str(archive), "root")
        kept = new / package
        kept.mkdir()
        (image,) = (new / "root/boot").glob("vmlinuz-*")
        (kept / "vmlinux").write_bytes(unpack_kernel(image.read_bytes()))
        modules = {
            plain(path.name.partition(".")[0]): path
            for path in (new / "root/lib/modules").glob("*/kernel/**/*.ko*")
        }
        builtin = "".join(path.read_text() for path in new.glob("root/lib/modules/*/*.builtin"))
        there = {plain(Path(line).stem) for line in builtin.split()}
        contents = Modules(modules)
        for name in load_order((one for one in WANTED if plain(one) not in there), contents):
            (kept / f"{name}.ko").write_bytes(contents[name])
        # A module that is a part of the kernel is an empty file.
        for name in there.intersection(map(plain, WANTED)):
            (kept / f"{name}.ko").touch()
        manifest = {path.name: _digest(path) for path in kept.iterdir()}
        (kept / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True), "utf-8")
        return kept.rename(folder / package)


class Modules(Mapping[str, bytes]):
    """Modules of the kernel, read and unpacked when they are asked for, by plain name."""

    def __init__(self, paths: Mapping[str, Path]) -> None:
        self._paths = paths

    def __getitem__(self, name: str) -> bytes:
        path = self._paths[name]
        data = path.read_bytes()
        return lzma.decompress(data) if path.suffix == ".xz" else data

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def _run(folder: Path, *command: str) -> str:
    """Run a program of Debian in `folder`; return what it printed."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "LC_ALL": "C"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise GuestError(
            f"{' '.join(command[:2])} failed, exit code {done.returncode}; without network, or with"
            f" old package lists (apt-get update)?\n{done.stderr.strip()}"
        )
    return done.stdout


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def unpack_kernel(image: bytes) -> bytes:
    """Return the ELF file inside a bzImage.

    Raises:
        GuestError: not a bzImage, or compressed in a way that Debian's kernels are not.
    """
    if image[HEADER : HEADER + 4] != b"HdrS":
        raise GuestError("the kernel is not a bzImage")
    offset, length = struct.unpack_from("<II", image, PAYLOAD)
    start = (image[SECTORS] + 1) * 512 + offset
    payload = image[start : start + length]
    try:
        if payload.startswith(b"\xfd7zXZ\0"):
            # Its size follows the compressed kernel: the decompressor stops before that.
            return lzma.LZMADecompressor().decompress(payload)
        if payload.startswith(b"\x1f\x8b"):
            return zlib.decompressobj(31).decompress(payload)
    except (lzma.LZMAError, zlib.error) as error:
        raise GuestError(f"the kernel is damaged: {error}") from error
    raise GuestError(f"the kernel is compressed in an unknown way: {payload[:6].hex()}")


def plain(name: str) -> str:
    """Return a module's name as the kernel writes it: files use - and _ as they like."""
    return name.replace("-", "_")


def depends(module: bytes) -> list[str]:
    """Return the modules that this one needs, by plain name, from its own description."""
    found = re.search(rb"\0depends=([^\0]*)\0", module)
    return [plain(name) for name in found[1].decode().split(",") if name] if found else []


def load_order(wanted: Iterable[str], modules: Mapping[str, bytes]) -> list[str]:
    """Return the plain names of `wanted` and all they need, each after what it needs itself."""
    order: list[str] = []

    def add(name: str) -> None:
        if name not in order:
            try:
                needed = depends(modules[name])
            except KeyError:
                raise GuestError(f"the kernel has no module {name}") from None
            for other in needed:
                add(other)
            order.append(name)

    for name in wanted:
        add(plain(name))
    return order


def initramfs(files: Mapping[str, bytes | int]) -> bytes:
    """Return an archive of the format newc, which the kernel unpacks at its start.

    Args:
        files: by path without a leading /: the content of a program or file, or the device number
            of a character device; folders come into being by themselves.
    """
    entries: dict[str, tuple[int, bytes | int]] = {}
    for path, content in files.items():
        for folder in reversed(Path(path).parents[:-1]):
            entries.setdefault(str(folder), (stat.S_IFDIR | 0o755, b""))
        kind = stat.S_IFCHR | 0o600 if isinstance(content, int) else stat.S_IFREG | 0o755
        entries[path] = (kind, content)
    entries["TRAILER!!!"] = (0, b"")
    out = bytearray()
    for inode, (name, (mode, content)) in enumerate(entries.items(), 1):
        data, device = (b"", content) if isinstance(content, int) else (content, 0)
        raw = name.encode() + b"\0"
        fields = (inode, mode, 0, 0, 1, 0, len(data), 0, 0)
        numbers = (*fields, os.major(device), os.minor(device), len(raw), 0)
        out += b"070701" + b"".join(b"%08x" % number for number in numbers) + raw
        out += bytes(-len(out) % 4) + data
        out += bytes(-len(out) % 4)
    return bytes(out)
