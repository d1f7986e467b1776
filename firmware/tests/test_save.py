"""Settings that stay without power: over resets, other firmware, damage, a reset at any byte."""

import itertools
import resource
import shlex
from functools import cache
from pathlib import Path

import j2a_transports
import pytest
from j2a_sim import AvrSim
from j2a_spec import constants as c
from j2a_spec.oracle import Frame, decode, encode

import j2a
from firmware.tests.transds_app import app_task
from j2a.errors import FunctionFailed

pytestmark = pytest.mark.requirement("J2A-TRANS-019")

SAVE = "-DJ2A_WITH_SAVE=1"
TRANSDS = """\
SENSOR(plain, 0, plain, X, 2, i16, none)
SENSOR_EX(tuned, 1, plain, X, 2, i16, none, (decimation, 1), (threshold, 3), (topic, first),
          (period, 5000), (enabled, 0))
ACTUATOR(motor, 2, motor, X, 1, u8, 0, (watchdog, 100), (topic, motor))
"""
CODE = """\
#include "transds.h"
void plain_set_cb(void (*callback)(uint8_t channel, int16_t value)) { (void)callback; }
void motor_set(uint8_t channel, uint8_t value) { (void)channel; (void)value; }
""" + app_task()
# Of the transducer 1: what the descriptors say, and two sets of others.
ITEMS = (c.TRANSD_ENABLED, c.TRANSD_PERIOD, c.TRANSD_DECIMATION, c.TRANSD_THRESHOLD, c.TRANSD_TOPIC)
FIRST = (b"\0", (5000).to_bytes(4, "little"), b"\1", b"\3\0", b"first")
SECOND = (b"\1", (70_000).to_bytes(4, "little"), b"\7", b"\x2c\1", b"second name")
THIRD = (b"\0", (1).to_bytes(4, "little"), b"\xff", b"\0\0", b"3")


@pytest.fixture(scope="module")
def image(build_firmware, tmp_path_factory):
    """Build the app above, each once; the text replaces part of its transds.def."""

    @cache
    def build(port="avr-serial", find="", replace="", options=SAVE, **variables):
        folder = tmp_path_factory.mktemp("app")
        (folder / "transds.def").write_text(TRANSDS.replace(find, replace))
        (folder / "functions.def").write_text("")
        (folder / "properties.def").write_text('J2A_PROPERTY("name", "save")\n')
        (folder / "app.c").write_text(CODE)
        return build_firmware("app", port, APP_DIR=folder, OPTIONS=options, **variables)

    return build


class Chip:
    """The app in the simulator; a reset is one of the whole chip but its EEPROM."""

    def __init__(self, elf: Path, mcu: str = "atmega328p", eeprom: bytes = b"") -> None:
        self.sim = AvrSim(elf, mcu)
        self.sim.write_eeprom(0, eeprom or b"\xff" * self.size)
        self.start()

    @property
    def size(self) -> int:
        return 1024

    def start(self) -> None:
        self.sim.uart_read()
        self.sim.boot()
        self.sim.run(self.sim.cycles(0.02))
        self.seq = 0

    def reset(self) -> None:
        self.sim.reset()
        self.start()

    def ask(self, item: int, value: bytes = b"", one: int = 1, opcode: int = 7) -> Frame:
        self.seq = (self.seq + 1) % 256
        self.sim.uart_write(encode(Frame(c.SOF, self.seq, opcode, bytes((one, item)) + value)))
        got = b""
        for _ in range(200):
            self.sim.run(self.sim.cycles(0.0005))
            got += self.sim.uart_read()
            frames = [event for event in decode(got) if isinstance(event, Frame)]
            if frames and frames[-1].seq == self.seq:
                return frames[-1]
        raise AssertionError(f"no reply to item {item}: {got!r}")

    def settings(self, one: int = 1) -> tuple[bytes, ...]:
        replies = [self.ask(item, one=one) for item in ITEMS]
        assert {reply.opcode for reply in replies} == {c.RET_OK}
        return tuple(reply.payload for reply in replies)

    def write(self, values: tuple[bytes, ...]) -> None:
        for item, value in zip(ITEMS, values, strict=True):
            assert self.ask(item, value) == Frame(c.SOF, self.seq, c.RET_OK, value)

    def save(self, one: int = 1) -> None:
        assert self.ask(c.TRANSD_SAVE, b"\1", one).opcode == c.RET_OK
        for _ in range(200):
            state = self.ask(c.TRANSD_SAVE, one=one).payload
            if state == bytes((c.TRANSD_SAVED,)):
                return
            assert state == bytes((c.TRANSD_SAVING,))
            self.sim.run(self.sim.cycles(0.01))
        raise AssertionError("it never got SAVED")

    @property
    def eeprom(self) -> bytes:
        return self.sim.read_eeprom(0, self.size)


@pytest.fixture
def chip(image):
    made = Chip(image())
    yield made
    assert made.sim.log == ""
    made.sim.close()


@pytest.mark.avr
def test_settings_stay_over_a_reset(chip):
    assert chip.ask(c.TRANSD_SAVE).payload == bytes((c.TRANSD_NOT_SAVED,))
    chip.write(SECOND)
    chip.reset()
    assert chip.settings() == FIRST
    chip.write(SECOND)
    chip.save()
    chip.write(THIRD)  # after it: not saved
    chip.ask(c.TRANSD_WATCHDOG, b"\x2c\1", one=2)
    chip.save(one=2)
    chip.reset()
    assert chip.settings() == SECOND
    assert chip.ask(c.TRANSD_WATCHDOG, one=2).payload == b"\x2c\1"
    assert chip.ask(c.TRANSD_PERIOD, one=0).payload == bytes(4)
    states = [chip.ask(c.TRANSD_SAVE, one=one).payload[0] for one in range(3)]
    assert states == [c.TRANSD_NOT_SAVED, c.TRANSD_SAVED, c.TRANSD_SAVED]
    for values in (THIRD, SECOND, FIRST, THIRD):  # the records take turns
        chip.write(values)
        chip.save()
        chip.reset()
        assert chip.settings() == values


@pytest.mark.avr
@pytest.mark.requirement("J2A-TRANS-028")
def test_the_reply_comes_before_the_settings_are_kept(chip):
    """What is kept is what the settings were at the write, whatever the host does meanwhile."""
    chip.write(SECOND)
    before = chip.sim.time_s
    assert chip.ask(c.TRANSD_SAVE, b"\1").payload == bytes((c.TRANSD_SAVING,))
    assert chip.sim.time_s - before < 0.02
    chip.write(THIRD)
    for one in (0, 1, 2):
        reply = chip.ask(c.TRANSD_SAVE, b"\1", one)
        assert (reply.opcode, reply.payload) == (c.TRANSD_BUSY, b"")
    assert chip.ask(c.TRANSD_SAVE, b"\2").opcode == c.TRANSD_BAD_VALUE
    assert chip.ask(c.TRANSD_SAVE, b"\1\1").opcode == c.TRANSD_BAD_LENGTH
    assert chip.ask(c.TRANSD_SAVE).payload == bytes((c.TRANSD_SAVING,))
    chip.sim.run(chip.sim.cycles(0.5))
    assert chip.ask(c.TRANSD_SAVE).payload == bytes((c.TRANSD_SAVED,))
    chip.reset()
    assert chip.settings() == SECOND


@pytest.mark.avr
def test_a_reset_at_each_byte_leaves_the_old_settings_or_the_new_ones(chip):
    """The chip is reset after each byte of a save; and once more, with that byte half written."""
    chip.write(SECOND)
    chip.save()
    old = chip.eeprom
    chip.write(THIRD)
    chip.ask(c.TRANSD_SAVE, b"\1")
    steps = [old]  # the EEPROM after each byte that is written
    idle = 0
    while idle < 12:
        chip.sim.run(chip.sim.cycles(0.001))
        idle += 1
        if chip.eeprom != steps[-1]:
            steps.append(chip.eeprom)
            idle = 0
    assert chip.ask(c.TRANSD_SAVE).payload == bytes((c.TRANSD_SAVED,))
    assert len(steps) > 20
    found = []
    for before, after in itertools.pairwise(steps):
        [place] = [at for at in range(chip.size) if before[at] != after[at]]
        halves = {after[place], 0xFF, before[place] & after[place], before[place] | after[place]}
        for half in halves:
            chip.sim.write_eeprom(0, after)
            chip.sim.write_eeprom(place, bytes((half,)))
            chip.reset()
            found.append(chip.settings())
            assert found[-1] in (SECOND, THIRD)
        # Whatever stands there now, the next save works; it takes as long as all of the above.
        if len(found) % 3 == 0:
            chip.write(FIRST)
            chip.save()
            chip.reset()
            assert chip.settings() == FIRST
    assert found[-len(halves) - 1] == SECOND  # up to the last byte
    assert THIRD in found[-len(halves) :]


@pytest.mark.avr
def test_only_bytes_that_differ_are_written(chip):
    chip.write(SECOND)
    chip.save()
    chip.write(THIRD)
    chip.save()  # now both records are there
    before = chip.eeprom
    chip.save()
    assert chip.eeprom == before  # the settings are the same, so nothing is written
    chip.ask(c.TRANSD_DECIMATION, b"\7")
    chip.ask(c.TRANSD_SAVE, b"\1")
    writes = 0
    for _ in range(400):
        seen = chip.eeprom
        chip.sim.run(chip.sim.cycles(0.001))
        writes += chip.eeprom != seen
    # The other record has those of SECOND: settings but decimation, the CRC, and the mark twice.
    differ = sum(
        a != b
        for one, two in zip(SECOND, THIRD, strict=True)
        for a, b in zip(one.ljust(32, b"\0"), two.ljust(32, b"\0"), strict=True)
    )
    assert writes <= differ + 1 + 4 + 2


@pytest.mark.avr
def test_other_firmware_and_damage_are_not_used(image, chip):
    chip.write(SECOND)
    chip.save()
    kept = chip.eeprom
    other = Chip(image(find="first", replace="fIrst"), eeprom=kept)
    assert other.settings() == (*FIRST[:-1], b"fIrst")
    other.sim.close()
    same = Chip(image(), eeprom=kept)
    assert same.settings() == SECOND
    same.sim.close()
    used = [at for at in range(chip.size) if kept[at] != 0xFF]
    for at in used:
        chip.sim.write_eeprom(0, kept)
        chip.sim.write_eeprom(at, bytes((kept[at] ^ 1 << at % 8,)))
        chip.reset()
        assert chip.settings() == FIRST
    for fill in (0, 1, 2, 3, 0x55):
        chip.sim.write_eeprom(0, bytes((fill,)) * chip.size)
        chip.reset()
        assert chip.settings() == FIRST


@pytest.mark.avr
def test_samples_and_calls_go_on_while_it_saves(chip):
    """No byte of the host is lost: each request is answered while the EEPROM is written."""
    chip.write(SECOND)
    chip.ask(c.TRANSD_SAVE, b"\1")
    count = 0
    while chip.ask(c.TRANSD_SAVE, one=1).payload == bytes((c.TRANSD_SAVING,)):
        before = chip.sim.time_s
        chip.ask(c.TRANSD_TIME)
        assert chip.sim.time_s - before < 0.01
        count += 1
    assert count > 10
    assert chip.sim.counters.overruns == 0


class TestPosix:
    def test_settings_stay_in_the_file(self, image, tmp_path, monkeypatch):
        program = image("posix")
        monkeypatch.setenv("J2A_KEPT", str(tmp_path / "kept"))
        with j2a.connect(f"exec:{program}") as board:
            tuned = board.transducers["tuned"]
            assert not tuned.is_saved()
            tuned.configure(period=0.5, topic="other", threshold=9, enabled=True)
            tuned.save()
            assert tuned.is_saved()
            tuned.configure(period=0.25)
            board.transducers["motor"].watchdog = 1.5
            board.transducers["motor"].save()
        with j2a.connect(f"exec:{program}") as board:
            tuned = board.transducers["tuned"]
            assert (tuned.period, tuned.topic, tuned.threshold) == (0.5, "other", 9)
            assert tuned.enabled
            assert board.transducers["motor"].watchdog == 1.5
            assert not board.transducers["plain"].is_saved()
        monkeypatch.delenv("J2A_KEPT")
        with j2a.connect(f"exec:{program}") as board:
            assert board.transducers["tuned"].topic == "first"

    def test_a_file_that_takes_no_more_is_as_a_worn_memory(self, image, tmp_path, monkeypatch):
        monkeypatch.setenv("J2A_KEPT", str(tmp_path / "kept"))
        program = image("posix")
        script = f"trap '' XFSZ; exec {shlex.quote(str(program))}"
        transport = j2a_transports.open(f"exec:sh -c {shlex.quote(script)}")
        with j2a.Client(transport) as board:
            tuned = board.transducers["tuned"]
            tuned.configure(period=0.5)
            tuned.save()
            pid = transport.child.process.pid
            no_byte, no_limit = (2, resource.RLIM_INFINITY), (resource.RLIM_INFINITY,) * 2
            resource.prlimit(pid, resource.RLIMIT_FSIZE, no_byte)
            tuned.configure(period=0.25)
            with pytest.raises(FunctionFailed):
                tuned.save()
            resource.prlimit(pid, resource.RLIMIT_FSIZE, no_limit)
            tuned.configure(period=0.125)
            tuned.save()
        with j2a.connect(f"exec:{program}") as board:
            assert board.transducers["tuned"].period == 0.125

    def test_a_device_without_it_refuses(self, image):
        with (
            j2a.connect(f"exec:{image('posix', options='')}") as board,
            pytest.raises(FunctionFailed, match="keeps no settings without power"),
        ):
            board.transducers["tuned"].save()


def test_a_port_without_memory_says_so(image, make, need, tmp_path):
    need("riscv64-unknown-elf-gcc")
    goal = tmp_path / "transducers.obj/j2a_save.o"  # no more of it is compiled than shows the error
    done = make(goal, PORT="riscv", APP="transducers", OUT=tmp_path, OPTIONS=SAVE)
    assert done.returncode != 0
    assert "needs a port that keeps bytes without power" in done.stderr


def test_settings_that_do_not_fit_do_not_compile(make, need, tmp_path):
    need("avr-gcc")
    options = f"{SAVE} -DJ2A_EEPROM_AT=800"
    goal = tmp_path / "transducers.obj/j2a_transds_table.o"  # which shows it
    result = make(goal, PORT="avr-serial", APP="transducers", OUT=tmp_path, OPTIONS=options)
    assert result.returncode != 0
    assert "the_settings_fit_into_what_the_port_keeps" in result.stderr
