"""Names of boards and topics."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from j2a_bridge import ros_messages, topics
from j2a_bridge.topics import Names, plain_name

from j2a.types.transds_file import read_transds

NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")


@given(st.text())
def test_each_name_is_one_for_ros(text):
    assert NAME.fullmatch(plain_name(text))


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("quad", "quad"),
        ("right one", "right_one"),
        ("a__b_", "a_b"),
        ("5 V", "x5_V"),
        ("", "x"),
        ("_", "x"),
        ("\u00e4rger", "rger"),
    ],
)
def test_names_stay_near_to_what_they_were(text, name):
    assert plain_name(text) == name


@given(
    st.lists(
        st.tuples(st.sampled_from(["a", "b", "a_2"]), st.sampled_from(["x", "x/y", "/", "x_2"])),
        unique=True,
        max_size=12,
    ),
    st.booleans(),
)
def test_no_two_share_a_topic_and_each_keeps_its_own(pairs, with_board):
    names = Names(with_board=with_board)
    transducers = {
        topic: read_transds(f"SENSOR(s{at}, {at}, s, M, 1, u8, none)").transducers[0]
        for at, topic in enumerate(("x", "x/y", "/", "x_2"))
    }
    found = {
        (board, topic): names.topic(board, transducers[topic], topic) for board, topic in pairs
    }
    assert len(set(found.values())) == len(pairs)
    for (board, topic), name in found.items():
        assert names.topic(board, transducers[topic], topic) == name
        for part in name.split("/"):
            assert NAME.fullmatch(part)


def test_a_board_that_calls_itself_a_novel_has_a_name_for_ros():
    names = Names(with_board=True)
    novel = {"name": "n" * 5000, "serial": "s" * 5000}
    assert names.board("1", "u1", novel) == "n" * 64
    assert names.board("2", "u2", novel) == "n" * 64 + "_" + "s" * 64
    assert names.board("3", "u3", {"name": "\u00e4" * 5000}) != "n" * 64


def test_a_name_that_is_taken_with_the_board_before_it_gets_a_number():
    names = Names(with_board=False)
    text = "".join(f"SENSOR(s{at}, {at}, s{at}, M, 1, u8, none)\n" for at in range(3))
    one, two, three = read_transds(text).transducers
    assert names.topic("arm", one, "level") == "level"
    assert names.topic("leg", one, "arm/level") == "arm/level"
    assert names.topic("arm", two, "level") == "arm/level_2"
    assert names.topic("arm", three, "level") == "arm/level_3"
    names.keep("arm", {"s0", "s2"})
    assert names.topic("arm", three, "level") == "arm/level_2"


def test_a_board_that_is_here_again_has_its_name():
    names = Names(with_board=True, boards={"B7": "left"})
    assert names.board("A3", "u1", {"name": "arm"}) == "arm"
    assert names.board("A4", "u2", {"name": "arm", "serial": "A4"}) == "arm_A4"
    assert names.board("A5", "u3", {"name": "arm"}) == "arm_2"
    assert names.board("B7", "u4", {"name": "arm"}) == "left"
    assert names.board("A4", "u9", {"name": "other"}) == "arm_A4"
    names.forget_board("A3")
    assert names.board("A6", "u5", {"name": "arm"}) == "arm"


@pytest.mark.parametrize("with_board", [False, True])
def test_a_board_that_is_forgotten_leaves_its_topics_to_others(with_board):
    names = Names(with_board=with_board)
    sensors = read_transds("SENSOR(a, 0, a, M, 1, u8, none)\nSENSOR(b, 1, b, M, 1, u8, none)\n")
    others = {}
    for identity, name in (("1", "leg"), ("2", "arm")):
        board = names.board(identity, f"u{identity}", {"name": name})
        found = [names.topic(board, one) for one in sensors.transducers]
        others[board] = found
    names.forget_board("1")
    board = names.board("3", "u3", {"name": "hip"})
    found = [names.topic(board, one) for one in sensors.transducers]
    assert found == [one.replace("leg/", "hip/") for one in others["leg"]]
    # The other board keeps its own.
    assert [names.topic("arm", one) for one in sensors.transducers] == others["arm"]


@pytest.mark.parametrize("chosen", [{}, {"S1": "arm", "S2": "arm"}, {"u2": "arm"}])
def test_of_boards_of_one_name_the_later_ones_have_their_serial_number(chosen):
    names = Names(with_board=True, boards=chosen)
    found = [
        names.board(serial, url, {"name": "arm", "serial": serial})
        for serial, url in (("S1", "u1"), ("S2", "u2"))
    ]
    assert found == ["arm", "arm_S2"]


def test_the_topic_of_the_diagnostics_is_taken():
    names = Names(with_board=False)
    [one] = read_transds("SENSOR(diagnostics, 1, d, M, 1, u8, none)").transducers
    assert names.topic("arm", one) == "arm/diagnostics"


@pytest.mark.parametrize("behind", ["range", "cmd", "configure", "joints", "imu_3", "fix"])
@pytest.mark.parametrize("with_board", [False, True])
@pytest.mark.parametrize("boards", [("arm", "arm"), ("arm", "leg")])
@pytest.mark.parametrize("is_reversed", [False, True])
def test_no_topic_is_what_sinks_publish_beside_another(
    caplog, behind, with_board, boards, is_reversed
):
    text = "SENSOR(one, 0, o, M, 1, u8, none)\nSENSOR(two, 1, t, M, 1, u8, none)\n"
    pairs = list(zip(boards, read_transds(text).transducers, ("a", f"a/{behind}"), strict=True))
    pairs = pairs[::-1] if is_reversed else pairs
    names = Names(with_board=with_board)
    found = {two.name: names.topic(board, two, wanted) for board, two, wanted in pairs}
    assert not found["two"].startswith(found["one"] + "/")
    # With the name of the board before it, those of two boards are apart as they are.
    assert len(caplog.records) == (0 if with_board and len(set(boards)) == 2 else 1)
    for board, two, wanted in pairs:
        assert names.topic(board, two, wanted) == found[two.name]
    assert len(caplog.records) <= 1


def test_a_name_that_sinks_use_is_free_where_no_topic_is_before_it():
    names = Names(with_board=False)
    [one] = read_transds("SENSOR(one, 0, o, M, 1, u8, none)").transducers
    assert names.topic("arm", one, "tank/range") == "tank/range"
    assert names.topic("arm", one, "range") == "range"


def test_all_that_stands_behind_a_topic_is_known():
    source = Path(ros_messages.__file__).read_text("utf-8")
    behind = {suffix for suffix, *_ in ros_messages._NUMBERS.values()}
    behind.update(re.findall(r'makers\.append\(\("(\w+)"', source))
    behind.update(re.findall(r'topic\.name\}/(\w+)"', source))
    assert {"range", "imu", "fix", "joints", "magnetic_field"} <= behind
    assert not [one for one in behind if not topics._BESIDE.fullmatch(one)]
