"""The C core under sanitizers: golden vectors, noise, cut and damaged frames."""

import random
import shutil
import subprocess
from pathlib import Path

import pytest
from j2a_spec import constants as c
from j2a_spec import selftest
from j2a_spec.oracle import Frame, encode

from firmware.verify.one_file import write_one_file

FIRMWARE = Path(__file__).parents[1]
SANITIZE = "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"
STRICT = "-std=c99 -Wall -Wextra -Wpedantic -Werror -Wmissing-prototypes -Wno-overlength-strings"
ECHO = 4
NASTY = bytes((c.SOF, c.SOS, c.ESC, c.SOF - 1, c.SOS - 1, c.ESC - 1, 0xFF, 0, ECHO))


@pytest.mark.sampled(3)  # the first and the last: each compiler, and each sign
@pytest.mark.parametrize("cc", ["gcc", "clang"])
@pytest.mark.parametrize("sign", ["-fsigned-char", "-funsigned-char"])
def test_golden_vectors_in_c(tmp_path, cc, sign):
    if shutil.which(cc) is None:
        pytest.skip(f"{cc} is not installed")
    program = tmp_path / "vectors"
    core = write_one_file(tmp_path / "core.c", (FIRMWARE / "core").rglob("*.c"))
    command = [cc, sign, *STRICT.split(), *SANITIZE.split(), "-DJ2A_WITH_SELFTEST=1", "-Icore"]
    command += ["-Iports/posix", "-Iapps/builtins"]
    result = subprocess.run(
        [*command, "tests/vectors/vectors.c", core, "-o", program],
        cwd=FIRMWARE,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    result = subprocess.run([program], capture_output=True, text=True, check=False)
    known = selftest.load()
    assert result.stdout == f"{c.PROP_SELFTEST}={selftest.value(known, known)}\n", result.stderr


def noise(rng):
    """A few hundred bytes that a link may well bring: random, or nasty, or broken frames."""
    kind = rng.randrange(5)
    payload = bytes(rng.choices(NASTY, k=rng.randrange(256)))
    frame = bytearray(encode(Frame(c.SOF, rng.randrange(256), ECHO, payload)))
    if kind == 0:
        return rng.randbytes(rng.randrange(600))
    if kind == 1:
        return bytes(rng.choices(NASTY, k=rng.randrange(600)))
    if kind == 2:
        return bytes(frame[: rng.randrange(len(frame))])
    if kind == 3:
        frame[rng.randrange(len(frame))] = rng.choice(NASTY)
        return bytes(frame)
    return b"\x12" * rng.randrange(20) + bytes(frame) + b"\xed" * rng.randrange(20)


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_good_frames(build, ask, replies, seed):
    """Each good frame after noise is answered, and all answers are what the oracle expects.

    The app without functions of its own is used: what noise calls by chance is known.
    """
    program = build("builtins", CFLAGS=SANITIZE, OPTIONS="-DJ2A_WITH_MAPPING=0")
    rng = random.Random(seed)
    parts = []
    for number in range(500):
        good = Frame(c.SOF, number % 256, 3, b"good" + number.to_bytes(2, "little"))
        parts += [noise(rng), encode(good)]
    stream = b"".join(parts)
    answers = ask(program, stream)
    by_chance = {0, 1, 2, 4}  # other built-ins: only that they answer is compared
    expected = replies(
        stream,
        {3: lambda payload: (c.ECHO, payload), **dict.fromkeys(by_chance, lambda _: (0, b""))},
    )
    assert len(answers) == len(expected)
    called = [frame for frame in expected if (frame.opcode, frame.payload) == (0, b"")]
    assert len(called) < len(expected) / 4
    for answer, due in zip(answers, expected, strict=True):
        assert answer == due or (due in called and answer.seq == due.seq)
    echoed = [frame for frame in answers if frame.opcode == c.ECHO and frame.payload[:4] == b"good"]
    assert len(echoed) == 500


def test_every_cut_of_a_frame(build, ask):
    program = build("demo", CFLAGS=SANITIZE)
    whole = encode(Frame(c.SOF, 0x11, ECHO, bytes(NASTY) * 28))
    good = encode(Frame(c.SOF, 0x77, ECHO, b"good"))
    answers = ask(program, b"".join(whole[:cut] + good for cut in range(len(whole))))
    assert answers.count(Frame(c.SOF, 0x77, c.ECHO, b"good")) == len(whole)
