"""A signal handler that raises amid the work of a recorder, at whatever line that is."""

import contextlib
import sys
from itertools import count

import pytest
from mcap.reader import make_reader

import j2a
from j2a.recording import Recorder, Recording
from j2a.types.transds_file import read_transds

KNOWN = read_transds("SENSOR(quad, 0, quad, X, 1, i16, none)\n")
FILES = ("recording.py", "whole_file.py", "_chunk_builder.py", "data_stream.py", "writer.py")


class StopError(Exception):
    pass


@contextlib.contextmanager
def raising_at(line, handler):
    """Have a handler called at a line of the recorder, counted from 1, and raise StopError.

    Lines of others do not count: they may be those of an object that is just collected.
    """
    lines = count(1)
    done = []

    def trace(frame, event, _argument):
        if not frame.f_code.co_filename.endswith(FILES):
            return None
        # A line of "with" is seen again on its way out, where no signal handler is called.
        if event == "line" and frame.f_code.co_name != "_do" and next(lines) >= line and not done:
            done.append(frame)
            sys.settrace(None)
            handler()
            raise StopError
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield done
    finally:
        sys.settrace(before)


def write(recorder, number):
    sample = j2a.Sample("x:", "quad", number, (), 0.0, payload=bytes(10))
    recorder.write("cart", sample, number)


def sequences(path):
    """What this library reads; another reader, which has no index to go by, finds the same."""
    recording = Recording(path)
    found = [one.sequence for one in recording]
    assert recording.is_whole
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages()
        assert [message.sequence for _, _, message in messages] == found
    return found


@pytest.mark.parametrize("asked", ["close", "flush", "nothing"])
@pytest.mark.parametrize("first", range(3))
def test_amid_a_write_no_half_record_stays(tmp_path, asked, first):
    for line in count(1 + first, 3):
        path = tmp_path / f"{line}.mcap"
        recorder = Recorder(path)
        recorder.add_board("cart", KNOWN)
        write(recorder, 1)
        ask = getattr(recorder, asked, lambda: None)
        with contextlib.suppress(StopError, j2a.LocalError), raising_at(line, ask) as done:
            write(recorder, 2)
        if not done:
            assert line > 60
            break
        if asked != "close":
            write(recorder, 3)
        recorder.close()
        found = sequences(path)
        assert found in ([1, 2, 3][: len(found)], [1, 3])
        assert len(found) == recorder.samples
        with pytest.raises(j2a.LocalError, match="is closed"):
            write(recorder, 4)
    recorder.close()


@pytest.mark.parametrize("first", range(6))
def test_amid_the_end_of_a_chunk_nothing_is_lost(tmp_path, first, monkeypatch):
    monkeypatch.setattr("j2a.recording._CHUNK_BYTES", 90)
    for line in count(1 + first, 6):
        path = tmp_path / f"{line}.mcap"
        with Recorder(path) as recorder:
            recorder.add_board("cart", KNOWN)
            for number in range(2):
                write(recorder, number)
            with contextlib.suppress(StopError), raising_at(line, recorder.flush) as done:
                write(recorder, 2)
            for number in range(3, 6):
                write(recorder, number)
        found = sequences(path)
        assert [number for number in found if number != 2] == [0, 1, 3, 4, 5]
        assert len(found) == recorder.samples
        if not done:
            assert line > 150
            break


@pytest.mark.parametrize("what", ["close", "flush", "add_board"])
@pytest.mark.parametrize("first", range(5))
def test_amid_anything_else_nothing_is_lost(tmp_path, what, first):
    for line in count(1 + first, 5):
        path = tmp_path / f"{line}.mcap"
        with Recorder(path) as recorder:
            recorder.add_board("cart", KNOWN)
            write(recorder, 1)
            arguments = ("other", KNOWN) if what == "add_board" else ()
            with contextlib.suppress(StopError), raising_at(line, lambda: None) as done:
                getattr(recorder, what)(*arguments)
            with contextlib.suppress(j2a.LocalError):
                write(recorder, 2)
        assert sequences(path) == [1, 2][: recorder.samples]
        if not done:
            break


def test_a_board_is_refused_when_the_recorder_is_closed(tmp_path):
    with Recorder(tmp_path / "x.mcap") as recorder:
        recorder.add_board("cart", KNOWN)
        write(recorder, 1)
    with pytest.raises(j2a.LocalError, match="is closed"):
        recorder.add_board("other", KNOWN)
    assert sequences(tmp_path / "x.mcap") == [1]
