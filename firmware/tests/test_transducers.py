"""Transducers in firmware: the listings of the thesis, a sensor that is swapped, wrong lists."""

import struct
import subprocess
import time
from functools import cache
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec import transducers as oracle

import j2a
from firmware.tests.transds_app import app_task
from j2a.types.transds_file import read_transds, transds_text

ROOT = Path(__file__).parents[2]
APP = ROOT / "firmware/apps/transducers"
EXAMPLE = ROOT / "docs/examples/sensors"
LISTING_9_2 = """\
/* Name, ID, Prefix, Model, Number of Channels, Data Type, Value
indicating N/A */
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1) \\
SENSOR(dist_ir, 1, sharp, GP2Y0A02YK, 8, uint16_t, 0) \\
SENSOR(dist_us, 2, srf02, SRF02, 12, uint32_t, 0x00FFFFFF)
"""
# Drivers in the form of listing 9.1, a main loop with the functions of listing 9.3, and each driver
# reports once.
DRIVERS = """\
#include "transds.h"
static void (*quad_cb)(uint8_t channel, int16_t value);
static void (*sharp_cb)(uint8_t channel, uint16_t value);
static void (*srf02_cb)(uint8_t channel, uint32_t value);
void quad_set_cb(void(*new_value_func)(uint8_t channel, int16_t value)) {
    quad_cb = new_value_func;
}
void sharp_set_cb(void(*new_value_func)(uint8_t channel, uint16_t value)) {
    sharp_cb = new_value_func;
}
void srf02_set_cb(void(*new_value_func)(uint8_t channel, uint32_t value)) {
    srf02_cb = new_value_func;
}
uint8_t measure(uint8_t *const length, uint8_t **const payload);
uint8_t measure(uint8_t *const length, uint8_t **const payload) {
    (void)payload;
    *length = 0;
    quad_cb(1, -300);
    sharp_cb(7, 65535);
    srf02_cb(11, 0x00FFFFFF);
    return 0;
}
""" + app_task()
PROPERTIES = 'J2A_PROPERTY("name", "thesis")\n'


def write_app(folder, transds, code=DRIVERS, functions="J2A_CALL(measure, measure)\n"):
    folder.mkdir(exist_ok=True)
    (folder / "transds.def").write_text(transds)
    (folder / "functions.def").write_text(functions)
    (folder / "properties.def").write_text(PROPERTIES)
    (folder / "app.c").write_text(code)
    return folder


def make(folder, out, *targets, **variables):
    settings = [f"{key}={value}" for key, value in variables.items()]
    return subprocess.run(
        [
            "make",
            "-s",
            "-C",
            ROOT / "firmware",
            *targets,
            "APP=app",
            f"APP_DIR={folder}",
            f"OUT={out}",
            *settings,
        ],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def built(build_firmware, tmp_path_factory):
    @cache
    def build(transds, **more):
        folder = write_app(tmp_path_factory.mktemp("app"), transds, **more)
        return f"exec:{build_firmware('app', APP_DIR=folder)}"

    return build


class TestThesis:
    @pytest.mark.parametrize("is_macro", [False, True])
    def test_listings_9_1_to_9_3_as_printed(self, built, is_macro):
        text = LISTING_9_2
        if is_macro:
            text = "#define SENSORS \\\n" + text.partition("*/\n")[2]
        with j2a.connect(built(text)) as board:
            assert board.transducers.descriptors == read_transds(LISTING_9_2)
            streams = {name: board.transducers[name].samples() for name in board.transducers}
            board.call("measure")
            found = {name: stream.wait(10) for name, stream in streams.items()}
        assert found["quad"].values == (None, -300)
        assert found["dist_ir"].values == (None,) * 7 + (65535,)
        reading = found["dist_us"].readings[11]
        assert (reading.raw, reading.value) == (0x00FFFFFF, None)
        assert reading.time_us

    @pytest.mark.avr
    def test_listings_on_an_avr(self, need, tmp_path):
        need("avr-gcc")
        folder = write_app(tmp_path / "app", LISTING_9_2)
        done = make(folder, tmp_path / "out", PORT="avr-serial")
        assert done.returncode == 0, done.stderr
        with (
            j2a.connect(f"sim:{tmp_path}/out/app.elf") as board,
            board.transducers["quad"].samples() as samples,
        ):
            board.call("measure")
            assert samples.wait(10).values == (None, -300)


def test_the_example_of_the_docs(build_firmware):
    program = build_firmware("sensors", APP_DIR=EXAMPLE)
    with j2a.connect(f"exec:{program}") as board:
        with board.transducers["quad"].samples() as samples:
            board.transducers["servo"].set(50)
            sample = samples.wait(10)
        assert (sample.values, sample.unit) == ((90.0, None), "deg")
        assert [one.value for one in board.transducers["dist_ir"].read()] == [400]


def test_a_sensor_is_swapped_by_one_line(built):
    """The host program stays; the new sensor appears with its unit."""
    before = "SENSOR(dist, 3, dist, OLD, 1, uint16_t, 0, (unit, mm))\n"
    after = "SENSOR(dist, 3, dist, NEW, 2, float, nan, (unit, m), (scale, 2))\n"
    code = """
#include "transds.h"
static void (*cb)(uint8_t channel, TYPE value);
void dist_set_cb(void (*callback)(uint8_t channel, TYPE value)) { cb = callback; }
""" + app_task("cb(0, 400);")

    def host(url):
        with j2a.connect(url) as board:
            sample = board.transducers["dist"].wait(10)
            return sample.values, sample.unit, board.transducers["dist"].descriptor.model

    old = host(built(before, code=code.replace("TYPE", "uint16_t"), functions=""))
    assert old == ((400,), "mm", "OLD")
    new = host(built(after, code=code.replace("TYPE", "float"), functions=""))
    assert new == ((800.0, None), "m", "NEW")


def test_a_board_says_what_its_file_says(build_firmware, tmp_path):
    """The compiler and Python read the same; what Python writes of the board is such a file."""
    with j2a.connect(f"exec:{build_firmware('transducers', 'posix')}") as board:
        content = board.read_many("a2jGetTransds")
    of_file = j2a.load_transds(APP / "transds.def", {"TRANSDUCERS_NUMBERS": "1"})
    assert content.decode() == str(of_file)
    assert len(oracle.parse(content).transducers) == len(of_file.transducers) == 33
    assert read_transds(transds_text(of_file, "x")) == of_file


BOOLS = """\
J2A_STRUCT(mode, (bool, on), (u8, level), (array(bool, 2), ways))
J2A_STRUCT(pair, (u8, first), (mode, second))
ACTUATOR(gate, 0, gate, X, 2, bool, none, (range, 0, 1))
ACTUATOR(ways, 1, ways, X, 1, array(bool, 3), none)
ACTUATOR(both, 2, both, X, 1, pair, none)
SENSOR(flag, 3, flag, X, 1, bool, none, (threshold, 1))
"""
SET_BOOLS = """
#include "transds.h"
void gate_set(uint8_t channel, bool value) { (void)channel; (void)value; }
void ways_set(uint8_t channel, const bool value[3]) { (void)channel; (void)value; }
void both_set(uint8_t channel, const pair *value) { (void)channel; (void)value; }
void flag_set_cb(void (*callback)(uint8_t channel, bool value)) { (void)callback; }
""" + app_task()


@pytest.mark.requirement("J2A-TYPE-001", "J2A-TYPE-002", "J2A-TRANS-015")
@pytest.mark.parametrize("wait_us", [0, 20_000])
def test_a_bool_that_a_host_sends_as_another_number_is_kept_as_1(built, wait_us):
    """A host may send any byte for true; a device sends 1."""
    with j2a.connect(built(BOOLS, code=SET_BOOLS, functions="")) as board:

        def call(transducer, item, value=b""):
            reply = board.call(c.TRANSD, bytes((transducer, item)) + value)
            assert reply.code == 0
            return reply.payload

        def set_to(transducer, value):
            now_us = int.from_bytes(call(transducer, c.TRANSD_TIME), "little")
            due_us = now_us + wait_us if wait_us else 0
            assert call(transducer, c.TRANSD_SET, struct.pack("<BQ", 0, due_us) + value) == b""
            time.sleep(3 * wait_us / 1e6)
            return call(transducer, c.TRANSD_SAMPLE)

        gate = set_to(0, b"\2\xff")
        assert (gate[8:9], gate[17:18]) == (b"\1", b"\1")
        assert set_to(0, b"\0")[8:9] == b"\0"
        assert set_to(1, b"\0\x80\1")[8:] == b"\0\1\1"
        assert set_to(2, b"\3\2\7\0\x10")[8:] == b"\3\1\7\0\1"
        assert call(3, c.TRANSD_THRESHOLD, b"\2") == call(3, c.TRANSD_THRESHOLD) == b"\1"


ONE = "SENSOR(a, 1, a, X, 1, u8, none{more})\n"
CODE = """
#include "transds.h"
void a_set_cb(void (*callback)(uint8_t channel, uint8_t value)) { (void)callback; }
void j2a_app_task(void) { transds_process(); }
"""


REVERSED = "the_lowest_value_of_range_comes_first"
NO_RAW = "threshold_range_and_na_of_a_need_a_number_or_an_enumeration"


class TestWrongLists:
    def compiled(self, folder, out):
        """Compile what is made of the list; the rest of the core knows nothing of it."""
        objects = [out / "app.obj" / f"{name}.o" for name in ("j2a_transds_table", "app")]
        return make(folder, out, *objects, PORT="posix")

    @pytest.mark.parametrize(
        ("transds", "said"),
        [
            (ONE.replace("1, a", "255, a"), "id_of_a_is_0_to_254"),
            (ONE.replace("X, 1", "X, 0"), "channels_of_a_are_1_to_255"),
            (ONE.replace("X, 1", "X, 29"), "a_sample_of_a_is_longer_than_a_frame"),
            (ONE.replace("none{more}", "none, (queue, 256)"), "queue_of_a_is_1_to_255"),
            (ONE.replace("none{more}", "none, (queue, 0)"), "queue_of_a_is_1_to_255"),
            (
                ONE.replace("SENSOR", "ACTUATOR").replace("none{more}", "none, (queue, 1)"),
                "queue_of_a_which_is_no_sensor",
            ),
            # One byte too long is what C takes, without the NUL at its end.
            (
                ONE.replace("none{more}", f"none, (topic, {'t' * 33})"),
                "topic_of_a_is_longer_than_32_bytes",
            ),
            (ONE * 2, "j2a_index_a"),
            (ONE + ONE.replace("(a, 1, a", "(b, 1, b"), "duplicate case value"),
            (ONE.replace("u8", "u7"), "u7"),
            (ONE.replace("u8, none", "u8, none, (threshold, x)"), "'x' undeclared"),
            *(
                (ONE.replace("u8, none{more}", more), NO_RAW)
                for kind in ("array(u8, 2)", "pair")
                for more in (
                    f"{kind}, none, (threshold, 1)",
                    f"{kind}, none, (range, 0, 1)",
                    f"{kind}, 0",
                )
            ),
            *(
                (ONE.replace("none{more}", f"none, {wrong}"), said)
                for wrong, said in (
                    ("(period, -1)", "period_of_a_is_0_to_4294967295"),
                    ("(period, 4294967296)", "period_of_a_is_0_to_4294967295"),
                    ("(decimation, 0)", "decimation_of_a_is_1_to_255"),
                    ("(decimation, 256)", "decimation_of_a_is_1_to_255"),
                    ("(enabled, 2)", "enabled_of_a_is_0_or_1"),
                    ("(watchdog, 65536)", "watchdog_of_a_is_0_to_65535"),
                    ("(watchdog, -1)", "watchdog_of_a_is_0_to_65535"),
                    ("(range, 2, 1)", REVERSED),
                    ("(range, 1, 0)", REVERSED),
                    ("(period, 1), (period, 1)", "the_key_period_of_a"),
                    ("(trigger), (k, 1), (trigger)", "the_key_trigger_of_a"),
                    ("(unit, mV), (unit, V)", "the_key_unit_of_a"),
                    ("(k, 1), (other, 1), (k, f(x, y))", "the_key_k_of_a"),
                    ("(na, 1)", "the_key_na_of_a"),
                    ("(model, Y)", "the_key_model_of_a"),
                    ("(prefix, b)", "the_key_prefix_of_a"),
                )
            ),
            (ONE.replace("u8, none{more}", "i64, 0, (range, 0, -1)"), REVERSED),
            (ONE.replace("u8, none{more}", "u64, 0, (range, 0xFFFFFFFFFFFFFFFF, 0)"), REVERSED),
            (ONE.replace("u8, none{more}", "mood, 0, (range, 3, 2)"), REVERSED),
            (
                ONE.replace("SENSOR", "ACTUATOR").replace("none{more}", "0, (safe, 0)"),
                "the_key_safe_of_a",
            ),
            (ONE.replace("u8", "uint16_t"), "conflicting types for 'a_set_cb'"),
            (ONE.replace(" 1, a", " 1, c"), "a_set_cb"),  # nobody declares it, or calls it
        ],
    )
    def test_do_not_compile(self, need, tmp_path, transds, said):
        need("cc")
        transds = f"J2A_STRUCT(pair, (u8, x), (u8, y))\nJ2A_ENUM(mood, u8, (well, 1))\n{transds}"
        folder = write_app(tmp_path / "app", transds.replace("{more}", ""), CODE, "")
        done = self.compiled(folder, tmp_path / "out")
        assert done.returncode != 0
        assert said in done.stderr.replace("\u2018", "'").replace("\u2019", "'")

    @pytest.mark.parametrize(
        "more",
        [
            "u8, none",
            "u8, none, (queue, 1)",
            f"u8, none, (topic, {'t' * 32})",
            "u8, none, (period, 4294967295), (decimation, 255), (enabled, 0), (safe, 1)",
            "u8, none, (period, 0), (decimation, 1), (enabled, 1), (range, 0, 0)",
            "i64, none, (range, -9223372036854775807, 0x7FFFFFFFFFFFFFFF)",
            "i64, none, (range, -9, 0x80000000)",
            "u64, none, (range, 0, 0xFFFFFFFFFFFFFFFF)",
            "f32, none, (range, -0.5, 0.5)",
        ],
    )
    def test_the_right_one_does(self, need, tmp_path, more):
        need("cc")
        kind = more.partition(",")[0]
        c_type = {"f32": "float"}.get(kind, f"{kind.replace('i', 'int').replace('u', 'uint')}_t")
        code = CODE.replace("uint8_t value", f"{c_type} value")
        folder = write_app(tmp_path / "app", ONE.replace("u8, none{more}", more), code, "")
        done = self.compiled(folder, tmp_path / "out")
        assert done.returncode == 0, done.stderr


def test_a_build_without_clock_says_what_is_missing(need, tmp_path):
    need("cc")
    folder = write_app(tmp_path / "app", ONE.replace("{more}", ""), CODE, "")
    out = tmp_path / "out"
    engine = out / "app.obj/j2a_transducers.o"
    done = make(folder, out, engine, PORT="posix", OPTIONS="-DJ2A_WITH_CLOCK=0")
    assert done.returncode != 0
    assert "J2A_WITH_TRANSDUCERS=1 needs J2A_WITH_CLOCK=1" in done.stderr
