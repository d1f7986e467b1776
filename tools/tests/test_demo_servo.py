"""`make demo-servo`: a servo follows an encoder, as the host sets it."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parent.parent.parent


def demo(*args: str, root: Path = ROOT) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(root / "tools/demo_servo.py"), *args]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


@pytest.mark.avr
def test_each_pulse_is_as_wide_as_the_host_has_set() -> None:
    picture = ROOT / "build/demo-servo.svg"
    picture.unlink(missing_ok=True)
    done = demo("--swings", "1")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    count, right = next(
        (int(line.split()[0]), int(line.split()[2])) for line in lines if " pulses, " in line
    )
    assert count == right > 5
    rows = [line.split()[-4:] for line in lines if line.startswith(("sample at", "end of"))]
    for row in rows:
        times_ms = [float(cell) for cell in row]
        # A sample and its frame are some 20 bytes, at 87 us each.
        assert times_ms == sorted(times_ms)
        assert times_ms[0] > 1.0
    curves = ElementTree.fromstring(picture.read_text("utf-8")).findall("{*}polyline")
    assert [len(str(curve.get("points")).split()) for curve in curves] == [count] * 3


def test_no_swing_is_refused() -> None:
    done = demo("--swings", "0")
    assert done.returncode == 2
    assert "--swings is 1 or more" in done.stderr
