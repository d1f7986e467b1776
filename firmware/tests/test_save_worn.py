"""SAVE into a memory of which a byte is worn and takes nothing: it ends, and says so."""

import ctypes
from pathlib import Path

import pytest
from j2a_spec import constants as c

from firmware.tests.native_transducers import NEWEST, SECOND, NativeTransducers, build

pytestmark = pytest.mark.requirement("J2A-TRANS-028")
WORN = Path(__file__).parent / "transducers_worn/memory.c"
NOT_SAVED, SAVED, SAVING = (
    bytes((state,)) for state in (c.TRANSD_NOT_SAVED, c.TRANSD_SAVED, c.TRANSD_SAVING)
)
S = 1_000_000
TURN_US = 1000
LONGEST_US = 10 * S
RECORD = 5 + 2 + 5
"""Bytes of a record of a sensor: the mark, the CRC, ENABLED and PERIOD."""
PERIOD, OTHER = ((number).to_bytes(4, "little") for number in (0x11223344, 0x55667788))
STARTS = (5 * S, (1 << 32) - S)
"""Times at which the device begins: any one, and before 32 bits of the time wrap."""


@pytest.fixture(scope="module")
def library(need, tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("gcc")
    options = ("-DJ2A_WITH_SAVE=1", "-DJ2A_PORT_KEPT_BYTES=256")
    return build(tmp_path_factory.mktemp("worn"), sync=False, more=(*options, WORN))


@pytest.fixture(params=STARTS)
def device(library: Path, request) -> NativeTransducers:
    return NativeTransducers(library, request.param)


def save(device: NativeTransducers, one: int = NEWEST) -> bytes:
    """Save the settings of a sensor; return what SAVE then is, behind SAVING."""
    assert device.item(one, c.TRANSD_SAVE, b"\1") in (SAVING, SAVED)
    begin_us = device.now
    while (state := device.item(one, c.TRANSD_SAVE)) == SAVING:
        assert device.now - begin_us <= LONGEST_US
        device.turn(device.now + TURN_US)
    return state


@pytest.mark.sampled(2)  # each byte from one of the times, in turn
@pytest.mark.parametrize(
    ("device", "at"),
    [(start, at) for at in range(RECORD) for start in (STARTS if at % 2 else STARTS[::-1])],
    indirect=["device"],
)
def test_a_save_ends_at_each_byte(device: NativeTransducers, at: int) -> None:
    worn_at = device.variable("worn_at", ctypes.c_uint16)
    writes = device.variable("worn_writes", ctypes.c_uint32)
    device.item(NEWEST, c.TRANSD_PERIOD, PERIOD)
    assert save(device) == SAVED
    worn_at.value = RECORD + at
    device.item(NEWEST, c.TRANSD_PERIOD, OTHER)
    state = save(device)
    if writes.value == 0:  # a byte that is right already
        assert state == SAVED
        return
    assert state == NOT_SAVED
    # It is over: no more writes, and the others can be saved.
    before = writes.value
    device.turn(device.now + S)
    assert writes.value == before
    assert device.item(NEWEST, c.TRANSD_SAVE) == NOT_SAVED
    assert save(device, SECOND) == SAVED
    # What was saved before stays, and it can be tried again.
    device.item(NEWEST, c.TRANSD_PERIOD, PERIOD)
    assert save(device) == SAVED
    device.item(NEWEST, c.TRANSD_PERIOD, OTHER)
    assert save(device) == NOT_SAVED
    worn_at.value = 255
    assert save(device) == SAVED


def test_one_that_failed_is_saved_once_it_is_as_before(device: NativeTransducers) -> None:
    worn_at = device.variable("worn_at", ctypes.c_uint16)
    assert save(device) == SAVED
    worn_at.value = RECORD
    device.item(NEWEST, c.TRANSD_PERIOD, OTHER)
    assert save(device) == NOT_SAVED
    device.item(NEWEST, c.TRANSD_PERIOD, bytes(4))
    assert device.item(NEWEST, c.TRANSD_SAVE, b"\1") == SAVED
