"""What a gadget makes in configfs, what it says when it cannot, and that nothing of it stays."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import j2a_transports
import pytest
from j2a_transports import BadUrl, OpenFailed

if sys.platform != "linux":
    pytest.skip("gadgets exist on Linux only", allow_module_level=True)

from j2a_transports import UsbGadget
from j2a_transports._gadget.kernel import _ENDPOINT_DESCRIPTOR, Kernel

from .fake_gadget import UDC, FakeKernel, failure, installed


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeKernel:
    """The system that a gadget finds."""
    return installed(tmp_path, monkeypatch)


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """Each test has a name of its own, because the lock is the real one."""
    return f"test-{os.getpid()}-{abs(hash(request.node.nodeid))}"[:32]


def folder(kernel: FakeKernel, name: str) -> Path:
    return kernel.config / "usb_gadget" / name


def nothing_is_left(kernel: FakeKernel) -> bool:
    gadgets = kernel.config / "usb_gadget"
    return not list(kernel.run.iterdir()) and not (gadgets.is_dir() and list(gadgets.iterdir()))


def test_what_the_url_says_is_what_the_host_reads(kernel: FakeKernel, name: str) -> None:
    url = f"gadget:?name={name}&serial=A%201&vendor=1209&product=a2b1&manufacturer=We%26Co"
    with j2a_transports.listen(url, product_name="Thermometer", write_timeout=2) as gadget:
        assert gadget.url == "usb://1209:a2b1/A%201"
        made = folder(kernel, name)
        texts = {
            path: (made / path).read_text()
            for path in ("idVendor", "idProduct", "bcdDevice", "UDC")
        }
        assert texts == {
            "idVendor": "0x1209",
            "idProduct": "0xa2b1",
            "bcdDevice": "0x0100",
            "UDC": UDC,
        }
        strings = made / "strings" / "0x409"
        assert (strings / "serialnumber").read_text() == "A 1"
        assert (strings / "manufacturer").read_text() == "We&Co"
        assert (strings / "product").read_text() == "Thermometer"
        transport = gadget.accept(10)
        assert transport is not None
        assert transport.write_timeout_s == 2
        transport.close()
    assert nothing_is_left(kernel)


@pytest.mark.requirement("USB-004", "USB-005")
def test_without_options_it_has_a_serial_number_and_the_usual_ids(
    kernel: FakeKernel, name: str
) -> None:
    with UsbGadget(name=name) as gadget:
        made = folder(kernel, name)
        assert (made / "strings/0x409/serialnumber").read_text()
        assert (made / "idVendor").read_text() == "0x6666"
        assert (made / "idProduct").read_text() == "0xcafe"
        assert gadget.url.startswith("usb://6666:cafe/")


def test_sync_can_be_left_out(kernel: FakeKernel, name: str) -> None:
    with UsbGadget(name=name, sync=False):
        assert b"SyncUSB" not in kernel.descriptors[1]
    assert nothing_is_left(kernel)


@pytest.mark.parametrize(
    ("rest", "advice"),
    [
        ("?serial=", "1 to 126 characters"),
        ("?serial=" + "x" * 127, "1 to 126 characters"),
        ("?vendor=12", "four hexadecimal digits"),
        ("?name=a/b", "1 to 32 letters"),
        ("?buffer=0", "a whole number from 1"),
        ("?speed=high", "unknown option 'speed'; gadget has: buffer, manufacturer, name"),
        ("//0001", "write gadget: or gadget:.name=value"),
    ],
)
def test_wrong_urls(kernel: FakeKernel, rest: str, advice: str) -> None:
    with pytest.raises(BadUrl, match=advice):
        j2a_transports.listen(f"gadget:{rest}")
    assert nothing_is_left(kernel)


class TestWhatIsMissing:
    def fails(self, kernel: FakeKernel, name: str, **options: object) -> str:
        with pytest.raises(OpenFailed) as caught:
            UsbGadget("gadget:", name=name, **options)  # type: ignore[arg-type]
        return str(caught.value)

    @pytest.mark.parametrize("module", ["configfs", "libcomposite"])
    def test_no_gadgets_in_this_kernel(self, kernel: FakeKernel, name: str, module: str) -> None:
        kernel.has.remove(module)
        assert "sudo modprobe -a libcomposite usb_f_fs loads" in self.fails(kernel, name)
        assert nothing_is_left(kernel)

    def test_no_function_fs(self, kernel: FakeKernel, name: str) -> None:
        kernel.has.remove("usb_f_fs")
        assert "sudo modprobe usb_f_fs" in self.fails(kernel, name)
        assert nothing_is_left(kernel)

    def test_no_controller(self, kernel: FakeKernel, name: str) -> None:
        (kernel.controllers / UDC).rmdir()
        assert "dtoverlay=dwc2" in self.fails(kernel, name)
        kernel.controllers.rmdir()
        assert "no USB device controller" in self.fails(kernel, name)

    def test_which_controller(self, kernel: FakeKernel, name: str) -> None:
        (kernel.controllers / "other_udc.1").mkdir()
        assert f"choose one of the controllers: udc={UDC}, udc=other_udc.1" in self.fails(
            kernel, name
        )
        assert f"there is no third, but: udc={UDC}" in self.fails(kernel, name, udc="third")
        UsbGadget(name=name, udc=UDC).close()

    def test_a_controller_that_another_gadget_uses(self, kernel: FakeKernel, name: str) -> None:
        with UsbGadget(name=name):
            kernel.make(folder(kernel, "g1"))
            (folder(kernel, "g1") / "UDC").write_text(UDC)
        kernel.bind_error = errno.EBUSY
        text = self.fails(kernel, name)
        assert (
            f"the controller {UDC} is used by the gadget g1; free it with: echo | sudo tee" in text
        )
        kernel.remove(folder(kernel, "g1"))
        assert nothing_is_left(kernel)

    def test_a_controller_that_another_driver_uses(self, kernel: FakeKernel, name: str) -> None:
        (kernel.controllers / UDC / "function").write_text("g_ether\n")
        kernel.bind_error = errno.EBUSY
        assert f"the controller {UDC} is used by g_ether; unload" in self.fails(kernel, name)
        assert nothing_is_left(kernel)

    def test_a_controller_with_two_endpoints_only(self, kernel: FakeKernel, name: str) -> None:
        kernel.bind_error = errno.EINVAL
        assert "sync=0 makes do with two endpoints" in self.fails(kernel, name)
        assert "sync=0" not in self.fails(kernel, name, sync=False)
        assert nothing_is_left(kernel)

    def test_not_root(self, kernel: FakeKernel, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_args: object) -> None:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), "somewhere")

        for method in ("make", "mount", "write"):
            with monkeypatch.context() as patch:
                patch.setattr(kernel, method, refuse)
                kernel.root = False
                text = self.fails(kernel, name)
                assert text.startswith("gadget: a USB gadget is made by root: run it as root, with")
                kernel.root = True
                assert self.fails(kernel, name).startswith("gadget: the system does not allow it")
        assert not list(kernel.run.iterdir())

    def test_that_it_takes_root_is_said_before_what_else_is_missing(
        self, kernel: FakeKernel, name: str
    ) -> None:
        kernel.root = False
        kernel.has.clear()
        assert "with sudo; as it is, the kernel has no USB gadgets" in self.fails(kernel, name)

    @pytest.mark.parametrize("step", ["make", "write", "link", "mount", "open", "send"])
    def test_any_step_that_fails_is_undone(
        self, kernel: FakeKernel, name: str, monkeypatch: pytest.MonkeyPatch, step: str
    ) -> None:
        """Each call of the step fails once: first the first one, then the second, and so on."""
        function = getattr(kernel, step)
        for allowed in range(20):
            calls = iter(range(allowed))

            def limited(*args: object, calls=calls) -> object:
                if next(calls, None) is None:
                    raise failure(errno.EIO)
                return function(*args)

            with monkeypatch.context() as patch:
                patch.setattr(kernel, step, limited)
                try:
                    made = UsbGadget(name=name)
                except OpenFailed as error:
                    assert "Input/output error" in str(error)
                else:
                    assert allowed > 0
                    patch.undo()
                    made.close()
                    break
            # What the step itself would have removed is removed by the next run.
            UsbGadget(name=name).close()
            assert nothing_is_left(kernel)
        else:
            pytest.fail("it never succeeded")


@pytest.mark.parametrize("missing", ["file", "thread 0", "thread 1", "thread 2"])
def test_without_a_file_or_a_thread_nothing_is_left(
    kernel: FakeKernel, name: str, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    start, started = threading.Thread.start, []

    def refuse_file(_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    def refuse_thread(thread: threading.Thread) -> None:
        if f"thread {len(started)}" == missing:
            raise RuntimeError("can't start new thread")
        started.append(thread)
        start(thread)

    with monkeypatch.context() as patched:
        if missing == "file":
            patched.setattr("j2a_transports._poll.Waker.__init__", refuse_file)
        patched.setattr("threading.Thread.start", refuse_thread)
        with pytest.raises(OpenFailed, match=r"Too many open files|can't start new thread"):
            UsbGadget(name=name)
    assert not any(thread.is_alive() for thread in started)
    assert nothing_is_left(kernel)


class TestLeftOvers:
    def program(self, folder: Path, name: str, end: str) -> None:
        """Another program sets the gadget up, accepts a host, and ends in some way."""
        code = (
            "import os; from pathlib import Path\n"
            "from transports.tests.fake_gadget import FakeKernel\n"
            "from j2a_transports import UsbGadget\n"
            "from j2a_transports._gadget import gadget as module\n"
            f"kernel = FakeKernel(Path({str(folder)!r}))\n"
            "module.Kernel = lambda: kernel\n"
            f"gadget = UsbGadget(name={name!r})\n"
            f"link = gadget.accept(10)\nassert link is not None\n{end}\n"
        )
        # From 3.12 on Python warns of what is looked at here: a fork of a program with threads.
        command = [sys.executable, "-W", "ignore:This process:DeprecationWarning", "-c", code]
        result = subprocess.run(command, check=False, capture_output=True, text=True)
        assert (result.returncode, result.stderr) == (0, "")

    def test_what_a_killed_program_left_is_removed(
        self, kernel: FakeKernel, tmp_path: Path, name: str
    ) -> None:
        self.program(tmp_path, name, "os._exit(0)")
        assert folder(kernel, name).is_dir()
        # The mounts outlive the program; the kernel has closed its files and left the bus.
        kernel._mounts = {kernel.config, *kernel.run.iterdir()}
        with UsbGadget(name=name) as gadget:
            transport = gadget.accept(10)
            assert transport is not None
            transport.close()
        assert nothing_is_left(kernel)

    def test_a_program_that_ends_without_closing(self, tmp_path: Path, name: str) -> None:
        self.program(tmp_path, name, "")
        assert list((tmp_path / "config" / "usb_gadget").iterdir()) == []
        assert list((tmp_path / "run").iterdir()) == []

    @pytest.mark.parametrize(
        "end", ["sys.exit()", "gadget.close(); sys.exit()", "link.close(); sys.exit()"]
    )
    def test_a_child_process_leaves_the_gadget_to_its_parent(
        self, tmp_path: Path, name: str, end: str
    ) -> None:
        self.program(
            tmp_path,
            name,
            "import sys; child = os.fork()\n"
            f"if child == 0: {end}\n"
            "assert os.waitpid(child, 0)[1] == 0 and kernel.bound and not link.lost\n"
            "gadget_folder = kernel.config / 'usb_gadget' / gadget._files._identity.name\n"
            "assert (gadget_folder / 'UDC').read_text().strip()",
        )
        assert list((tmp_path / "config" / "usb_gadget").iterdir()) == []

    def test_what_a_running_program_uses_is_left_alone(self, kernel: FakeKernel, name: str) -> None:
        with UsbGadget(name=name) as first:
            with pytest.raises(OpenFailed, match=f"another program is the gadget {name}"):
                UsbGadget(name=name)
            transport = first.accept(10)
            assert transport is not None
            transport.close()
        assert nothing_is_left(kernel)

    def test_what_has_functions_of_others_is_left_alone(
        self, kernel: FakeKernel, name: str
    ) -> None:
        UsbGadget(name=name).close()
        kernel.make(folder(kernel, name))
        kernel.make(folder(kernel, name) / "functions" / "acm.0")
        for _ in range(2):
            with pytest.raises(OpenFailed, match=r"functions of others \(acm.0\)"):
                UsbGadget(name=name)
        assert (folder(kernel, name) / "functions" / "acm.0").is_dir()


def test_the_kernel_without_a_device_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The real system, where nothing can be made, says why and changes nothing."""
    if Path("/sys/class/udc").is_dir() and list(Path("/sys/class/udc").iterdir()):
        pytest.skip("this computer has a USB device controller")
    with pytest.raises(OpenFailed, match="gadget:"):
        j2a_transports.listen("gadget:")


def test_locks_of_the_kernel(name: str) -> None:
    first = Kernel().lock(name)
    assert first is not None
    assert Kernel().lock(name) is None
    first.close()
    second = Kernel().lock(name)
    assert second is not None
    second.close()


def test_a_lock_ends_with_its_program(name: str) -> None:
    code = (
        "from j2a_transports._gadget.kernel import Kernel; import time\n"
        f"lock = Kernel().lock({name!r}); print('held', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"held\n"
        assert Kernel().lock(name) is None
        child.send_signal(signal.SIGKILL)
    lock = Kernel().lock(name)
    assert lock is not None
    lock.close()


def test_attributes_are_written_in_one_piece_and_read_without_line_end(tmp_path: Path) -> None:
    path = tmp_path / "attribute"
    with pytest.raises(FileNotFoundError):
        Kernel().write(path, "x")
    path.touch()
    Kernel().write(path, "dummy_udc.0\n")
    assert Kernel().read(path) == "dummy_udc.0"
    assert Kernel().read(tmp_path / "none") == ""


def test_errors_of_mounting_name_the_place(tmp_path: Path) -> None:
    for action in (
        lambda: Kernel().mount("no-such-filesystem", "none", tmp_path),
        lambda: Kernel().unmount(tmp_path),
    ):
        with pytest.raises(OSError) as caught:
            action()
        assert caught.value.errno in (errno.ENODEV, errno.EPERM, errno.EINVAL)
        assert caught.value.filename == str(tmp_path)


def test_the_number_of_the_request_for_an_endpoint_descriptor() -> None:
    # From a C program that prints FUNCTIONFS_ENDPOINT_DESC.
    assert _ENDPOINT_DESCRIPTOR == 0x80096782
