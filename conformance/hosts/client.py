"""A host program for `j2a-conform host`, with the blocking client.

What flows in: the URL of the suite as the last argument, then jobs, one as the reply to each call
of the opcode 0xE0. What flows out: the outcome of each job, as the payload of the next such call.
"""

import json
import sys
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import zip_longest
from typing import Any

import j2a

CONDUCTOR = 0xE0
FOR_A_AND_B = 0x2A


def main(url: str) -> None:
    """Do jobs until the suite says `bye` or is gone."""
    outcome = "ready j2a.Client"
    while outcome:
        host = Host(url)
        try:
            while outcome:
                outcome = host.do(host.next_job(outcome))
        except j2a.LinkError:
            pass  # the same outcome is reported again over a new link
        finally:
            host.board.close()


def connect(url: str, report: Callable[[BaseException, Any], None]) -> j2a.Client:
    """Connect with a window, and without one where the properties cannot be read now.

    A client without a window asks for them with the first call that needs them.
    """
    board = j2a.connect(url, window=8, on_handler_error=report)
    try:
        dict(board.properties)
    except (j2a.RemoteError, j2a.ProtocolError):
        board.close()
        return j2a.connect(url, on_handler_error=report)
    return board


class Host:
    """A link to the suite, and the SIFs that came over it."""

    def __init__(self, url: str) -> None:
        self.wrong = 0
        self.board = connect(url, self.report)
        self.samples: dict[str, list[j2a.Sample]] = {}
        self.held: j2a.Function | None = None
        self.sifs: dict[str, list[j2a.Sif]] = {"all": [], "a": [], "b": []}
        self.board.on_sif(FOR_A_AND_B, fail)
        self.board.on_sif(None, self.sifs["all"].append)
        self.board.on_sif(FOR_A_AND_B, self.sifs["a"].append)
        self.board.on_sif(FOR_A_AND_B, self.sifs["b"].append)

    def next_job(self, outcome: str) -> str:
        """Report an outcome and return the next job; while the link is stalled, try again."""
        while True:
            try:
                return self.board.call(CONDUCTOR, outcome.encode(), 60).payload.decode()
            except j2a.DeviceRestarted:
                pass  # it was not sent: nothing restarts while the suite waits
            except j2a.LinkStalled:
                time.sleep(0.005)

    def do(self, job: str) -> str:
        """Do a job and return its outcome; "" ends the program."""
        try:
            match job.split(" "):
                case ["together", *_]:
                    calls = job.removeprefix("together ").split(" ; ")
                    with ThreadPoolExecutor(len(calls)) as pool:
                        return " ; ".join(pool.map(self.do, calls))
                case ["repeat", count, *call]:
                    outcomes = [self.do(" ".join(call)) for _ in range(int(count))]
                    return outcomes[-1]
                case ["call", function, data, ms]:
                    reply = self.board.call(name(function), take(data), int(ms) / 1000)
                    return f"reply {reply.code} {spell(reply.payload)}"
                case ["typed", function, arguments, ms]:
                    typed = self.board.functions[function].with_timeout(int(ms) / 1000)
                    return f"values {spell_values(typed(*take_values(typed, arguments)))}"
                case ["restarts"]:
                    return f"restarts {self.board.counters.restarts}"
                case ["hold", function]:
                    self.held = self.board.functions[function]
                    return "held"
                case ["held", arguments, ms] if self.held is not None:
                    typed = self.held.with_timeout(int(ms) / 1000)
                    return f"values {spell_values(typed(*take_values(typed, arguments)))}"
                case ["read", function, ms]:
                    limit_s = int(ms) / 1000
                    content = self.board.read_many(
                        name(function), timeout=limit_s, total_timeout=limit_s
                    )
                    return f"data {spell(content)}"
                case ["write", function, data, ms]:
                    limit_s = int(ms) / 1000
                    self.board.write_many(
                        name(function), take(data), timeout=limit_s, total_timeout=limit_s
                    )
                    return "written"
                case ["transducers"]:
                    return f"transducers {','.join(self.board.transducers) or '-'}"
                case ["watch", name_of]:
                    self.samples[name_of] = []
                    self.board.transducers[name_of].on_sample(self.samples[name_of].append)
                    return "watching"
                case ["samples", name_of, count, ms]:
                    return self.report_samples(name_of, int(count), int(ms) / 1000)
                case ["wrong-samples"]:
                    return f"wrong-samples {self.wrong}"
                case ["configure", name_of, setting, value]:
                    one = self.board.transducers[name_of]
                    one.configure(**{setting: json.loads(value)})
                    return "done"
                case ["actuate", name_of, channel, time_us, values]:
                    one = self.board.transducers[name_of]
                    at = {"channel": int(channel), "at_us": int(time_us)}
                    one.set(*json.loads(values), **at)
                    return "done"
                case [("clock-exchange" | "clock-measure" | "clock-sync") as verb, rounds, ms]:
                    return self.ask_clock(verb, int(rounds), int(ms) / 1000)
                case ["sifs", handler, count, ms]:
                    return self.report_sifs(self.sifs[handler], int(count), int(ms) / 1000)
                case ["bye"]:
                    return ""
                case _:
                    return "unsupported"
        except j2a.FunctionFailed as error:
            return f"failed {error}"[:32]
        except j2a.RemoteError as error:
            return f"error {error.code} {fate(error)}"
        except j2a.CallTimeout as error:
            return f"timeout {fate(error)}"
        except j2a.DeviceRestarted as error:
            return f"restarted {fate(error)}"
        except j2a.InterfaceChanged as error:
            return f"changed {error}"[:32]
        except j2a.LinkStalled:
            return "stalled"
        except j2a.LinkError:
            return "lost"
        except (j2a.LocalError, j2a.LegacyLimit, j2a.UnsupportedVersion) as error:
            return f"refused {error}"[:32]
        except j2a.ProtocolError as error:
            return f"failed {error}"[:32]

    def report(self, error: BaseException, _event: object) -> None:
        """Count what was no sample."""
        self.wrong += isinstance(error, j2a.ProtocolError)

    def ask_clock(self, verb: str, rounds: int, limit_s: float) -> str:
        """Make exchanges with the clock of the board; report the last one, or what is known."""
        clock = self.board.clock
        if verb == "clock-exchange":
            done = clock.exchange(limit_s)
            return f"exchanged {done.received_us}"
        ask = clock.sync if verb == "clock-sync" else clock.measure
        reading = ask(rounds, limit_s)
        return f"clock {reading.state} {reading.uncertainty_us:.0f}"

    def report_samples(self, name_of: str, count: int, wait_s: float) -> str:
        """Wait for so many samples, report their readings, and forget them."""
        samples = self.samples[name_of]
        deadline_s = time.monotonic() + wait_s
        while len(samples) < count and time.monotonic() < deadline_s:
            time.sleep(0.001)
        taken, samples[:] = samples[:], []
        return spell_samples(taken)

    def report_sifs(self, sifs: list[j2a.Sif], count: int, wait_s: float) -> str:
        """Wait for so many SIFs, report those that came, and forget them."""
        deadline_s = time.monotonic() + wait_s
        while len(sifs) < count and time.monotonic() < deadline_s:
            time.sleep(0.001)
        taken, sifs[:] = sifs[:], []
        data = b"".join(bytes((sif.opcode, len(sif.payload))) + sif.payload for sif in taken)
        return f"sifs {sum(sif.missed for sif in taken)} {spell(data)}"


def fail(_sif: j2a.Sif) -> None:
    """Raise, as a handler may; those that were registered behind this one get the SIF, too."""
    raise RuntimeError


def spell_samples(samples: list[j2a.Sample]) -> str:
    """Spell samples for an outcome: values lost, resets of the clock, and the readings."""
    readings = [[r.channel, r.time_us, r.value] for sample in samples for r in sample.readings]
    lost = sum(sample.lost for sample in samples)
    resets = sum(sample.is_reset for sample in samples)
    text = spell_values(readings)
    if len(text) > 200:
        text = f"{len(text)}#{zlib.crc32(text.encode()):08x}"
    return f"samples {lost} {resets} {text}"


def fate(error: j2a.J2AError) -> str:
    """Say what became of the request: `not-sent`, `maybe-executed` or `answered`."""
    return error.outcome.value.replace(" ", "-")


def name(word: str) -> str | int:
    """Take `@48` for an opcode, anything else for a name."""
    return int(word[1:]) if word.startswith("@") else word


def take(word: str) -> bytes:
    """Take data from a job: `-`, hex digits, or `COUNT*HEX`."""
    count, star, unit = word.rpartition("*")
    return b"" if word == "-" else bytes.fromhex(unit) * int(count if star else 1)


def take_values(function: j2a.Function, word: str) -> list[Any]:
    """Take the arguments of a typed call: JSON, bytes as a list of numbers."""
    values: list[Any] = json.loads(word)
    if function.signature is None:
        return values
    fields = zip_longest(values, function.signature.parameters)
    return [
        bytes(value) if field and field.type.element == "bytes" else value
        for value, field in fields
    ][: len(values)]


def spell_values(values: object) -> str:
    """Spell the result of a typed call: JSON without spaces."""
    text = json.dumps(values, separators=(",", ":"), default=list)
    return text.replace(" ", r"\u0020")


def spell(data: bytes) -> str:
    """Spell data for an outcome: `-`, hex digits, or `LENGTH#CRC32` above 100 bytes."""
    return f"{len(data)}#{zlib.crc32(data):08x}" if len(data) > 100 else data.hex() or "-"


if __name__ == "__main__":
    main(sys.argv[-1])
