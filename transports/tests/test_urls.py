"""URLs, options and the table of drivers."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import j2a_transports
import pytest
from j2a_transports import BadUrl, MissingExtra, OpenFailed, Url, _registry


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("/dev/ttyUSB0", "serial:///dev/ttyUSB0"),
        ("COM3", "serial:COM3"),
        (r"\\.\COM12", r"serial:\\.\COM12"),
        ("localhost:5000", "tcp://localhost:5000"),
        ("192.168.1.7:5000", "tcp://192.168.1.7:5000"),
        ("[::1]:5000", "tcp://[::1]:5000"),
        ("./fw --flag", "exec:./fw --flag"),
        ("/usr/bin/fw", "exec:/usr/bin/fw"),
        (r"C:\fw.exe", r"exec:C:\fw.exe"),
        ("loop://", "serial:loop://"),
        ("rfc2217://host:1", "serial:rfc2217://host:1"),
    ],
)
def test_text_without_a_scheme_gets_the_url_that_was_meant(text: str, meant: str) -> None:
    for function in (j2a_transports.open, j2a_transports.listen):
        with pytest.raises(BadUrl) as caught:
            function(text)
        assert f"did you mean {meant} ?" in str(caught.value)
    assert Url.parse(meant).scheme in j2a_transports.schemes()


@pytest.mark.parametrize("text", ["", "fw", "ttyUSB0", ":x"])
def test_text_without_any_scheme(text: str) -> None:
    with pytest.raises(BadUrl, match="not a transport URL") as caught:
        j2a_transports.open(text)
    for name in ("serial", "usb", "bt", "tcp"):
        usage = j2a_transports.describe(name).open
        assert usage is not None
        assert usage.examples[0] in str(caught.value)


def test_the_examples_for_a_listener_can_listen() -> None:
    with pytest.raises(BadUrl, match=r"such as (.*)") as caught:
        j2a_transports.listen("nothing")
    assert "gadget:" in str(caught.value)
    assert "usb:" not in str(caught.value)


def test_an_unknown_scheme_lists_the_known_ones() -> None:
    with pytest.raises(BadUrl) as caught:
        j2a_transports.open("telnet://host")
    for scheme in ("serial", "tcp", "exec", "pty", "stdio", "loopback", "faults"):
        assert scheme in str(caught.value)
        assert scheme in j2a_transports.schemes()


def test_bad_urls_are_value_errors() -> None:
    with pytest.raises(ValueError, match="telnet"):
        j2a_transports.open("telnet://host")


WRONG = [
    ("serial:///dev/x?baude=3", "unknown option 'baude'; serial has: baud, bits,"),
    ("serial:///dev/x?baud=fast", "baud='fast' takes a whole number from 1 to"),
    ("serial:///dev/x?baud=0", "baud='0' takes a whole number from 1 to"),
    ("serial:///dev/x?parity=X", "parity='X' takes one of N, E, O, M, S"),
    ("serial:///dev/x?stopbits=3", "stopbits='3' takes one of 1, 1.5, 2"),
    ("serial:///dev/x?bits=9", "bits='9' takes a whole number from 5 to 8"),
    ("serial:///dev/x?dtr=maybe", "dtr='maybe' takes one of 0, 1, FALSE, TRUE, OFF, ON"),
    ("serial:///dev/x?boot=-1", "boot='-1' takes a number from 0 to 60"),
    ("serial:///dev/x?boot=nan", "boot='nan' takes a number from 0 to 60"),
    ("serial:///dev/x?baud", "'baud' is not an option of the form name=value"),
    ("serial:///dev/x?baud=1&baud=2", "option 'baud' is given twice"),
    ("serial:", "name a port, such as serial:///dev/ttyACM0 or serial:COM3; `j2a list` or"),
    ("serial://", "name a port"),
    ("serial:loop://?baude=3", "pyserial refuses it"),
    ("serial:nonsense://x", "pyserial refuses it"),
    ("tcp://host", "expected tcp://host:port"),
    ("tcp:host:5", "expected tcp://host:port"),
    ("tcp://:5000", "expected tcp://host:port"),
    ("tcp://host:65536", "a port up to 65535"),
    (f"tcp://host:{'9' * 5000}", "a port up to 65535"),
    ("tcp://a..b:5", "'a..b' cannot be a host name: "),
    (f"tcp://{'x' * 70}:5", "cannot be a host name: "),
    ("tcp://a\udcffb:5", "cannot be a host name: "),
    ("tcp://host:5?connect_timeout=0", "takes a number of seconds above 0, or none"),
    ("tcp://host:5?baud=5", "unknown option 'baud'; tcp has: connect_timeout, write_timeout"),
    ("exec:", "expected exec:program arguments"),
    ("exec:a 'b", "cannot be split: No closing quotation"),
    ("exec://fw", "write exec:fw without the slashes"),
    ("pty://fw", "write pty:fw without the slashes"),
    ("stdio:x", "nothing after the colon"),
    ("loopback:", "expected loopback:name"),
    ("loopback:a?b=c", "expected loopback:name"),
    ("faults:drop=0.1", "expected faults:seed=1,drop=0.001:inner-url"),
    ("faults:drop=2:loopback:x", "drop='2' takes a number from 0 to 1"),
    ("faults:dorp=0.1:loopback:x", "unknown option 'dorp'; faults has: burst,"),
    ("faults:drop=0.1:telnet:x", "unknown scheme 'telnet'"),
    ("faults:write_timeout=1:tcp://127.0.0.1:5?write_timeout=2", "given twice"),
    ("usb://zz:zz", "'zz:zz' names no USB board: write usb:// (the only board), usb://SERIAL"),
    ("usb://?interface=1", "interface= needs to know of which device"),
    ("usb://a?serial=b", "the serial number is given twice"),
    ("usb:///dev/null", "is no USB device file"),
    ("usb://a?b", "'b' is not an option of the form name=value"),
    ("bt://no", "expected bt://ADDRESS/CHANNEL"),
    ("bt://00:1A:7D:DA:71:13/31", "with a channel from 1 to 30"),
    ("bt://00:1A:7D:DA:71:13/1?service=J2A", "give a channel or service=NAME, not both"),
    ("gadget:", "gadget can only listen; these can be opened: "),
]


@pytest.mark.parametrize(("url", "says"), WRONG)
def test_a_bad_url_says_what_is_allowed(url: str, says: str) -> None:
    with pytest.raises(BadUrl) as caught:
        j2a_transports.open(url)
    assert says in str(caught.value)


# Which parameters its own URLs have, pyserial says when it opens them.
@pytest.mark.parametrize(("url", "says"), [one for one in WRONG if "loop://" not in one[0]])
def test_a_bad_url_is_refused_before_it_is_opened(url: str, says: str) -> None:
    for prefix in ("", "faults::"):
        with pytest.raises(BadUrl) as caught:
            j2a_transports.check(prefix + url)
        assert says in str(caught.value)


@pytest.mark.parametrize(
    "url",
    [
        "serial:///dev/none",
        "serial:loop://",
        "tcp://192.0.2.1:5000",
        "usb://",
        "usb://zz",
        "usb:///dev/none",
        "bt://00:1A:7D:DA:71:13",
        "exec:/none -x",
        "pty:/none",
        "stdio:",
        "loopback:none",
        "faults:drop=0.1:serial:///dev/none",
    ],
)
def test_a_url_of_what_is_not_there_is_right(url: str) -> None:
    j2a_transports.check(url)


def test_an_option_may_be_a_keyword_but_not_both() -> None:
    with pytest.raises(BadUrl, match="given twice"):
        j2a_transports.open("serial:///dev/x?baud=5", baud=5)
    with pytest.raises(BadUrl, match="unknown option 'baud'"):
        j2a_transports.open("exec:true", baud=5)


@pytest.mark.parametrize("host", ["a..b", "x" * 70])
def test_a_host_that_cannot_be_is_told_to_listeners_too(host: str) -> None:
    with pytest.raises(BadUrl, match="cannot be a host name"):
        j2a_transports.listen(f"tcp://{host}:5")


@pytest.mark.parametrize("url", ["exec:true", "exec:./fw"])
def test_what_cannot_listen_says_so(url: str) -> None:
    with pytest.raises(BadUrl, match="cannot listen"):
        j2a_transports.listen(url)


def test_every_driver_has_the_write_timeout() -> None:
    with j2a_transports.listen("loopback:timeouts", write_timeout="none") as listener:
        with j2a_transports.open(listener.url, write_timeout=2.5) as near:
            assert near.write_timeout_s == 2.5
            far = listener.accept(0)
            assert far is not None
            assert far.write_timeout_s is None
        with j2a_transports.open(f"faults:write_timeout=1.5:{listener.url}") as near:
            assert near.write_timeout_s == 1.5
        with j2a_transports.open(f"faults::{listener.url}", write_timeout=0.5) as near:
            assert near.write_timeout_s == 0.5


@pytest.mark.parametrize("limit", ["none", "inf", "1e308", "1e10", "2147484"])
def test_a_limit_longer_than_systems_can_wait_is_none(limit: str) -> None:
    with j2a_transports.listen("tcp://127.0.0.1:0") as listener:
        url = f"{listener.url}?connect_timeout={limit}&write_timeout={limit}"
        with j2a_transports.open(url) as near:
            assert near.write_timeout_s is None


def test_importing_the_package_loads_no_driver() -> None:
    code = (
        "import sys, j2a_transports; j2a_transports.schemes(); "
        "print(*sorted(m for m in sys.modules if m.startswith('j2a_transports.') or m == 'serial'))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == [
        "j2a_transports._base",
        "j2a_transports._registry",
        "j2a_transports._scheme",
        "j2a_transports._url",
        "j2a_transports.options",
    ]


def test_every_public_name_is_there_and_listed() -> None:
    listed = dir(j2a_transports)
    assert all(hasattr(j2a_transports, name) and name in listed for name in j2a_transports.__all__)
    assert not hasattr(j2a_transports, "nothing")


def test_a_missing_pyserial_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(MissingExtra, match=r"^serial:loop://: .* pip install pyserial "):
        j2a_transports.open("serial:loop://")


def test_a_package_that_hides_pyserial_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", sys)
    with pytest.raises(OpenFailed, match="pip uninstall serial"):
        j2a_transports.open("serial:loop://")


class ThirdParty:
    """What an entry point of another distribution names."""

    @staticmethod
    def open_url(url: Url) -> j2a_transports.Transport:
        options = url.options([], {"colour": str.upper})
        near, _ = j2a_transports.pair()
        near.url = f"{url.scheme} {url.rest} {options['colour']}"
        return near


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> None:
    here = f"{__name__}:ThirdParty"
    points = [
        EntryPoint("lamp", here, _registry.ENTRY_POINT_GROUP),
        EntryPoint("tcp", here, _registry.ENTRY_POINT_GROUP),
        EntryPoint("broken", "no_such_module_anywhere", _registry.ENTRY_POINT_GROUP),
    ]

    def entry_points(group: str, name: str | None = None) -> list[EntryPoint]:
        assert group == "j2a.transports"
        return [point for point in points if name in (None, point.name)]

    monkeypatch.setattr("importlib.metadata.entry_points", entry_points)


@pytest.mark.usefixtures("third_party")
def test_other_distributions_add_schemes() -> None:
    assert j2a_transports.schemes()[-2:] == ("broken", "lamp")
    with j2a_transports.open("lamp:desk", colour="red") as transport:
        assert transport.url == "lamp desk RED"
    with pytest.raises(BadUrl, match="lamp cannot listen"):
        j2a_transports.listen("lamp:desk")
    with pytest.raises(OpenFailed, match="no_such_module_anywhere does not load"):
        j2a_transports.open("broken:x")


@pytest.mark.usefixtures("third_party")
def test_other_distributions_cannot_take_over_a_scheme() -> None:
    with pytest.raises(BadUrl, match="expected tcp://host:port"):
        j2a_transports.open("tcp:desk")


@pytest.mark.usefixtures("third_party")
def test_a_driver_that_declares_nothing_is_described_by_what_it_has() -> None:
    lamp = j2a_transports.describe("lamp")
    assert lamp.open is not None
    assert lamp.open.summary == "(its driver does not describe it)"
    assert (lamp.name, lamp.open.options, lamp.listen) == ("lamp", (), None)
    with pytest.raises(OpenFailed, match="broken: the driver no_such_module_anywhere does not lo"):
        j2a_transports.describe("broken")
    with pytest.raises(BadUrl, match="did you mean tcp://desk:5000"):
        j2a_transports.open("desk:5000")
    with j2a_transports.open("lamp:5000", colour="red") as transport:
        assert transport.url == "lamp 5000 RED"
