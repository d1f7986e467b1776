"""A host that does not read: the port waits to send, and actuators are served meanwhile.

A hung host program is what a watchdog is for (J2A-TRANS-016 to 018).
"""

import fcntl
import subprocess
import time
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

from firmware.tests.native_transducers import (
    NEWEST,
    PAIR,
    QUEUED,
    SAFE,
    SERVO,
    TRIGGERED,
    NativeTransducers,
    build,
)
from firmware.tests.transds_app import app_task

LIMIT_MS = 500
BLOCKED_MS = 3000
MS = 1000

pytestmark = pytest.mark.requirement("J2A-TRANS-016", "J2A-TRANS-017", "J2A-TRANS-018")


@pytest.fixture(scope="module", params=[False, True], ids=["port's time", "clock"])
def library(need, tmp_path_factory: pytest.TempPathFactory, request) -> Path:
    need("gcc")
    return build(tmp_path_factory.mktemp("transducers"), request.param)


@pytest.fixture
def device(library):
    made = NativeTransducers(library, 1_000_000)
    made.item(SERVO, c.TRANSD_WATCHDOG, LIMIT_MS.to_bytes(2, "little"))
    made.item(SERVO, c.TRANSD_SET, bytes(9) + b"\5\0")
    made.turn()
    assert [value for _, value in made.told()] == [5]
    return made


def test_a_watchdog_runs_out_once_while_a_sample_waits_to_be_sent(device):
    heard_us = device.now
    device.sense(NEWEST, 1)
    device.block(BLOCKED_MS)
    assert device.turn()
    [(at_us, value)] = device.told()
    assert value == SAFE
    assert LIMIT_MS < (at_us - heard_us) / MS <= LIMIT_MS + 3
    for _ in range(3):
        device.turn(device.now + MS)
    assert device.told() == []
    device.item(SERVO, c.TRANSD_SET, bytes(9) + b"\6\0")
    assert [value for _, value in device.told()] == [6]


def test_a_watchdog_runs_out_while_a_reply_waits_to_be_sent(device):
    device.block(BLOCKED_MS)
    began_us = device.now
    device.item(SERVO, c.TRANSD_WATCHDOG)
    device.turn()
    [(at_us, value)] = device.told()
    assert (value, at_us - began_us) == (SAFE, pytest.approx(LIMIT_MS * MS, abs=3 * MS))


def test_orders_are_executed_at_their_times_while_a_sample_waits_to_be_sent(device):
    due_us = [device.now + after * MS for after in (100, 200, 300, 400)]
    for channel in (0, 1):
        value = bytes((channel,)) + due_us[channel].to_bytes(8, "little") + b"\1\0"
        device.item(PAIR, c.TRANSD_SET, value)
    device.item(NEWEST, c.TRANSD_TRIGGER, due_us[2].to_bytes(8, "little"))
    device.item(SERVO, c.TRANSD_SET, b"\0" + due_us[3].to_bytes(8, "little") + b"\7\0")
    device.sense(NEWEST, 1)
    device.block(450)
    assert device.turn()
    told = device.told()
    assert [value for _, value in told] == [1, 1, TRIGGERED, 7]
    for (at_us, _), due in zip(told, due_us, strict=True):
        assert due <= at_us <= due + MS


def test_a_driver_that_is_called_is_not_called_again_from_within(device):
    """As where it waits to send something of its own."""
    device.wait_in_drivers(5)
    device.item(PAIR, c.TRANSD_SET, bytes(9) + b"\1\0\2\0")
    device.sense(NEWEST, 1)
    device.block(BLOCKED_MS)
    device.turn()
    assert [value for _, value in device.told()] == [1, 2, SAFE]


@pytest.mark.requirement("J2A-TRANS-006", "J2A-BOOT-001")
def test_values_wait_until_the_link_is_up(need, tmp_path):
    """They are not taken out of the queue for a SIF that is not sent."""
    need("gcc")
    device = NativeTransducers(build(tmp_path, False, boot=True), 1_000_000, is_up=False)
    for value in (1, 2):
        device.sense(QUEUED, value)
        assert device.turn(device.now + MS) == []
    device.be_up(True)
    (boot, _), (sensor, payload) = device.turn() + device.turn()
    assert (boot, sensor) == (c.BOOT, QUEUED)
    assert payload[:2] == b"\0\0"  # none is lost
    assert [payload[at + 9 : at + 11] for at in (2, 13)] == [b"\1\0", b"\2\0"]


TRANSDS = """\
SENSOR(quick, 0, quick, X, 1, u16, none)
ACTUATOR(servo, 1, servo, X, 1, u16, 7, (watchdog, 500))
"""
CODE = """
#include "transds.h"
static void (*quick)(uint8_t channel, uint16_t value);
void quick_set_cb(void (*callback)(uint8_t channel, uint16_t value)) { quick = callback; }
void servo_set(uint8_t channel, uint16_t value) { (void)channel; (void)value; }
""" + app_task("quick(0, 1);")


def replies_in(data: bytes) -> list[Frame]:
    return [one for one in decode(data) if isinstance(one, Frame) and one.start == c.SOF]


def test_a_process_whose_output_nobody_reads(build_firmware, tmp_path):
    """Its pipe is full soon, and stays so for 2 s."""
    folder = tmp_path / "app"
    folder.mkdir()
    for name, text in (
        ("transds.def", TRANSDS),
        ("app.c", CODE),
        ("functions.def", ""),
        ("properties.def", 'J2A_PROPERTY("name", "blocked")\n'),
    ):
        (folder / name).write_text(text)
    program = build_firmware("app", APP_DIR=folder)
    with subprocess.Popen(
        [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as process:
        assert process.stdin
        assert process.stdout
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        names = [*c.BUILTINS, c.GET_TRANSDS, c.TRANSD]
        transd = names.index(c.TRANSD)
        requests = (c.TRANSD_TIME, b""), (c.TRANSD_SET, bytes(9) + b"\5\0")
        for seq, (item, value) in enumerate(requests):
            process.stdin.write(encode(Frame(c.SOF, seq, transd, bytes((1, item)) + value)))
        got = b""
        while len(replies_in(got)) < len(requests):
            got += process.stdout.read(4096)
        time.sleep(2)
        process.stdin.write(encode(Frame(c.SOF, 2, transd, bytes((1, c.TRANSD_SAMPLE)))))
        process.stdin.close()
        got += process.stdout.read()
    replies = replies_in(got)
    assert [one.opcode for one in replies] == [0, 0, 0]
    began_us = int.from_bytes(replies[0].payload, "little")
    safe_us = int.from_bytes(replies[2].payload[:8], "little")
    assert replies[2].payload[8:] == SAFE.to_bytes(2, "little")
    assert 0.5e6 < safe_us - began_us < 1.5e6
