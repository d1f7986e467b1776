"""`j2a ros export`: the package, as the tools of ROS read it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .support import PATIENCE_S, board_of, served

PYTHON = "/usr/bin/python3"
FILE = Path(__file__).parents[2] / "firmware/apps/transducers/transds.def"
ADAPTER = Path("/usr/lib/python3/dist-packages/rosidl_adapter")
needs_rosidl = pytest.mark.skipif(
    not ADAPTER.exists() and not os.environ.get("J2A_REQUIRE_AVR"),
    reason="needs Debian's python3-rosidl",
)
PARSE = """
import sys
from pathlib import Path
from rosidl_adapter.parser import parse_message_file
for path in sorted(Path(sys.argv[1]).glob("msg/*.msg")):
    message = parse_message_file("j2a_msgs", str(path))
    print(path.stem, *(f"{field.type} {field.name}" for field in message.fields), sep=";")
"""


def export(*words):
    command = [sys.executable, "-m", "j2a", "ros", "export", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@needs_rosidl
def test_the_parser_of_ros2_takes_each_message(tmp_path):
    folder = tmp_path / "j2a_msgs"
    result = export(FILE, folder, "-D", "TRANSDUCERS_NUMBERS")
    assert result.returncode == 0, result.stderr
    parsed = subprocess.run(
        [PYTHON, "-c", PARSE, str(folder)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    found = dict(line.split(";", 1) for line in parsed.stdout.splitlines())
    assert found["Plain"] == "builtin_interfaces/Time[] times;int16[] values"
    assert found["Imu"] == "builtin_interfaces/Time[] times;j2a_msgs/Motion[] values"
    assert len(found) == len(list(folder.glob("msg/*.msg")))
    assert f"with {len(found)} messages" in result.stdout


def test_a_board_gives_the_same_as_its_file(tmp_path):
    text = "SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1)\n"
    file = tmp_path / "transds.def"
    file.write_text(text)
    with served(board_of(text)) as url:
        assert export(url, tmp_path / "one", "--ros1").returncode == 0
    assert export(file, tmp_path / "other", "--ros1").returncode == 0
    found = [
        {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*.*")}
        for folder in (tmp_path / "one", tmp_path / "other")
    ]
    assert found[0] == found[1]
    assert found[0]["msg/quad.msg"] == "time[] times\nint16[] values\n"
    assert found[0]["srv/Configure.srv"].startswith("string[] names\n")


def test_a_package_is_renewed_and_anything_else_is_left_alone(tmp_path):
    file = tmp_path / "transds.def"
    file.write_text("SENSOR(one, 0, one, X, 1, u8, none)\n")
    folder = tmp_path / "j2a_msgs"
    assert export(file, folder).returncode == 0
    file.write_text("SENSOR(two, 0, two, X, 1, u8, none)\n")
    assert export(file, folder).returncode == 0
    assert [path.name for path in folder.glob("msg/*")] == ["Two.msg"]
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("x")
    result = export(file, other)
    assert result.returncode == 2
    assert "holds something else" in result.stderr
    assert [path.name for path in other.iterdir()] == ["thesis.tex"]
    result = export(file, other / "thesis.tex")
    assert result.returncode == 2
