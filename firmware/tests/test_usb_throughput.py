"""What the port avr-usb carries of what endpoint and cycles allow, in simulated time."""

import re

import pytest

from firmware.tests.usb_throughput import APP, CHIPS, TABLE, WIRE, page, rows

pytestmark = pytest.mark.avr


@pytest.fixture(scope="module")
def measured(build):
    """The rows of each chip."""

    def program(mcu, marks):
        settings = {"APP_DIR": str(APP), "MCU": mcu, "OPTIONS": f"-DRATES_MARKS={marks}"}
        return build("usb_rates", "avr-usb", core_as_one=False, **settings)

    return {mcu: rows(program(mcu, 0), program(mcu, 1), mcu) for mcu in CHIPS}


@pytest.mark.parametrize("mcu", CHIPS)
def test_nine_tenths_of_what_its_banks_can_carry(measured, mcu):
    for row in measured[mcu]:
        assert row.share >= 0.9, row


def test_nothing_is_faster_than_it_can_be(measured):
    """Else the cycles of a byte are not what is measured."""
    for row in (row for found in measured.values() for row in found):
        assert row.share <= 1.005, row
        assert row.can <= WIRE


def test_the_table_is_of_now(measured):
    """Within 2 %: how packets and polls fall together depends on the cycle at which each begins."""
    figures = [
        (re.sub(r"\d+\.\d", "", text), [float(figure) for figure in re.findall(r"\d+\.\d", text)])
        for text in (TABLE.read_text("utf-8"), page(measured))
    ]
    (words, committed), (words_now, now) = figures
    assert words == words_now
    assert committed == pytest.approx(now, rel=0.02), "usb_throughput.py --write renews it"
    assert len(now) == 4 * sum(map(len, measured.values()))
