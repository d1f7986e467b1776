"""The sensors of a robot on one board: nothing is lost, and there is room for more."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def robot_load():
    spec = importlib.util.spec_from_file_location("robot_load", ROOT / "tools/robot_load.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.avr
def test_all_sensors_at_their_top_rates(robot_load):
    load = robot_load.measure(robot_load.build(), 3.0)
    assert load.lost == 0
    assert not any(load.wrong.values())
    for name, rate in robot_load.RATES.items():
        assert 3 * rate - 1 <= load.counts[name] <= 3 * rate * 1.05 + 2, name
    assert 0.3 < load.wire < 0.5
    assert 0.2 < load.busy < 0.6
