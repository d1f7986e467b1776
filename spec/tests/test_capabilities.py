"""The table of capabilities agrees with constants, requirements and documents."""

from collections.abc import Callable
from importlib.resources import files
from typing import get_args

import pytest
from j2a_spec import constants as c
from j2a_spec.capabilities import CAPABILITIES, FUNCTIONS, LEVELS, parse
from j2a_spec.generate import c_files, spec_text
from j2a_spec.requirements import Level, load

TEXT = files("j2a_spec").joinpath("capabilities.toml").read_text("utf-8")


def test_the_functions_of_version_1_0_have_kept_their_order() -> None:
    first = (c.GET_MAPPING, c.MANY, c.GET_PROPERTIES, c.GET_DEBUG, c.GET_ECHO, c.GET_ECHO_MANY)
    assert c.BUILTINS[: len(first)] == first
    assert {f.name for f in FUNCTIONS if not f.capability} == {c.GET_ECHO}
    assert {c.MANY, c.GET_PROPERTIES, c.GET_ECHO_MANY} <= c.WITH_MANY
    assert c.WITH_MANY.isdisjoint({c.GET_MAPPING, c.GET_DEBUG, c.GET_ECHO})


def test_every_level_is_that_of_requirements() -> None:
    assert get_args(Level) == LEVELS
    assert {requirement.level for requirement in load().values()} == set(LEVELS)


def test_the_requirements_of_an_area_are_of_the_level_of_its_capability() -> None:
    areas = {area: cap.level for cap in CAPABILITIES.values() for area in cap.areas}
    levels = {requirement.level for requirement in load().values() if requirement.area in areas}
    assert levels == set(areas.values())
    for requirement in load().values():
        if requirement.area in areas:
            assert requirement.level == areas[requirement.area], requirement.id


def test_each_capability_has_an_option_of_its_own() -> None:
    options = [capability.option for capability in CAPABILITIES.values()]
    assert len(set(options)) == len(options)
    for at, capability in enumerate(CAPABILITIES.values()):
        assert capability.default in {0, 1, *options[:at]}, capability.id


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('id = "debug"', 'id = "many"', "there are two"),
        ('needs = ["many"]', 'needs = ["sif"]', "properties: sif is not before it"),
        ('id = "sif"', 'id = "sif"\ntoken = "Sif"', "'Sif' is no token"),
        ('kind = "call"', 'kind = "one"', "there is no kind 'one'"),
        ('capability = "debug"', 'capability = "bug"', "a2jDebug: no capability 'bug'"),
        ('"a2jEchoMany"', '"a2jEcho"', "have the same name"),
    ],
)
def test_a_table_that_breaks_its_rules_is_refused(old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(ValueError, match=message):
        parse(TEXT.replace(old, new))


def test_functions_for_a2jmany_are_left_out_with_it() -> None:
    assert {function.name for function in FUNCTIONS if function.kind == "many"} <= c.WITH_MANY


@pytest.mark.parametrize("write", [c_files.options, c_files.builtins, spec_text.fill_levels])
def test_a_file_without_a_place_for_the_table_is_an_error(write: Callable[[str], str]) -> None:
    with pytest.raises(ValueError, match=r"^0 "):
        write("/* nothing */\n")
