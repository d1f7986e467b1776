"""What tools/guest.py does before and beside QEMU: the kernel's cache, the archive, the output."""

import gzip
import lzma
import os
import shutil
import stat
import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from .conftest import SCRIPT, tool

guest_kernel = tool("guest_kernel")
guest_script = tool("guest")
GuestError = guest_kernel.GuestError


def module(*needs):
    return b"\x7fELF\0license=GPL\0depends=%s\0retpoline=Y\0" % ",".join(needs).encode()


def image(payload, text="HdrS"):
    """A bzImage with one sector of set-up code."""
    head = bytearray(1024)
    head[0x1F1] = 1
    head[0x202:0x206] = text.encode()
    struct.pack_into("<II", head, 0x248, 16, len(payload))
    return bytes(head) + bytes(16) + payload + b"what follows"


# ---------------------------------------------------------------------------- modules


def test_each_module_comes_after_what_it_needs():
    modules = {
        "vhci_hcd": module("usbcore", "usbip-core"),
        "usbip_core": module("usbcore", "usb-common"),
        "usbcore": module("usb-common"),
        "usb_common": module(),
        "other": module(),
    }
    order = guest_kernel.load_order(["usb-common", "vhci-hcd", "usbcore"], modules)
    assert order == ["usb_common", "usbcore", "usbip_core", "vhci_hcd"]


@pytest.mark.parametrize("modules", [{}, {"vhci_hcd": module("usbcore")}])
def test_a_module_that_is_not_there_is_named(modules):
    with pytest.raises(GuestError, match=f"no module {'usbcore' if modules else 'vhci_hcd'}$"):
        guest_kernel.load_order(["vhci-hcd"], modules)


def test_a_module_without_description_needs_nothing():
    assert guest_kernel.depends(b"") == []
    assert guest_kernel.depends(module()) == []


# ---------------------------------------------------------------------------- the kernel


@pytest.mark.parametrize(
    "pack", [gzip.compress, lambda data: lzma.compress(data, check=lzma.CHECK_CRC32)]
)
def test_the_kernel_is_unpacked(pack):
    kernel = b"\x7fELF" + bytes(range(256)) * 100
    # As in a real one, its size stands behind it.
    assert guest_kernel.unpack_kernel(image(pack(kernel) + b"\0\1\0\0")) == kernel


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (image(b"", "Else"), "not a bzImage"),
        (b"short", "not a bzImage"),
        (image(b"\x02!L\x18...."), "unknown way: 02214c182e2e"),
        (image(b"\x1f\x8b and no more"), "damaged"),
        (image(b"\xfd7zXZ\0 and no more"), "damaged"),
    ],
)
def test_what_is_no_kernel_is_told(data, message):
    with pytest.raises(GuestError, match=message):
        guest_kernel.unpack_kernel(data)


# ---------------------------------------------------------------------------- the archive


def members(archive):
    """Read an archive of the format newc: (name, mode, device number, content)."""
    at = 0
    while True:
        assert archive[at : at + 6] == b"070701"
        numbers = [int(archive[at + 6 + 8 * i : at + 14 + 8 * i], 16) for i in range(13)]
        _, mode, *_, size, _, _, major, minor, name_size, _ = numbers
        at += 110
        assert archive[at + name_size - 1] == 0
        name = archive[at : at + name_size - 1].decode()
        at = (at + name_size + 3) & ~3
        if name == "TRAILER!!!":
            return
        yield name, mode, os.makedev(major, minor), archive[at : at + size]
        at = (at + size + 3) & ~3


def test_the_archive_holds_the_files_and_their_folders():
    files = {"init": b"#!", "a/b/c": b"12345", "a/d": b"", "dev/console": os.makedev(5, 1)}
    read = list(members(guest_kernel.initramfs(files)))
    assert [name for name, *_ in read] == ["init", "a", "a/b", "a/b/c", "a/d", "dev", "dev/console"]
    kinds = {name: (stat.S_IFMT(mode), device, data) for name, mode, device, data in read}
    assert kinds["init"] == (stat.S_IFREG, 0, b"#!")
    assert kinds["a/b"] == (stat.S_IFDIR, 0, b"")
    assert kinds["a/b/c"] == (stat.S_IFREG, 0, b"12345")
    assert kinds["dev/console"] == (stat.S_IFCHR, os.makedev(5, 1), b"")
    assert all(mode & 0o500 == 0o500 for name, mode, *_ in read if name != "dev/console")


def test_the_first_process_gets_its_settings(tmp_path):
    for name in guest_kernel.WANTED:
        (tmp_path / f"{guest_kernel.plain(name)}.ko").write_bytes(module())
    (tmp_path / "9p.ko").write_bytes(b"")  # a part of the kernel
    (tmp_path / "busybox").write_bytes(b"the busybox")
    (tmp_path / "busybox").chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(tmp_path))
        archive = guest_script.archive(tmp_path, {"here": "/a b/it's"}, "the job")
    files = {name: data for name, _, _, data in members(archive)}
    assert files["bin/busybox"] == b"the busybox"
    assert files["job"] == b"the job"
    assert files["settings"] == b"export here='/a b/it'\"'\"'s'\n"
    order = files["modules/order"].decode().split()
    assert order[:2] == ["virtio_pci", "virtio_console"]
    assert "9p" not in order
    assert {f"modules/{name}.ko" for name in order} <= files.keys()


def test_a_command_is_quoted_for_the_shell():
    words = ["printf", "%s|", "two words", "it's", "$HOME", "*"]
    done = subprocess.run(
        ["sh"], input=guest_script.job_script(words), capture_output=True, text=True, check=True
    )
    assert done.stdout == "two words|it's|$HOME|*|"


# ---------------------------------------------------------------------------- the output


@pytest.mark.parametrize("size", [1, 2, 5, 1000])
@pytest.mark.parametrize(
    "text", ["", "\n", "hello\n", "no end", "\n\nT\n", "T exit 9\n", "\nT exi"]
)
def test_output_comes_in_any_pieces(text, size):
    output = guest_script.Output("TOKEN")
    stream = f"{text}\nTOKEN exit 130\n".encode()
    shown = b""
    for at in range(0, len(stream), size):
        assert output.code is None
        shown += output.feed(stream[at : at + size])
    assert (shown.decode(), output.code) == (text, 130)


def test_output_without_an_end_is_shown_whole():
    output = guest_script.Output("TOKEN")
    assert output.feed(b"a\nTOKEN exit 1") + output.rest() == b"a\nTOKEN exit 1"
    assert output.code is None


def test_what_cannot_be_the_last_line_is_shown_at_once():
    output = guest_script.Output("TOKEN")
    assert output.feed(b"a\nTOK") == b"a"
    assert output.feed(b"i") == b"\nTOKi"


# ---------------------------------------------------------------------------- the cache

APT_CACHE = "#!/bin/sh\necho linux-image-amd64; echo '  Depends: linux-image-6.1.0-9-amd64'\n"
APT_GET = '#!/bin/sh\necho "$*" >>"$COUNT"; : >linux-image-6.1.0-9-amd64_6_amd64.deb\n'
DPKG = '#!/bin/sh\nset -e\ntest -f "$2"\ncp -r "$TREE" "$3"\n'
PACKAGE = "linux-image-6.1.0-9-amd64"


@pytest.fixture
def debian(tmp_path, monkeypatch):
    """Programs that behave as Debian's package tools, with a kernel of their own."""
    if (cp := shutil.which("cp")) is None:
        pytest.fail("cp is missing")
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "cp").symlink_to(cp)
    for name, text in {"apt-cache": APT_CACHE, "apt-get": APT_GET, "dpkg": DPKG}.items():
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    tree = tmp_path / "tree"
    folder = tree / "lib/modules/6.1.0-9-amd64"
    (folder / "kernel/some").mkdir(parents=True)
    for name in guest_kernel.WANTED[1:]:
        (folder / f"kernel/some/{name}.ko").write_bytes(module("common"))
    (folder / "kernel/some/common.ko.xz").write_bytes(lzma.compress(module()))
    (folder / "kernel/not-needed.ko").write_bytes(module())
    (folder / "modules.builtin").write_text(f"kernel/x/{guest_kernel.WANTED[0]}.ko\n")
    (tree / "boot").mkdir()
    (tree / "boot/vmlinuz-6.1.0-9-amd64").write_bytes(image(gzip.compress(b"kernel")))
    monkeypatch.setenv("PATH", str(programs))
    monkeypatch.setenv("TREE", str(tree))
    monkeypatch.setenv("COUNT", str(tmp_path / "count"))
    return tmp_path


def downloads(debian):
    return (debian / "count").read_text().splitlines()


def test_only_what_is_needed_is_kept(debian):
    found = guest_kernel.kernel(debian / "cache")
    assert found == debian / "cache" / PACKAGE
    assert (found / "vmlinux").read_bytes() == b"kernel"
    assert (found / "common.ko").read_bytes() == module()
    names = {f"{guest_kernel.plain(name)}.ko" for name in guest_kernel.WANTED}
    assert {path.name for path in found.iterdir()} == {
        *names,
        *("vmlinux", "common.ko", "manifest.json"),
    }
    assert {path.name for path in found.parent.iterdir()} == {PACKAGE, "lock"}


def test_it_is_downloaded_once_also_by_two_at_once(debian):
    with ThreadPoolExecutor() as pool:
        found = set(pool.map(guest_kernel.kernel, [debian / "cache"] * 4))
    assert len(found) == 1
    assert downloads(debian) == [f"download -q {PACKAGE}"]


@pytest.mark.parametrize("tool", ["apt-cache", "apt-get", "dpkg"])
def test_a_filled_cache_needs_no_program_and_an_empty_one_names_it(debian, tool):
    for name in ("one", "two"):
        if name == "two":
            (debian / "programs" / tool).unlink()
            with pytest.raises(GuestError, match=f"{tool} is missing"):
                guest_kernel.kernel(debian / "two")
        assert guest_kernel.kernel(debian / "one").name == PACKAGE


@pytest.mark.parametrize("name", ["vmlinux", "common.ko", "manifest.json"])
@pytest.mark.parametrize("damage", ["cut", "gone"])
def test_a_damaged_cache_is_made_anew(debian, name, damage):
    path = guest_kernel.kernel(debian / "cache") / name
    whole = path.read_bytes()
    if damage == "cut":
        path.write_bytes(whole[:-1])
    else:
        path.unlink()
    (debian / "cache/new-unfinished").mkdir()
    guest_kernel.kernel(debian / "cache")
    assert path.read_bytes() == whole
    assert len(downloads(debian)) == 2
    assert not (debian / "cache/new-unfinished").exists()


def test_a_cache_without_a_module_that_is_wanted_is_made_anew(debian, monkeypatch):
    guest_kernel.kernel(debian / "cache")
    monkeypatch.setattr(guest_kernel, "WANTED", (*guest_kernel.WANTED, "not-needed"))
    assert (guest_kernel.kernel(debian / "cache") / "not_needed.ko").exists()


def test_no_network_is_told_and_leaves_nothing(debian):
    failing = "#!/bin/sh\necho 'E: Could not resolve the host' >&2; exit 100\n"
    (debian / "programs/apt-get").write_text(failing)
    with pytest.raises(GuestError, match="failed, exit code 100; without network") as caught:
        guest_kernel.kernel(debian / "cache")
    assert str(caught.value).endswith("\nE: Could not resolve the host")
    assert [path.name for path in (debian / "cache").iterdir()] == ["lock"]


def test_no_package_lists_are_told(debian):
    (debian / "programs/apt-cache").write_text("#!/bin/sh\necho linux-image-amd64\n")
    with pytest.raises(GuestError, match="run apt-get update"):
        guest_kernel.kernel(debian / "cache")


def test_the_cache_is_where_caches_are(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert guest_kernel.cache_folder() == tmp_path / "j2a/guest"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert guest_kernel.cache_folder() == tmp_path / ".cache/j2a/guest"


# ---------------------------------------------------------------------------- the command line


@pytest.mark.parametrize(("tool", "package"), guest_script.PACKAGES.items())
def test_a_missing_program_is_named(tool, package, tmp_path):
    for name in guest_script.PACKAGES.keys() - {tool}:
        (tmp_path / name).symlink_to("/bin/true")
    done = subprocess.run(
        [sys.executable, SCRIPT, "--", "true"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)},
    )
    assert done.returncode == 125
    assert done.stderr == f"guest: {tool} is missing: install the package {package}\n"
    assert not (tmp_path / "j2a").exists()
