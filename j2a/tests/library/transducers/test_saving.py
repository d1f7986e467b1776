"""Settings that stay without power."""

import errno
import os
import tempfile
import time
from pathlib import Path

import pytest
from j2a_spec import constants as c

import j2a
from j2a.tests.library.support import linked, served
from j2a.tests.library.test_aio import in_event_loop

from .boards import FILE, ONE_SENSOR, make_device, talking


class TestSaving:
    """Settings that stay in a file (J2A-TRANS-019, J2A-TRANS-028)."""

    @pytest.fixture
    def path(self, tmp_path):
        return tmp_path / "settings.json"

    def saved(self, path, text=FILE, **options):
        with make_device(text, settings=path, **options) as made, linked(made) as client:
            quad = client.transducers["quad"]
            quad.configure(period=0.5, topic="other", threshold=7, decimation=3, enabled=False)
            quad.save()
            quad.period = 0.25  # not saved
            client.transducers["servo"].watchdog = 1.5
            assert quad.is_saved()
            assert not client.transducers["servo"].is_saved()

    def settings_of(self, path, text=FILE):
        with make_device(text, settings=path) as made, linked(made) as client:
            quad = client.transducers["quad"]
            watchdog = client.transducers["servo"].watchdog
            return quad.period, quad.topic, quad.threshold, quad.decimation, quad.enabled, watchdog

    def test_they_are_there_after_a_restart(self, path):
        assert self.settings_of(path) == (0, "wheels", 0, 1, True, 0)
        assert not path.exists()  # nothing was saved
        self.saved(path)
        assert self.settings_of(path) == (0.5, "other", 7, 3, False, 0)

    def test_those_of_one_transducer_stay_when_another_one_is_saved(self, path):
        self.saved(path)
        with make_device(settings=path) as made, linked(made) as client:
            servo, quad = client.transducers["servo"], client.transducers["quad"]
            servo.watchdog = 1.5
            servo.save()
            assert servo.is_saved()
            assert quad.is_saved()
        assert self.settings_of(path) == (0.5, "other", 7, 3, False, 1.5)

    def test_those_of_other_descriptors_are_not_used(self, path):
        self.saved(path)
        assert self.settings_of(path, FILE.replace("HEDS", "HEDX"))[:2] == (0, "wheels")

    def test_no_cut_or_damaged_file_is_an_error(self, path):
        self.saved(path)
        content = path.read_bytes()
        for end in range(0, len(content) - 1, 5):
            path.write_bytes(content[:end])
            assert self.settings_of(path)[0] in (0, 0.5)
        for text in (b"[]", b"null", b'{"descriptors": 1}', b"\xff\xfe", b"[" * 100_000):
            path.write_bytes(text)
            assert self.settings_of(path)[0] == 0

    def test_wrong_values_in_the_file_are_left_out(self, path):
        self.saved(path)
        text = path.read_text().replace('"decimation": "03"', '"decimation": "00"')
        path.write_text(text.replace('"threshold": "0700"', '"threshold": "070000"'))
        assert self.settings_of(path) == (0.5, "other", 0, 1, False, 0)

    def test_a_file_that_cannot_be_written(self, path, caplog):
        with make_device(settings=path / "no folder") as made, linked(made) as client:
            with pytest.raises(j2a.FunctionFailed, match="quad: the device could not do it"):
                client.transducers["quad"].save()
            assert not client.transducers["quad"].is_saved()
        assert "cannot be kept" in caplog.text

    @pytest.mark.parametrize("broken", ["write", "flush", "fsync", "replace"])
    def test_a_save_that_fails_leaves_nothing_behind(self, path, monkeypatch, broken):
        """Neither half a file beside it nor another one in its place, and it may be tried again."""

        def fail(*_args):
            raise OSError(errno.ENOSPC, "No space left on device")

        create = tempfile.NamedTemporaryFile

        def full(*args, **options):
            file = create(*args, **options)
            if broken in ("write", "flush"):
                setattr(file, broken, fail)
            return file

        with make_device(settings=path) as made, linked(made) as client:
            quad = client.transducers["quad"]
            quad.save()
            before = path.read_bytes()
            quad.decimation = 9
            with monkeypatch.context() as patched:
                patched.setattr(tempfile, "NamedTemporaryFile", full)
                patched.setattr(*{"replace": (Path, "replace")}.get(broken, (os, "fsync")), fail)
                with pytest.raises(j2a.FunctionFailed) as caught:
                    quad.save()
            assert caught.value.code == c.RET_FAILED
            assert (path.read_bytes(), list(path.parent.iterdir())) == (before, [path])
            quad.save()
            assert path.read_bytes() != before

    def test_without_a_file_it_is_refused(self, board):
        with pytest.raises(j2a.FunctionFailed, match="keeps no settings without power"):
            board.transducers["quad"].save()
        with pytest.raises(j2a.FunctionFailed, match="keeps no settings without power") as caught:
            board.transducers["quad"].is_saved()
        assert caught.value.code == c.TRANSD_NO_ITEM
        with pytest.raises(j2a.LocalError, match="transducers"):
            j2a.Device(settings="x")

    def test_a_board_that_is_busy_is_asked_again(self):
        left = [(c.TRANSD_BUSY, b""), (0, b"\2"), (0, b"\2"), (0, b"\1")]
        asked = []

        def answer(payload):
            asked.append(payload)
            return left.pop(0)

        with talking(ONE_SENSOR, answer) as made, linked(made) as client:
            client.transducers["a"].save()
        assert asked == [b"\1\x09\1", b"\1\x09\1", b"\1\x09", b"\1\x09"]

    @pytest.mark.parametrize("states", [[b""], [b"\0"], [b"\3"], [b"\2", b"\0"]])
    def test_a_wrong_state_is_a_failure(self, states):
        left = list(states)
        with (
            talking(ONE_SENSOR, lambda _: (0, left.pop(0))) as made,
            linked(made) as client,
            pytest.raises(j2a.FunctionFailed),
        ):
            client.transducers["a"].save()

    def test_it_waits_only_so_long(self):
        with (
            talking(ONE_SENSOR, lambda _: (0, b"\2")) as made,
            linked(made) as client,
            pytest.raises(j2a.FunctionFailed, match="not saved"),
        ):
            client.transducers["a"].save(timeout=0.1)

    def test_its_limit_holds_for_a_board_that_does_not_answer(self):
        """Also where that is shorter than the limit of a call."""

        def answer(_payload):
            time.sleep(1)
            return 0, b"\2"

        with talking(ONE_SENSOR, answer) as made, linked(made) as client:
            client._timeout = 30.0
            began = time.monotonic()
            with pytest.raises(j2a.CallTimeout, match=r"time limit of 0.1 s for the whole is over"):
                client.transducers["a"].save(timeout=0.1)
            assert time.monotonic() - began < 0.9

    @in_event_loop
    async def test_its_limit_holds_for_asyncio_too(self):
        def answer(_payload):
            time.sleep(1)
            return 0, b"\2"

        with served(talking(ONE_SENSOR, answer)) as url:
            async with await j2a.aconnect(url, timeout=30.0) as board:
                with pytest.raises(j2a.CallTimeout, match=r"limit of 0.1 s for the whole is over"):
                    await board.transducers["a"].save(timeout=0.1)

    @in_event_loop
    async def test_asyncio(self, path):
        with served(make_device(settings=path)) as url:
            async with await j2a.aconnect(url) as board:
                quad = board.transducers["quad"]
                await quad.configure(topic="x")
                await quad.save()
                assert await quad.is_saved()
        assert self.settings_of(path)[1] == "x"
