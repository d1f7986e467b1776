"""The Python deframer: the corpus, a few seconds of atheris, and proof that it finds something."""

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from j2a.tests.fuzz.target import check_deframer, chunks

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
CORPUS = HERE / "corpus"
SECONDS = 4  # make exhaustive takes half an hour
SECONDS_FOR_DEFECT = 30


HAS_WHEELS = (
    sys.platform == "linux" and platform.machine() == "x86_64" and sys.version_info < (3, 14)
)


def atheris(missing, *arguments, path=None):
    if not HAS_WHEELS:
        pytest.skip("atheris has wheels only for Linux on x86-64 and Python before 3.14")
    if importlib.util.find_spec("atheris") is None:
        missing("atheris is missing: install j2a[test]")
    env = {**os.environ, **({"PYTHONPATH": str(path)} if path else {})}
    command = [sys.executable, HERE / "fuzz.py", "-seed=1", "-max_len=1024", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env)


def test_corpus_is_small_and_there():
    sizes = [path.stat().st_size for path in CORPUS.iterdir()]
    assert len(sizes) > 50
    assert sum(sizes) < 300_000


def test_corpus():
    for path in CORPUS.iterdir():
        check_deframer(path.read_bytes())


def test_chunks_are_the_stream():
    for lengths in (b"\0\0\0\0", b"\1\2\3\0", b"\0\0\0\xff"):
        stream, pieces = chunks(lengths + bytes(range(256)))
        assert b"".join(pieces) == stream == bytes(range(256))


@pytest.mark.slow
def test_nothing_is_found(missing, tmp_path):
    result = atheris(missing, f"-max_total_time={SECONDS}", tmp_path, CORPUS)
    assert result.returncode == 0, result.stderr[-4000:]
    assert "Done " in result.stderr


def test_defect_is_found(missing, tmp_path):
    """A copy of the library that forgets, at the end of a chunk, that an escape came first."""
    copy = tmp_path / "path"
    shutil.copytree(ROOT / "j2a", copy / "j2a", ignore=shutil.ignore_patterns("__pycache__"))
    source = copy / "j2a/protocol/deframer.py"
    text = source.read_text()
    old = "self._is_escaped = plain is not None"
    assert text.count(old) == 1
    source.write_text(text.replace(old, "self._is_escaped = False"))
    result = atheris(
        missing,
        f"-max_total_time={SECONDS_FOR_DEFECT}",
        f"-artifact_prefix={tmp_path}/",
        CORPUS,
        path=copy,
    )
    assert result.returncode != 0
    assert str(source) in result.stdout  # it is the copy that was fuzzed
    assert "AssertionError" in result.stdout + result.stderr
