"""The contenders in pytest-benchmark: figures, no gate; and proof that they do the same work."""

import time

import pytest
from hypothesis import given, settings
from j2a_spec import oracle

from j2a.protocol.deframer import Deframer

from ..library.support import frames, streams  # noqa: TID252 - tests are no package
from .contenders import FRAMES, SIZES, contenders
from .naive import NaiveDeframer, naive_encode

CONTENDERS = [contender for size in SIZES for contender in contenders(size)]


@pytest.mark.parametrize("way", ["encode", "decode"])
@pytest.mark.parametrize("contender", CONTENDERS, ids=lambda c: f"{c.name}-{c.size}")
def test_speed(benchmark, contender, way):
    benchmark.group = f"{way} {contender.size} B"
    benchmark._timer = time.process_time
    run = getattr(contender, way)
    assert benchmark.pedantic(run, rounds=7, warmup_rounds=1) == FRAMES


@settings(max_examples=200)
@given(streams)
def test_the_naive_decoder_makes_the_same_of_a_stream(stream):
    naive, ours = NaiveDeframer(), Deframer()
    assert naive.feed(stream) == ours.feed(stream)
    assert naive.skipped == ours.skipped


@settings(max_examples=100)
@given(frames)
def test_the_naive_encoder_makes_the_same_of_a_frame(frame):
    wire = naive_encode(frame.start, frame.seq, frame.opcode, frame.payload)
    assert wire == oracle.encode(frame)
