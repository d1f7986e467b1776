"""The sink `ros1`: a node of ROS 1 that publishes sensors, and takes values and settings.

What flows in: samples. What flows out: messages under /NAME or /BOARD/NAME; back come messages for
actuators and requests for settings.
Rules: rospy runs in a process of its own (`ros1_node`) under the Python of the system; a roscore
that is killed and started anew is found again. With /use_sim_time stamps are in the time of ROS.
"""

import contextlib
import json
import logging
import os
import select
import struct
import subprocess
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final

import j2a
from j2a import LocalError
from j2a.types.transducers import numbers_element
from j2a_bridge.sink import Control, NotTaken, Option, Sink, SinkError, Status, Update
from j2a_bridge.sinks import ros1_node as node
from j2a_bridge.topics import Topic

try:
    from j2a_bridge.actuators import FLOATS, set_by_command, set_by_own
    from j2a_bridge.ros_messages import Message, RosMessages
except ModuleNotFoundError as error:
    raise LocalError(f'this needs {error.name}: pip install "j2a[ros]"') from None

__all__ = ["Ros1Sink"]

_READY_S: Final = 20.0
_WRITE_S: Final = 5.0
_TOGETHER: Final = 1 << 15
"""Where samples come without end, so many bytes go to the node at once."""
_END_S: Final = 3.0
_LINES: Final = 20
_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_NS_PER_US: Final = 1000
_NO_TIME: Final = "the time of ROS is simulated, and nobody has told it yet"
_logger = logging.getLogger("j2a.bridge")


class Ros1Sink(Sink):
    """Is a node of ROS 1."""

    SUMMARY = "topics and services of ROS 1 (needs a roscore and Debian's python3-rospy)"
    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "node": Option(str, "", "name of the node (j2a_bridge, with a number behind it)"),
        "python": Option(str, "/usr/bin/python3", "the Python that has rospy"),
    }

    def __init__(self, argument: str, options: Mapping[str, Any], control: Control) -> None:
        super().__init__(argument, options, control)
        self._ros = RosMessages("noetic")
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._unsent = bytearray()  # frames of samples, which only this sink's thread keeps back
        self._kept = 0  # samples in it
        self._reader: threading.Thread | None = None
        self._said: deque[str] = deque(maxlen=_LINES)
        self._ready = threading.Event()
        self._shift_ns: int | None = 0  # None before the simulated time of ROS is known
        self._next = 1
        self._messages: dict[str, list[tuple[int, Message]]] = {}
        self._numbers: dict[str, list[int]] = {}
        self._takers: dict[int, Callable[[bytes], None]] = {}
        self._name = ""

    # ------------------------------------------------------------------ life

    def open(self) -> None:
        """Start the node."""
        name = self.options["node"]
        command = [self.options["python"], node.__file__, name or "j2a_bridge"]
        command += [] if name else ["anonymous"]
        self._ready.clear()
        self._said.clear()
        self._messages.clear()
        self._numbers.clear()
        self._takers.clear()
        self._next, self._shift_ns = 1, 0
        # genpy makes modules in it, which it would leave behind when the node is killed.
        self._scratch = tempfile.TemporaryDirectory(prefix="j2a-ros1-", ignore_cleanup_errors=True)
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                process_group=0,  # Ctrl-C is for the bridge, which then ends it
                cwd=Path("/"),  # where no module stands in the way of those of ROS
                env={key: one for key, one in os.environ.items() if key != "PYTHONPATH"}
                | _ros_path()
                | {"TMPDIR": self._scratch.name},
            )
        except OSError as error:
            self._scratch.cleanup()
            raise SinkError(f"{command[0]} does not start: {error.strerror}") from None
        self._process = process
        self._answers = ThreadPoolExecutor(1, thread_name_prefix="j2a ros1 answers")
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)
        errors = threading.Thread(target=self._read_errors, args=(process,), daemon=True)
        errors.start()
        self._reader = threading.Thread(target=self._read, args=(process,), daemon=True)
        self._reader.start()
        if not self._ready.wait(_READY_S) or process.poll() is not None or not self._name:
            errors.join(_END_S)
            self.close()
            why = self._said[-1] if self._said else "it says nothing"
            raise SinkError(f"the node of ROS 1 does not start: {why}")
        definition = self._ros.store.generate_msgdef(_DIAGNOSTICS, ros_version=1)
        self._send_about(node.ADVERTISE, 0, "/diagnostics", _DIAGNOSTICS, definition)

    def told(self) -> str:
        """Return what the node is called."""
        return f"node {self._name} of ROS 1 at {os.environ.get('ROS_MASTER_URI', 'localhost')}"

    def close(self) -> None:
        """End the node."""
        with self._lock:
            process, self._process = self._process, None
            self._unsent.clear()
            self.lost, self._kept = self.lost + self._kept, 0
        if process is None:
            return
        assert process.stdin is not None
        self._answers.shutdown(cancel_futures=True)
        process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if self._reader is not None:
            self._reader.join(_END_S)
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
        self._scratch.cleanup()

    # ------------------------------------------------------------------ topics

    def announce(self, topic: Topic) -> None:
        """Advertise a sensor, or subscribe for an actuator, and serve its settings."""
        numbers = self._numbers.setdefault(topic.name, [])
        messages = self._messages.setdefault(topic.name, [])
        for message in self._ros.messages(topic):
            number = self._number(numbers)
            messages.append((number, message))
            definition = self._ros.definition(topic, message.type)
            name = f"/{message.topic}"
            self._send_about(node.ADVERTISE, number, name, message.type, definition)
        if not topic.transducer.is_sensor:
            own = self._ros.type_of(topic)
            self._subscribe(numbers, topic, topic.name, own, lambda data: self._set(topic, data))
            if numbers_element(topic.transducer.type) is not None:
                name = f"{topic.name}/cmd"
                self._subscribe(numbers, topic, name, FLOATS, lambda data: self._cmd(topic, data))
        number = self._number(numbers)
        self._takers[number] = lambda data: self._configure(topic, data)
        self._send_json(node.SERVE, number, {"topic": f"/{topic.name}/configure"})

    def retract(self, topic: Topic) -> None:
        """Take all of that back."""
        self._messages.pop(topic.name, None)
        for number in self._numbers.pop(topic.name, ()):
            self._takers.pop(number, None)
            self._send(node.FORGET, number)

    def publish(self, update: Update) -> None:
        """Publish a sample."""
        shift_ns = self._shift_ns
        if shift_ns is None:
            raise NotTaken(_NO_TIME)
        if shift_ns:
            update = replace(
                update,
                shift_us=update.shift_us + shift_ns // _NS_PER_US,
                arrived_ns=update.arrived_ns + shift_ns,
            )
        packed = [
            (number, message.pack(update))
            for number, message in self._messages.get(update.topic.name, ())
        ]
        with self._lock:
            self._kept += 1
            for number, data in packed:
                if data is not None:
                    self._keep(node.PUBLISH, number, data)
            if len(self._unsent) >= _TOGETHER:
                try:
                    self._write()
                except SinkError:
                    self.lost -= 1  # who calls counts this one
                    raise

    def flush(self) -> None:
        """Send the samples that came together by one write: each costs the node as much."""
        with self._lock:
            self._write()

    def status(self, status: Status) -> None:
        """Publish diagnostics."""
        shift_ns = self._shift_ns
        if shift_ns is not None:
            data = self._ros.diagnostics(status, time.time_ns() + shift_ns)
            self._send(node.PUBLISH, 0, data)

    def _number(self, numbers: list[int]) -> int:
        number, self._next = self._next, self._next + 1
        if number >= 1 << 16:
            raise SinkError("there are too many topics; a new node is started")
        numbers.append(number)
        return number

    def _subscribe(
        self,
        numbers: list[int],
        topic: Topic,
        name: str,
        kind: str,
        take: Callable[[bytes], None],
    ) -> None:
        number = self._number(numbers)
        self._takers[number] = take
        definition = self._ros.definition(topic, kind)
        self._send_about(node.SUBSCRIBE, number, f"/{name}", kind, definition)

    # ------------------------------------------------------------------ from ROS

    def _set(self, topic: Topic, data: bytes) -> None:
        shift_ns = self._shift_ns
        if shift_ns is None:
            raise LocalError(f"{topic.name} was not set: {_NO_TIME}")
        set_by_own(self.control, self._ros, topic, data, shift_ns)

    def _cmd(self, topic: Topic, data: bytes) -> None:
        set_by_command(self.control, self._ros, topic, data)

    def _configure(self, topic: Topic, data: bytes) -> None:
        about = json.loads(data)
        answers = self._answers

        def answer(is_done: bool, text: str) -> None:
            told = {"id": about["id"], "success": is_done, "message": text}
            # The loop of the bridge must not wait for the node, nor may the reader. Each client
            # waits for its answer, so there are no more of them than clients.
            with contextlib.suppress(RuntimeError):  # it has ended meanwhile
                answers.submit(self._send_json, node.ANSWER, 0, told)

        try:
            names, values = about["names"], about["values"]
            if len(names) != len(values):
                raise LocalError("names and values are not equally many")
            settings = {name: _value(value) for name, value in zip(names, values, strict=True)}
            if settings:
                future = self.control.configure(topic.name, settings)
            else:
                future = self.control.settings(topic.name)
        except j2a.J2AError as error:
            answer(False, str(error))
            return

        def told(done: "Future[Any]") -> None:
            error = LocalError("the bridge ends") if done.cancelled() else done.exception()
            if error is None:
                answer(True, json.dumps(done.result()))
            else:
                answer(False, str(error) or type(error).__name__)

        future.add_done_callback(told)

    def _read(self, process: "subprocess.Popen[bytes]") -> None:
        """Take what the node says, in a thread of its own."""
        assert process.stdout is not None
        fd = process.stdout.fileno()
        data = bytearray()
        try:
            while chunk := os.read(fd, 1 << 16):
                data += chunk
                while len(data) >= node.HEADER.size:
                    what, number, size = node.HEADER.unpack_from(data)
                    if len(data) < node.HEADER.size + size:
                        break
                    body = bytes(data[node.HEADER.size : node.HEADER.size + size])
                    del data[: node.HEADER.size + size]
                    self._take(what, number, body)
        except OSError:
            pass  # closed
        finally:
            self._ready.set()

    def _take(self, what: int, number: int, body: bytes) -> None:
        if what == node.READY:
            self._name = body.decode()
            self._ready.set()
        elif what == node.TIME:
            shift_ns, now_ns = struct.unpack("<qq", body)
            self._shift_ns = shift_ns if now_ns else None
        elif what == node.TOLD:
            _logger.warning("ROS 1: %s", body.decode(errors="replace"))
        else:
            take = self._takers.get(number)
            try:
                if take is not None:
                    take(body)
            except j2a.J2AError as error:
                _logger.warning("a message of ROS 1 was refused: %s", error)
            except Exception:  # those behind it are to be read all the same
                _logger.exception("a message of ROS 1 was not taken")

    def _read_errors(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                text = line.decode(errors="replace").strip()
                if text:
                    self._said.append(text)
        except (OSError, ValueError):
            pass  # closed

    # ------------------------------------------------------------------ to the node

    def _send_about(
        self, what: int, number: int, topic: str, kind: str, definition: tuple[str, str]
    ) -> None:
        text, md5 = definition
        about = {"topic": topic, "type": kind.replace("/msg/", "/"), "text": text, "md5": md5}
        self._send_json(what, number, about)

    def _send_json(self, what: int, number: int, about: Mapping[str, Any]) -> None:
        self._send(what, number, json.dumps(about).encode())

    def _send(self, what: int, number: int, data: bytes = b"") -> None:
        """Send a frame to the node.

        Raises:
            SinkError: it has ended, or takes nothing.
        """
        with self._lock:
            self._keep(what, number, data)
            self._write()

    def _keep(self, what: int, number: int, data: bytes) -> None:
        self._unsent += node.HEADER.pack(what, number, len(data)) + data

    def _write(self) -> None:
        """Write what is unsent; raises as `_send`, and then the samples in it are lost."""
        unsent, kept = bytes(self._unsent), self._kept
        self._unsent.clear()
        self._kept = 0
        try:
            self._write_frames(memoryview(unsent))
        except SinkError:
            self.lost += kept
            raise

    def _write_frames(self, unsent: memoryview) -> None:
        process = self._process
        if process is None or process.stdin is None:
            raise SinkError("the node of ROS 1 has ended")
        fd = process.stdin.fileno()
        end = 0.0
        while unsent:
            try:
                unsent = unsent[os.write(fd, unsent) :]
                continue
            except BlockingIOError:
                pass
            except OSError:
                why = self._said[-1] if self._said else f"code {process.poll()}"
                raise SinkError(f"the node of ROS 1 has ended: {why}") from None
            end = end or time.monotonic() + _WRITE_S
            left = end - time.monotonic()
            if left <= 0:
                # Frames behind a part of one would be none, whoever sends them.
                process.kill()
                self._said.append(f"it took nothing for {_WRITE_S:g} s")
                raise SinkError(f"the node of ROS 1 takes nothing for {_WRITE_S:g} s")
            select.select([], [fd], [], left)


def _value(text: str) -> Any:
    """Return the value of a setting: a number or true or false in JSON, else the text."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return text if isinstance(value, str | list | dict) or value is None else value


def _ros_path() -> dict[str, str]:
    """Return what of PYTHONPATH belongs to ROS."""
    parts = [
        one for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if "ros" in one.lower()
    ]
    return {"PYTHONPATH": os.pathsep.join(parts)} if parts else {}
