"""The C core under sanitizers, in a flood of damaged frames; and that the flood finds faults."""

import os
import shutil
import subprocess

import pytest
from j2a_conformance.cli import main

SANITIZE = "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"
FRAMES = 30_000


@pytest.mark.parametrize("frames", [FRAMES, pytest.param(200_000, marks=pytest.mark.exhaustive)])
def test_damaged_frames_without_end(build_firmware, capsys, frames):
    program = build_firmware("builtins", CC="gcc", CFLAGS=SANITIZE)
    assert main(["faults", f"exec:{program}", "--soak", str(frames), "--seed", "7"]) == 0
    told = capsys.readouterr().out
    assert int(told.split()[0]) >= frames
    kinds = ["burst", "drop", "dup", "flip", "stall", "swap", "truncate"]
    for kind in (*kinds, "reset") if frames > FRAMES else kinds:  # a reset is seldom
        assert f" {kind}" in told


def test_a_fault_planted_in_the_core_is_found(need, tmp_path, capfd, pytestconfig):
    """A write behind the payload: the sanitizer ends the device, and five bytes show it."""
    need("gcc")
    before = "rx->payload[count] = byte;"
    after = "rx->payload[count + (byte == 0xFE ? 255 : 0)] = byte;"
    firmware = tmp_path / "firmware"
    shutil.copytree(pytestconfig.rootpath / "firmware", firmware, ignore=_leave_out_builds)
    parser = firmware / "core" / "j2a_rx.c"
    text = parser.read_text("utf-8")
    assert text.count(before) == 1
    parser.write_text(text.replace(before, after), "utf-8")
    env = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    command = ["make", "-s", "-C", firmware, "APP=builtins", "CC=gcc", f"CFLAGS={SANITIZE}"]
    subprocess.run(command, env=env, check=True)
    program = firmware / "build" / "posix" / "builtins"
    vector = tmp_path / "vector.json"
    arguments = ["faults", f"exec:{program}"]
    assert main([*arguments, "--vector", str(vector), "--seed", "7", "--soak", "20000"]) == 1
    assert "shortest bytes that show it (5 of " in capfd.readouterr().out
    assert main([*arguments, "--replay", str(vector)]) == 1


def _leave_out_builds(folder, names):
    return {"build"} & set(names)
