"""`make demo-robot`: two boards in ROS 1, in ROS 2 and on the live page."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from j2a_sim import AvrSim

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
    command += ["--seconds", "2"]  # all that is asserted is there as soon as by default
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(re.findall(r"Received quad value -?\d+ from \d\d:\d\d:\d\d\.\d{6}", done.stdout)) > 3
    assert "ROS 1: servo to 60 %, the pulse at the pin is 1800 us" in done.stdout
    assert "ROS 2: servo to 20 %, the pulse at the pin is 1600 us" in done.stdout
    assert "the page: slider to -40 %, the pulse at the pin is 1300 us" in done.stdout
    for name in ("bumper", "cliff", "infrared", "ultrasonic", "gps", "ahrs"):
        assert f"the page: robot/{name}: " in done.stdout
    clocks = re.findall(r"the page: (\w+): (.*), simulated time at ([\d.]+)% of", done.stdout)
    assert {name for name, _, _ in clocks} == {"shafts", "robot"}
    for _, told, pace in clocks:
        # On a busy machine simulated time falls behind, and no estimate of a clock is right.
        assert float(pace) < 99.5 or re.match("clock (locked|settling) ", told), done.stdout
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.avr
def test_simulated_time_can_keep_up_while_the_encoder_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(ROOT / "tools")
    demo_robot: Any = importlib.import_module("demo_robot")
    sim = AvrSim(demo_robot.build("servo", "avr-serial"))
    demo_robot.turn_encoder(sim)
    sim.boot()
    start_s, began_s = sim.time_s, time.process_time()
    sim.run(sim.cycles(3.0))
    assert sim.time_s - start_s > time.process_time() - began_s
