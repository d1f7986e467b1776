"""The file of a bridge: what it says, and what is wrong with it."""

import pytest
from j2a_bridge.config import MESSAGES, BoardConfig, Config, SensorConfig, load_config
from j2a_bridge.sink import Sink
from j2a_bridge.sink_request import SinkRequest, make_sink

from j2a import LocalError

from .support import Point

FILE = """
names = "board"
clock = "follow"

[[boards]]
url = "tcp://127.0.0.1:5000"
name = "left"
transducers.quad = { topic = "wheel/left", rate = 50, message = "raw" }
transducers.debug = { publish = false }

[[boards]]
serial = "A3"
name = "right"

[[sinks]]
use = "mcap"
to = "drive.mcap"
segment = 100

[[sinks]]
use = "udp"
"""


def test_all_that_it_may_say(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(FILE)
    config = load_config(path)
    assert (config.names, config.clock, config.usb, config.with_board) == (
        "board",
        "follow",
        False,
        True,
    )
    left, right = config.boards
    assert (left.url, left.name, right.identity) == ("tcp://127.0.0.1:5000", "left", "A3")
    assert left.transducers["quad"] == SensorConfig("wheel/left", 50.0, "raw", True)
    assert not left.transducers["debug"].is_published
    assert config.sinks == (
        SinkRequest("mcap", "drive.mcap", {"segment": 100}),
        SinkRequest("udp"),
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("nams = 'board'", "did you mean names"),
        ("names = 'long'", "one of short, board"),
        ("names = 1", "names of the file cannot be 1"),
        ("clock = 'set'", "one of discipline, follow, off"),
        ("usb = 1", "usb of the file cannot be 1"),
        ("boards = 'x'", "boards of the file cannot be 'x'"),
        ("boards = ['x']", r"\[\[boards\]\] is a table"),
        ("[[boards]]\nname = 'x'", "has a url, or the serial"),
        ("[[boards]]\nurl = 'tcp://x'\nnmae = 'x'", "did you mean name"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = 1", "the transducer q is a table"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = {rate = 0}", "rate of q"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = {rate = nan}", "rate of q"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = {rate = true}", "cannot be True"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = {topc = 'x'}", "did you mean topic"),
        (
            "[[boards]]\nurl = 'loopback:x'\ntransducers.q = {message = 'Range'}",
            "message of q is one of",
        ),
        (
            "[[boards]]\nurl = 'loopback:x'\ntransducers.q = {message = 'a/msg/Imu'}",
            "sensor_msgs/Imu, ",
        ),
        ("[[sinks]]\nto = 'x'", "says which one"),
        ("sinks = [1]", "says which one"),
        ("names = ", "Invalid value"),
        (f"[[boards]]\nurl = 'loopback:x'\ntransducers.q = {{rate = 1{'0' * 400}}}", "rate of q"),
        ("[[boards]]\nurl = 'loopback:x'\ntransducers.q = {rate = 1e-320}", "rate of q"),
        (
            "[[boards]]\nurl = 'loopback:x'\n[[boards]]\nurl = 'loopback:x'",
            "two .* have the url 'loopback:x'",
        ),
        ("[[boards]]\nserial = 'x'\n[[boards]]\nserial = 'x'", "two .* have the serial 'x'"),
        ("[[sinks]]\nuse = 'udp'\nto = 5", r"to of \[\[sinks\]\] is a text, not 5"),
        ("a = " + "[" * 20000, "nested too deep"),
    ],
)
def test_what_is_wrong_is_told_with_the_name_of_the_file(tmp_path, text, told):
    path = tmp_path / "robot.toml"
    path.write_text(text)
    with pytest.raises(LocalError, match=told) as caught:
        load_config(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("use = 'ros3'", "no sink 'ros3'"),
        ("use = 'mcap'", "needs more"),
        ("use = 'mcap'\nto = 'a.mcap'\nsegment = -1", "segment has 1 MiB or more, not -1"),
        ("use = 'udp'\nformt = 'json'", "no option formt"),
        ("use = 'udp'\nto = 'x'", "HOST:PORT"),
        ("use = 'zenoh'\ndomain = -5", "a domain is 0 to 232, not -5"),
        ("use = 'zenoh'\ndomain = 1.5", "domain of a sink is a whole number, not 1.5"),
        ("use = 'ros2'\ndomain = -5", "a domain is 0 to 232, not -5"),
    ],
)
def test_what_is_wrong_with_a_sink_is_told_with_the_name_of_the_file(tmp_path, text, told):
    path = tmp_path / "robot.toml"
    path.write_text(f"[[sinks]]\n{text}\n")
    [request] = load_config(path).sinks
    with pytest.raises(LocalError, match=told) as caught:
        make_sink(request, None)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_file_of_windows_begins_with_a_mark(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text("usb = true\n", encoding="utf-8-sig")
    assert load_config(path).usb


@pytest.mark.parametrize("message", [*MESSAGES, "sensor_msgs/msg/Imu"])
def test_messages_that_a_sensor_can_be(tmp_path, message):
    path = tmp_path / "robot.toml"
    path.write_text(f'[[boards]]\nurl = "loopback:x"\ntransducers.q = {{ message = "{message}" }}')
    assert load_config(path).boards[0].transducers["q"].message == message


@pytest.mark.parametrize(
    ("text", "request_"),
    [
        ("ros1", SinkRequest("ros1")),
        ("mcap:a.mcap", SinkRequest("mcap", "a.mcap")),
        ("mcap:a,b.mcap", SinkRequest("mcap", "a,b.mcap")),
        ("udp:[::1]:9870", SinkRequest("udp", "[::1]:9870")),
        ("udp:format=teleplot", SinkRequest("udp", "", {"format": "teleplot"})),
        ("udp,format=json", SinkRequest("udp", "", {"format": "json"})),
        ("mcap:a.mcap,segment=3", SinkRequest("mcap", "a.mcap", {"segment": "3"})),
    ],
)
def test_sinks_of_the_command_line(text, request_):
    assert SinkRequest.parse(text) == request_


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "names no sink"),
        (":x", "names no sink"),
        ("ros3", "there is no sink 'ros3'"),
        ("mcap", "needs more: mcap:FILE.mcap"),
        ("mcap:a.bag", "ends in .mcap"),
        ("mcap:a.mcap,segments=3", "has no option segments; it has: segment"),
        ("mcap:a.mcap,segment=x", "segment of a sink is a whole number"),
        ("udp:1.2.3.4", "udp sends to HOST:PORT"),
        ("udp:1.2.3.4:99999", "udp sends to HOST:PORT"),
        ("udp:format=xml", "json or teleplot"),
        ("udp,format=json,format=json", "given twice"),
        ("ros1:x", "takes nothing behind a colon"),
    ],
)
def test_sinks_that_cannot_be_are_told(text, told):
    with pytest.raises(LocalError, match=told):
        make_sink(SinkRequest.parse(text), None)


class Half(Sink):
    """Has one of the methods that each has to have."""

    def open(self):
        """Open nothing."""


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (
            Half,
            "the sink half lacks what each sink has: SUMMARY, announce, close, publish, retract",
        ),
        (print, "which is no subclass of Sink"),
    ],
)
def test_sinks_of_others_that_are_none_are_told(kind, told, monkeypatch):
    known = {"half": Point(kind)}
    monkeypatch.setattr("j2a_bridge.sink_request.sink_classes", lambda: known)
    with pytest.raises(LocalError, match=told):
        make_sink(SinkRequest("half", "", {}), None)


@pytest.mark.parametrize(
    ("names", "usb", "urls", "expected"),
    [
        ("", False, 1, False), ("", False, 2, True), ("", False, 0, True), ("", True, 0, True),
        ("", True, 1, True), ("short", True, 3, False), ("board", False, 1, True),
    ],
)  # fmt: skip
def test_only_one_board_alone_has_short_names(names, usb, urls, expected):
    boards = tuple(BoardConfig(url=f"tcp://127.0.0.1:{number}") for number in range(urls))
    config = Config((*boards, BoardConfig(identity="S")), usb=usb, names=names)
    assert config.with_board == expected


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("tpc://127.0.0.1:5000", "unknown scheme"),
        ("127.0.0.1:5000", "did you mean"),
        ("tcp://", "host:port"),
        ("tcp://127.0.0.1", "host:port"),
        ("tcp://127.0.0.1:70000", "host:port"),
        ("tcp://127.0.0.1:5000?colour=red", "unknown option"),
        ("faults:drop=0.1:tcp://", "host:port"),
        ("loopback", "write scheme:"),
        ("serial:", "name a port, such as serial:///dev/ttyACM0"),
        ("usb://zz:zz", "names no USB board"),
        ("sim:nothing?x", "'x' is not an option of the form name=value"),
        ("sim:", "name the firmware"),
    ],
)
def test_a_url_that_can_never_be_opened_is_told_with_file_and_key(tmp_path, url, why):
    file = tmp_path / "robot.toml"
    file.write_text(f'[[boards]]\nurl = "{url}"\n')
    with pytest.raises(LocalError) as error:
        load_config(file)
    assert str(error.value).startswith(f"{file}: url of [[boards]]: ")
    assert why in str(error.value)


@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        ('clock = "follow"', ("clock = 'never'", ", line 3")),
        ('serial = "A3"', ("seriel = 'A3'", ", line 12")),
        ("rate = 50", ("rate = -1", ", line 8")),
        ('message = "raw"', ("message = 1", ", line 8")),
        # Both boards have a name, and tomllib does not tell which of them it is.
        ('name = "right"', ("name = 1", "")),
    ],
)
def test_a_wrong_key_or_value_is_told_with_its_line_where_that_is_certain(tmp_path, wrong, place):
    path = tmp_path / "robot.toml"
    path.write_text(FILE.replace(wrong, place[0]))
    with pytest.raises(LocalError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}{place[1]}: ")


@pytest.mark.parametrize("key", ["url", "serial"])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_boards_are_told_from_each_other(tmp_path, key, count):
    same = f'[[boards]]\n{key} = "loopback:a"\n'
    others = f'[[boards]]\n{key} = "loopback:b"\n'
    path = tmp_path / "robot.toml"
    path.write_text(count * same + others, encoding="utf-8")
    if count == 1:
        assert len(load_config(path).boards) == 2
    else:
        with pytest.raises(LocalError, match=f"two .* have the {key} 'loopback:a'"):
            load_config(path)


@pytest.mark.parametrize(("rate", "is_one"), [
    ("1e-6", True), ("1", True), ("0.5", True), ("1000000", True), ("1e6", True),
    ("0.9e-6", False), ("0", False), ("-1", False), ("1000001", False), ("1e7", False),
    ("nan", False), ("inf", False), ("true", False),
])  # fmt: skip
def test_a_rate_is_one_that_times_can_show(tmp_path, rate, is_one):
    path = tmp_path / "robot.toml"
    path.write_text(
        f'[[boards]]\nurl = "loopback:a"\ntransducers.q = {{rate = {rate}}}\n', encoding="utf-8"
    )
    if is_one:
        assert load_config(path).boards[0].transducers["q"].rate_hz == float(rate)
    else:
        with pytest.raises(LocalError, match="rate"):
            load_config(path)


def test_a_file_without_an_end(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text("#" * ((1 << 20) + 1))
    with pytest.raises(LocalError, match=r"long\.toml: it has more than 1048576 characters"):
        load_config(path)
