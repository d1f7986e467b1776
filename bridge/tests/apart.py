"""A sink for tests that runs in a process of its own, and tells by a file what happens there."""

import logging
import os
import pickle
import time
from dataclasses import fields
from pathlib import Path
from typing import Any

from j2a_bridge import NotTaken, Sink, SinkError

from j2a import J2AError

NOT_TAKEN, FAILS, UNEXPECTED, ENDS, HANGS, SETS, LOSES = range(200, 207)


class FullError(SinkError):
    """An error that cannot be pickled."""

    def __init__(self, _code: int, why: str) -> None:
        super().__init__(why)


class NotThis(NotTaken):
    """Another."""

    def __init__(self, _code: int, why: str) -> None:
        super().__init__(why)


class Apart(Sink):
    """Notes what it gets in a file; some values have it do something else."""

    SUMMARY = "for tests"
    ARGUMENT = "FILE"
    RETRY_S = 0.05
    WAITING = 20_000

    def __init__(self, argument: str, options: Any, control: Any) -> None:
        super().__init__(argument, options, control)
        self._path = Path(argument)

    def _note(self, *event: Any) -> None:
        with self._path.open("ab") as file:
            pickle.dump(event, file)

    def open(self) -> None:
        if self._path.with_suffix(".closed").exists():
            raise SinkError("it may not")
        self._note("open", os.getpid())
        print("a sink prints what it likes")
        logging.getLogger("j2a.bridge").warning("a sink logs %d", "what it likes")

    def told(self) -> str:
        return f"writes {self._path.name}"

    def announce(self, topic: Any) -> None:
        if topic.name == "refused":
            raise TypeError("a name that is reserved")
        if topic.name == "not_taken":
            raise NotThis(29, "not this one")
        if topic.name == "forks" and not os.fork():
            time.sleep(6)
            os._exit(0)
        if topic.name == "hangs":
            time.sleep(1000)
        self._note("announce", topic)

    def retract(self, topic: Any) -> None:
        if topic.name == "refused":
            raise KeyError(topic.name)
        self._note("retract", topic)

    def publish(self, update: Any) -> None:
        what = update.sample.payload[-1] if update.topic.name.startswith("orders") else 0
        if what == NOT_TAKEN:
            raise NotTaken("it is too great")
        if what == FAILS:
            raise FullError(28, "the disk is full")
        if what == UNEXPECTED:
            raise ZeroDivisionError("nobody thought of it")
        if what == ENDS:
            os._exit(7)
        if what == HANGS:
            time.sleep(1000)
        if what == LOSES:
            self.lost += 2
        if what == SETS:
            self._ask()
        self._note("publish", update.topic, told_of(update))

    def flush(self) -> None:
        self._note("flush")

    def status(self, status: Any) -> None:
        self._note("status", status)

    def close(self) -> None:
        self._note("close")
        if self._path.with_suffix(".full").exists():
            raise SinkError("the disk is full")

    def _ask(self) -> None:
        def told(name: str, future: Any) -> None:
            future.add_done_callback(
                lambda done: self._note("result", name, done.exception() or done.result())
            )

        told("set", self.control.set("servo", [5], channel=1))
        told("bad", self.control.set("servo", [500]))
        told("raw", self.control.set("servo", [-7], raw=True))
        told("settings", self.control.settings("servo"))
        told("configure", self.control.configure("quad", {"period": 0.25}))
        self.control.set("servo", [6]).cancel()
        told("option", self.control.set("servo", [5], speed=1))
        told("structure", self.control.call("robot", "pair", []))
        told("unknown", self.control.call("robot", "nothing", [1]))
        for refused in (lambda: self.control.client("robot"), lambda: self.control.submit(_none())):
            try:
                refused()
            except J2AError as error:
                self._note("result", "refused", error)


async def _none() -> None:
    """Nothing."""


def told_of(update: Any) -> dict[str, Any]:
    """Return the fields of a sample, readings as text: NaN equals no NaN."""
    sample = {one.name: getattr(update.sample, one.name) for one in fields(update.sample)}
    found = {one.name: getattr(update, one.name) for one in fields(update) if one.name != "topic"}
    return {**found, "sample": {**sample, "readings": repr(tuple(update.sample.readings))}}


def events(path: Path) -> list[Any]:
    """Return what was noted so far."""
    found: list[Any] = []
    with path.open("rb") as file:
        while True:
            try:
                found.append(pickle.load(file))
            except EOFError:
                return found
            except pickle.UnpicklingError:  # it is being written
                return found


def state_of(pid: int) -> str:
    """Return the state of a process, "" where it is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return ""
