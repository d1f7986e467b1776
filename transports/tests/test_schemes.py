"""What the drivers declare about their URL schemes agrees with what they do."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import metadata

import j2a_transports
import pytest
from j2a_transports import COMMON_OPTIONS, BadUrl, OpenFailed, Scheme, Url, Usage, _registry

SCHEMES = j2a_transports.schemes()


def usages(scheme: Scheme) -> list[Usage]:
    return [usage for usage in (scheme.open, scheme.listen) if usage is not None]


@pytest.mark.parametrize("name", SCHEMES)
def test_a_declaration_is_of_its_scheme_and_says_what_the_driver_can(name: str) -> None:
    declared = j2a_transports.describe(name)
    driver = _registry._driver(name, f"{name}:")
    assert declared.name == name
    assert (declared.open is not None) == hasattr(driver, "open_url")
    assert (declared.listen is not None) == hasattr(driver, "listen_url")
    assert usages(declared)
    if declared.extra:
        assert declared.extra in metadata("j2a").get_all("Provides-Extra", [])


@pytest.mark.parametrize("name", SCHEMES)
def test_the_forms_and_examples_are_urls_of_the_scheme(name: str) -> None:
    for usage in usages(j2a_transports.describe(name)):
        assert usage.summary
        for url in (usage.form, *usage.examples):
            assert Url.parse(url).scheme == name
        for example in usage.examples:
            if name != "faults":
                _, parts = Url.parse(example).split_query()
                Url.parse(example).options(parts, usage)


@pytest.mark.parametrize("name", SCHEMES)
def test_each_option_has_a_help_and_takes_its_default(name: str) -> None:
    for usage in usages(j2a_transports.describe(name)):
        options = (*usage.options, *COMMON_OPTIONS)
        names = [option.name for option in options]
        assert len(set(names)) == len(names)
        for option in options:
            assert option.help
            assert not option.help.endswith(".")
            assert option.convert.__doc__
        parsed = Url.parse(f"{name}:").options([], usage)
        assert parsed.keys() == {option.name for option in options if option.default}


def test_what_cannot_listen_or_be_opened_lists_what_can() -> None:
    with pytest.raises(BadUrl, match="exec cannot listen; these can: serial, gadget, bt, tcp, pty"):
        j2a_transports.listen("exec:true")
    with pytest.raises(BadUrl, match="gadget can only listen; these can be opened: serial, usb, b"):
        j2a_transports.open("gadget:")


def test_there_is_no_description_of_an_unknown_scheme() -> None:
    with pytest.raises(BadUrl, match="unknown scheme 'telnet'; known schemes: serial, usb, "):
        j2a_transports.describe("telnet")


@pytest.mark.parametrize(
    ("typed", "meant"), [("tpc", "tcp"), ("seriel", "serial"), ("usbb", "usb"), ("exce", "exec")]
)
def test_a_misspelt_scheme_gets_the_one_that_was_meant(typed: str, meant: str) -> None:
    with pytest.raises(BadUrl, match=f"scheme '{typed}'; did you mean '{meant}'. known schemes: "):
        j2a_transports.open(f"{typed}://there")


@pytest.mark.parametrize("scheme", ["loopback", "tcp"])
def test_a_known_scheme_is_no_host(scheme: str) -> None:
    with pytest.raises((BadUrl, OpenFailed)) as caught:
        j2a_transports.open(f"{scheme}:5000")
    assert "did you mean" not in str(caught.value)


def test_describing_all_schemes_loads_no_package_of_an_extra() -> None:
    code = (
        "import sys, j2a_transports as t\n"
        "for name in t.schemes(): t.describe(name)\n"
        "print(*sorted({'serial', 'usb', 'usb.core', 'libusb_package'} & sys.modules.keys()))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_opening_loads_one_driver() -> None:
    code = (
        "import sys, j2a_transports as t\n"
        "t.listen('tcp://127.0.0.1:0').close()\n"
        "drivers = {t._registry._DRIVERS[name] for name in t._registry._DRIVERS}\n"
        "print(*[name for name in drivers if f'j2a_transports{name}' in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["._tcp"]


def test_the_innermost_url_is_that_of_the_link_itself() -> None:
    for url, inner in (
        ("tcp://127.0.0.1:5000", "tcp://127.0.0.1:5000"),
        ("FAULTS:drop=0.1:Exec:./fw a:b", "Exec:./fw a:b"),
        ("faults:seed=1:faults::stdio:", "stdio:"),
    ):
        found, declared = j2a_transports.innermost(url)
        assert (found, declared.name) == (inner, inner.partition(":")[0].lower())
    for url in ("telnet://x", "faults:drop=1:telnet://x", "faults:", "no url"):
        with pytest.raises(BadUrl):
            j2a_transports.innermost(url)


def test_what_suite_and_commands_go_by_is_declared() -> None:
    declared = {name: j2a_transports.describe(name) for name in SCHEMES}
    assert {name for name in declared if declared[name].wraps} == {"faults"}
    assert {name for name in declared if declared[name].takes_stdio} == {"stdio"}
    assert {name for name in declared if declared[name].is_simulated} == {"sim"}
    assert {name for name in declared if declared[name].accepts_again} == {"tcp"}
    assert {name for name in declared if declared[name].held_bytes} == {"exec"}
