"""Without J2A_WITH_SYNC a device is the same, to the byte, as one whose sources have no clock.

The clock's own sources are taken away, and elsewhere each line that the option switches on is taken
out. What is linked then is compared with what the whole sources make with the option off.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).parents[1]
FOLDERS = ("apps", "core", "drivers", "ports")
OPTION = "J2A_WITH_SYNC"
BUILDS = [("avr-serial", "transducers"), ("avr-serial", "demo"), ("avr-usb", "demo")]


def without_clock(text):
    """The same lines, but those that only the option lets a compiler see are empty."""
    made = []
    dead = []  # of each open #if, whether its branch of now is the option's
    for line in text.split("\n"):
        directive, _, condition = line.strip().partition(" ")
        if directive in ("#endif", "#else", "#elif"):
            was_dead = dead.pop()
            if directive == "#else" and was_dead is None:
                dead.append(True)
            elif directive != "#endif":
                dead.append(is_option(directive, condition))
        elif re.match("#if(n?def)?$", directive):
            dead.append(is_option(directive, condition))
        made.append("" if directive[:1] != "#" and any(dead) else line)
    return "\n".join(made)


def is_option(directive, condition):
    """Whether a branch is the option's; None: the one behind it is the other way round."""
    parts = re.split(r"\s*&&\s*", condition)
    if directive not in ("#if", "#elif"):
        return False
    return None if parts == [f"!{OPTION}"] else OPTION in parts


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """The folder of the firmware without the clock."""
    folder = tmp_path_factory.mktemp("bare") / "firmware"
    for name in FOLDERS:
        shutil.copytree(FIRMWARE / name, folder / name)
    shutil.copy(FIRMWARE / "Makefile", folder)
    for path in folder.rglob("*.[ch]"):
        path.write_text(without_clock(path.read_text("utf-8")), "utf-8")
    for path in folder.glob("core/ext/j2a_clock*.c"):
        path.unlink()
    return folder


def build(folder, out, port, app, options=""):
    command = ["make", "-C", folder, f"PORT={port}", f"APP={app}", f"OUT={out}", "STACK=1"]
    return subprocess.run(
        [*command, f"OPTIONS={options}"], capture_output=True, text=True, check=False
    )


def linked(folder, out, port, app):
    """The bytes of an image, without the names of its sources."""
    result = build(folder, out, port, app)
    assert result.returncode == 0, result.stderr
    image = out / "image"
    subprocess.run(["avr-objcopy", "-S", out / f"{app}.elf", image], check=True)
    return image.read_bytes()


@pytest.mark.avr
@pytest.mark.sampled(2)  # both ports, and both apps
@pytest.mark.parametrize(("port", "app"), BUILDS)
def test_a_build_without_the_clock_is_that_of_sources_without_it(avr, bare, tmp_path, port, app):
    whole = linked(FIRMWARE, tmp_path / "whole", port, app)
    assert linked(bare, tmp_path / "bare", port, app) == whole


@pytest.mark.avr
def test_the_sources_without_the_clock_have_none(avr, bare, tmp_path):
    """Else the comparison would show nothing."""
    assert build(bare, tmp_path, "avr-serial", "demo", f"-D{OPTION}=1").returncode != 0
