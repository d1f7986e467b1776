"""`make demo-robot`: two boards in ROS 1, in ROS 2 and on the live page."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PAGE = ROOT / "bridge/j2a_bridge/page/uplot"
HAS_ALL = shutil.which("rosmaster") and shutil.which("chromium") and PAGE.is_dir()


@pytest.mark.avr
@pytest.mark.ros
@pytest.mark.skipif(
    not HAS_ALL and not os.environ.get("J2A_REQUIRE_AVR"),
    reason="needs python3-rospy, python3-rosmaster, chromium, and make page",
)
def test_both_ros_and_the_page_move_the_servo_and_see_all_sensors(tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    command = [sys.executable, str(ROOT / "tools/demo_robot.py"), "--picture", str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(re.findall(r"Received quad value -?\d+ from \d\d:\d\d:\d\d\.\d{6}", done.stdout)) > 3
    assert "ROS 1: servo to 60 %, the pulse at the pin is 1800 us" in done.stdout
    assert "ROS 2: servo to 20 %, the pulse at the pin is 1600 us" in done.stdout
    assert "the page: slider to -40 %, the pulse at the pin is 1300 us" in done.stdout
    for name in ("bumper", "cliff", "infrared", "ultrasonic", "gps", "ahrs"):
        assert f"the page: robot/{name}: " in done.stdout
    assert "clock " in done.stdout
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
