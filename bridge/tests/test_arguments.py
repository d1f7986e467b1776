"""What a user may write is taken, or refused by an error that says what is wrong."""

from typing import ClassVar

import pytest
from j2a_bridge import Option, Sink, command, command_fleet, command_view, sink_request
from j2a_bridge.sink import SinkError, port_of
from j2a_bridge.sink_request import SinkRequest, make_sink
from j2a_bridge.topics import Names, domain_of

from j2a import LocalError
from j2a.types.transds_file import read_transds

LONG = "1" * 5000  # more digits than Python makes a number of


@pytest.mark.parametrize(
    ("text", "port"),
    [("0", 0), ("65535", 65535), ("65536", None), ("", None), ("-1", None), (LONG, None)],
)
def test_a_port_is_a_number_that_there_is(text, port):
    assert port_of(text) == port


@pytest.mark.parametrize("name", ["mqtt:h:", "udp:h:", "foxglove:h:", "web:", "ros2:domain="])
def test_a_number_of_thousands_of_digits_is_refused(name):
    with pytest.raises(LocalError):
        make_sink(SinkRequest.parse(name + LONG), None)


def test_so_it_is_in_the_environment(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", LONG)
    with pytest.raises(LocalError, match="ROS_DOMAIN_ID is a number"):
        domain_of(-1)


@pytest.mark.parametrize("argument", ["fe80::1", "::1", "::1:1883", "[::1", "::1]:1883"])
def test_an_address_of_ipv6_without_brackets_is_no_other_broker(argument):
    with pytest.raises(LocalError, match="in brackets"):
        make_sink(SinkRequest("mqtt", argument), None)


@pytest.mark.parametrize("name", ["mqtt:a..b", "udp:a..b:9870"])
def test_what_cannot_be_the_name_of_a_host_fails_as_one_that_is_not_there(name):
    sink = make_sink(SinkRequest.parse(name), None)
    with pytest.raises(SinkError, match=r"a\.\.b"):
        sink.open()
    sink.close()


@pytest.mark.parametrize("name", ["clock", "rosout", "tf", "tf_static", "parameter_events"])
def test_a_topic_of_ros_is_no_sensor(name):
    [one] = read_transds(f"SENSOR({name}, 0, s, M, 1, u8, none)").transducers
    assert Names(with_board=False).topic("arm", one) == f"arm/{name}"
    assert Names(with_board=True).topic("arm", one) == f"arm/{name}"


class Broken:
    """An entry point of a package that does not load."""

    name = "broken"

    def load(self):
        raise SyntaxError("invalid syntax")


def test_a_package_that_is_broken_hides_no_other_sink(monkeypatch, installed):
    monkeypatch.setattr(sink_request, "sink_classes", lambda: installed | {"broken": Broken()})
    monkeypatch.setattr(command, "sink_classes", sink_request.sink_classes)
    listed = command.notes()
    assert "(does not load: SyntaxError: invalid syntax)" in listed
    assert "udp[:HOST:PORT]" in listed
    with pytest.raises(LocalError, match="the sink broken does not load: SyntaxError"):
        make_sink(SinkRequest("broken"), None)


class Wide(Sink):
    """A sink that has much to say."""

    SUMMARY = "much " * 30
    OPTIONS: ClassVar = {"wide": Option(str, "", "words " * 40)}


def test_no_help_is_wider_than_a_terminal(monkeypatch, installed):
    monkeypatch.setattr(command, "load_sink", lambda point: point if point is Wide else load(point))
    monkeypatch.setattr(command, "sink_classes", lambda: installed | {"wide": Wide})
    texts = command.notes(), command.NOTES, command_view.NOTES, command_fleet.NOTES
    for line in "\n".join(texts).splitlines():
        assert len(line) <= 80, line
    assert texts[0].count("much") == 30
    assert texts[0].count("words") == 40


load = sink_request.load_sink
