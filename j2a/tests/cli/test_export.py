"""`j2a export`, as a user runs it."""

import json
import struct

import pytest

import j2a
from j2a.cli import _export
from j2a.recording import Recorder
from j2a.types.transds_file import read_transds

from .conftest import files_of

# Fixtures, because every worker imports this module and one of them runs its tests.
pytestmark = pytest.mark.usefixtures("pandas", "parquet")

FILE = """
J2A_STRUCT(motion, (array(i16, 2), rate), (bool, up))
SENSOR(quad, 0, quad, X, 2, i16, -1, (scale, 0.5))
SENSOR(log, 1, log, X, 2, u8, none, (queue, 4))
SENSOR(imu, 2, imu, X, 1, motion, none)
SENSOR(rows, 3, rows, X, 1, array(u8, 2), none)
SENSOR(bump, 4, bump, X, 2, bool, none)
"""


NOW_NS = 1_700_000_000_000_000_000
SAMPLES = {
    "quad": [
        struct.pack("<QhQh", 0, 0, 5, 4),
        struct.pack("<QhQh", 9, -1, 5, 4),
    ],
    "log": [struct.pack("<HBQBBQB", 0, 1, 11, 7, 0, 12, 8), struct.pack("<HBQB", 0, 1, 13, 9)],
    "imu": [struct.pack("<Qhh?", 20, 1, -2, True)],
    "bump": [struct.pack("<Q?Q?", 22, True, 0, False)],
    "rows": [struct.pack("<QBB", 21, 3, 4)],
}


@pytest.fixture
def pandas():
    return pytest.importorskip("pandas")


@pytest.fixture
def parquet():
    return pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def path(tmp_path):
    made = tmp_path / "drive.mcap"
    with Recorder(made) as recorder:
        recorder.add_board("left/cart", read_transds(FILE), url="sim:x", properties={})
        for name, payloads in SAMPLES.items():
            for number, payload in enumerate(payloads):
                sample = j2a.Sample("b", name, number, (), 0.0, payload=payload)
                recorder.write("left/cart", sample, NOW_NS + number)
    return made


def test_csv(run, path, tmp_path):
    out = tmp_path / "out"
    result = run("export", path, out)
    assert (result.code, result.err) == (0, "")
    assert (out / "left_cart_quad.csv").read_text() == (
        "host_time_ns,time_us,channel,value\n"
        f"{NOW_NS},5,1,2.0\n"
        f"{NOW_NS + 1},9,0,\n"
        f"{NOW_NS + 1},5,1,2.0\n"
    )
    assert (out / "left_cart_log.csv").read_text() == (
        "host_time_ns,time_us,channel,value\n"
        f"{NOW_NS},11,1,7.0\n{NOW_NS},12,0,8.0\n{NOW_NS + 1},13,1,9.0\n"
    )
    assert (out / "left_cart_imu.csv").read_text() == (
        f"host_time_ns,time_us,channel,rate_0,rate_1,up\n{NOW_NS},20,0,1,-2,True\n"
    )
    assert (out / "left_cart_rows.csv").read_text() == (
        f"host_time_ns,time_us,channel,value_0,value_1\n{NOW_NS},21,0,3,4\n"
    )
    assert (out / "left_cart_bump.csv").read_text() == (
        f"host_time_ns,time_us,channel,value\n{NOW_NS},22,0,True\n"
    )
    assert f"wrote {out / 'left_cart_quad.csv'}: 3 rows\n" in result.out
    assert f"wrote {out / 'left_cart_bump.csv'}: 1 row\n" in result.out
    again = run("export", path, out)
    assert again.code == 2
    assert "is there already" in again.err
    assert list(out.glob("*.part")) == []


def test_a_link_to_nothing_is_not_overwritten(run, path, tmp_path):
    link = tmp_path / "left_cart_log.csv"
    link.symlink_to("none")
    result = run("export", path, tmp_path)
    assert (result.code, result.out) == (2, "")
    assert f"{link} is there already" in result.err
    assert link.is_symlink()
    assert {one.name for one in tmp_path.iterdir()} == {"drive.mcap", link.name}


def test_a_file_in_place_of_the_folder(run, path, tmp_path):
    result = run("export", path, path)
    assert result.code == 2
    assert f"{path} is a file: give a folder" in result.err


def test_parquet(run, path, tmp_path, pandas, parquet):
    out = tmp_path / "out"
    result = run("export", path, out, "--format", "parquet")
    assert (result.code, result.err) == (0, "")
    quad = pandas.read_parquet(out / "left_cart_quad.parquet")
    assert quad["channel"].tolist() == [1, 0, 1]
    assert quad["time_us"].tolist() == [5, 9, 5]
    assert quad["value"].isna().tolist() == [False, True, False]
    bump = parquet.read_table(out / "left_cart_bump.parquet")
    assert bump.to_pylist()[0]["value"] is True
    assert parquet.read_table(out / "left_cart_imu.parquet").to_pylist() == [
        {"host_time_ns": NOW_NS, "time_us": 20, "channel": 0, "rate_0": 1, "rate_1": -2, "up": True}
    ]


def test_units_of_columns(run, tmp_path, monkeypatch, pandas, parquet):
    monkeypatch.setattr(_export, "_PIECE", 1)
    path = tmp_path / "drive.mcap"
    sensors = read_transds(
        "J2A_STRUCT(motion, (array(i16, 2), rate, mdeg/s), (bool, up))\n"
        "SENSOR(imu, 0, imu, X, 1, motion, none)\nSENSOR(log, 1, log, X, 1, u8, none)"
    )
    with Recorder(path) as recorder:
        recorder.add_board("b", sensors)
        for name, payload in (
            ("imu", SAMPLES["imu"][0]), ("imu", SAMPLES["imu"][0]), ("log", bytes(9)),
        ):  # fmt: skip
            recorder.write("b", j2a.Sample("b", name, 0, (), 0.0, payload=payload), NOW_NS)
    out = tmp_path / "out"
    assert run("export", path, out).code == 0
    assert {one.name for one in out.iterdir()} == {"b_imu.csv", "b_imu.units.json", "b_log.csv"}
    units = {"rate_0": "mdeg/s", "rate_1": "mdeg/s"}
    assert json.loads((out / "b_imu.units.json").read_text()) == units
    assert run("export", path, out, "--format", "parquet").code == 0
    table = out / "b_imu.parquet"
    assert pandas.read_parquet(table).attrs["units"] == units
    fields = {field.name: field.metadata for field in parquet.read_schema(table)}
    assert fields["rate_1"] == {b"unit": b"mdeg/s"}
    assert fields["up"] is None


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_long_recording_is_written_piece_by_piece(run, path, tmp_path, monkeypatch, form, pandas):
    monkeypatch.setattr(_export, "_PIECE", 1)
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    run("export", path, pieces, "--format", form)
    monkeypatch.setattr(_export, "_PIECE", 1000)
    run("export", path, whole, "--format", form)
    read = {"csv": pandas.read_csv, "parquet": pandas.read_parquet}[form]
    for table in sorted(whole.iterdir()):
        assert read(table).equals(read(pieces / table.name))
    assert len(list(pieces.iterdir())) == len(SAMPLES)


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("first_us", [1, 0])
def test_pieces_with_and_without_gaps_make_one_table(run, tmp_path, monkeypatch, form, first_us):
    monkeypatch.setattr(_export, "_PIECE", 2)
    path, out = tmp_path / "drive.mcap", tmp_path / "out"
    sensors = read_transds(
        "J2A_STRUCT(s, (f32, x), (u8, n), (bool, up))\nSENSOR(t, 0, t, X, 2, s, none)"
    )
    with Recorder(path) as recorder:
        recorder.add_board("b", sensors)
        for time_us in (first_us, 2, 3, 4, 1 - first_us, 6):  # at 0 a channel has no value
            payload = struct.pack("<Qf2BQf2B", time_us, 0.1, 1, 1, 7, 0.1, 2, 0)
            recorder.write("b", j2a.Sample("b", "t", 0, (), 0.0, payload=payload), NOW_NS)
    assert run("export", path, out, "--format", form).code == 0
    if form == "csv":
        rows = [line.split(",", 3)[3] for line in (out / "b_t.csv").read_text().splitlines()]
        assert sorted(set(rows)) == ["0.1,1,True", "0.1,2,False", "x,n,up"]
        assert len(rows) == 1 + 11
    else:
        table = pytest.importorskip("pyarrow.parquet").read_table(out / "b_t.parquet")
        assert [str(one) for one in table.schema.types[3:]] == ["float", "uint8", "bool"]
        assert table.num_rows == 11


def test_what_boards_are_called_stays_in_the_folder(run, tmp_path):
    path, out = tmp_path / "odd.mcap", tmp_path / "out"
    sensors = read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)")
    with Recorder(path) as recorder:
        for name in ("../a b", ".._a_b", "=1+1", "x" * 300):
            recorder.add_board(name, sensors)
            sample = j2a.Sample("b", "quad", 0, (), 0.0, payload=struct.pack("<QB", 1, 2))
            recorder.write(name, sample, NOW_NS)
    assert run("export", path, out).code == 0
    names = {one.name for one in out.iterdir()}
    assert names == {
        ".._a_b_quad.csv", ".._a_b_quad2.csv", "_1_1_quad.csv", f"{'x' * 50}_quad.csv",
    }  # fmt: skip
    assert {one.name for one in tmp_path.iterdir()} == {"odd.mcap", "out"}


def test_integers_of_64_bits_stay_exact(run, tmp_path, parquet):
    path = tmp_path / "wide.mcap"
    sensors = read_transds("SENSOR(big, 0, big, X, 2, u64, 0xFFFFFFFFFFFFFFFF)")
    with Recorder(path) as recorder:
        recorder.add_board("b", sensors)
        payload = struct.pack("<QQQQ", 1, (1 << 64) - 2, 2, (1 << 64) - 1)
        recorder.write("b", j2a.Sample("b", "big", 0, (), 0.0, payload=payload), NOW_NS)
    for form in ("csv", "parquet"):
        assert run("export", path, tmp_path / form, "--format", form).code == 0
    assert (tmp_path / "csv" / "b_big.csv").read_text() == (
        f"host_time_ns,time_us,channel,value\n{NOW_NS},1,0,{(1 << 64) - 2}\n{NOW_NS},2,1,\n"
    )
    table = parquet.read_table(tmp_path / "parquet" / "b_big.parquet")
    assert table["value"].to_pylist() == [(1 << 64) - 2, None]


def test_it_shows_how_far_it_is_up_to_the_end(run, tmp_path, monkeypatch):
    drawn = []

    class Drawn(_export.Progress):
        def __call__(self, done, total=None, more=""):
            drawn.append((done, total))

    monkeypatch.setattr(_export, "Progress", Drawn)
    path = tmp_path / "drive.mcap"
    with Recorder(path) as recorder:
        recorder.add_board("b", read_transds("SENSOR(quad, 0, quad, X, 1, u8, none)"))
        for number, seconds in enumerate((0, 3, 2, 5)):  # the clock was set back once
            sample = j2a.Sample("b", "quad", number, (), 0.0, payload=struct.pack("<QB", 1, 2))
            recorder.write("b", sample, NOW_NS + seconds * 1_000_000_000)
    assert run("export", path, tmp_path / "out").code == 0
    assert drawn == [(0, 5), (3, 5), (2, 5), (5, 5)]


def test_what_cannot_be_exported(run, path, tmp_path):
    result = run("export", tmp_path / "none.mcap", tmp_path / "out")
    assert (result.code, result.out) == (2, "")
    assert "none.mcap: No such file" in result.err
    other = tmp_path / "other.mcap"
    other.write_bytes(b"nothing of the sort")
    result = run("export", other, tmp_path / "out")
    assert result.code == 2
    assert "is no MCAP file" in result.err
    result = run("export", path, path)
    assert result.code == 2
    assert "drive.mcap is a file: give a folder" in result.err
    cut = tmp_path / "cut.mcap"
    with Recorder(cut) as recorder:
        recorder.add_board("cart", read_transds(FILE), url="sim:x", properties={})
    result = run("export", cut, tmp_path / "empty")
    assert result.code == 0
    assert result.err == f"j2a: {cut} has no samples\n"
    cut.write_bytes(b"")
    result = run("export", cut, tmp_path / "empty")
    assert (result.code, result.err) == (0, f"j2a: {cut} has no samples; it is incomplete\n")


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("ending", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_tables_that_are_not_whole_are_not_left(run, path, tmp_path, monkeypatch, form, ending):
    write = _export._Table.add
    monkeypatch.setattr(_export, "_PIECE", 1)

    def add(table, one):
        write(table, one)
        if one.sensor.name == "rows":
            raise ending

    monkeypatch.setattr(_export._Table, "add", add)
    result = run("export", path, tmp_path / "out", "--format", form)
    assert (result.code, result.out) == (130 if isinstance(ending, KeyboardInterrupt) else 1, "")
    assert list((tmp_path / "out").iterdir()) == []
    monkeypatch.undo()
    assert run("export", path, tmp_path / "out", "--format", form).code == 0


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_disk_that_is_full_is_told(run, path, tmp_path, form):
    """The last bytes are written when the files are closed, which is refused again."""
    out = tmp_path / "out"
    with files_of(50):
        result = run("export", path, out, "--format", form)
    assert (result.code, result.out) == (1, "")
    assert "j2a: cannot write the tables: " in result.err
    assert list(out.iterdir()) == []


def test_a_recording_that_ends_early(run, path, tmp_path):
    path.write_bytes(path.read_bytes()[:-40])
    result = run("export", path, tmp_path / "out")
    assert result.code == 0
    assert "is incomplete; the samples in it were exported" in result.err
    assert len(list((tmp_path / "out").iterdir())) == len(SAMPLES)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_all_that_can_be_read_of_a_damaged_recording_is_written(run, path, tmp_path, form, pandas):
    data = bytearray(path.read_bytes())
    at = data.index(b"zstd") + 60
    data[at] ^= 0xFF
    path.write_bytes(data)
    with Recorder(tmp_path / "more.mcap") as recorder:
        recorder.add_board("left/cart", read_transds(FILE))
        sample = j2a.Sample("b", "quad", 0, (), 0.0, payload=SAMPLES["quad"][0])
        recorder.write("left/cart", sample, NOW_NS)
    more = (tmp_path / "more.mcap").read_bytes()
    footer = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")  # where the data end
    end = more.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    path.write_bytes(data[:footer] + more[8:end] + data[footer:])
    out = tmp_path / "out"
    result = run("export", path, out, "--format", form)
    assert result.code == 1
    assert "is damaged: " in result.err
    assert "Traceback" not in result.err
    read = {"csv": pandas.read_csv, "parquet": pandas.read_parquet}[form]
    assert read(out / f"left_cart_quad.{form}")["value"].tolist() == [2.0]


def test_a_file_that_cannot_be_read_leaves_no_folder(run, tmp_path):
    out, other = tmp_path / "out", tmp_path / "other.mcap"
    other.write_text("no recording")
    for file, told in ((tmp_path / "gone.mcap", "No such file"), (other, "is no MCAP file")):
        result = run("export", file, out)
        assert result.code == 2
        assert told in result.err
        assert not out.exists()
