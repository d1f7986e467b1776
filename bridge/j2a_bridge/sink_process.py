"""Lets a sink be a process of its own, so that a bridge uses more than one core.

What flows in: what the runner of a sink asks it for. What flows out: the same calls of that sink in
another process, many samples in one message; back come its orders for boards, and what it logs.
Rules: a process that ends or takes nothing is a sink that has failed, and is started anew unless
the sink has no `RETRY_S`; samples that it was given and did not publish count as lost. It ends when
the bridge does, however that ends.
"""

import contextlib
import gc
import itertools
import logging
import marshal
import os
import pickle
import queue
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from operator import attrgetter
from typing import Any, Final, NoReturn

from j2a import LocalError
from j2a.events import Sample, quick_maker
from j2a.types.coding import PythonTypes
from j2a.types.model import Structure
from j2a.types.samples import SampleCodec
from j2a_bridge.sink import NotTaken, Sink, SinkError, Status, Update
from j2a_bridge.topics import Topic

__all__ = ["SinkProcess", "serve"]

_ANSWER_S: Final = 30.0
_WRITE_S: Final = 5
_END_S: Final = 3
_TOGETHER: Final = 64
"""So many samples go in one message where they come without end."""
_START: Final = "from j2a_bridge.sink_process import serve; serve()"
_SAMPLES, _CALL, _TELL, _RESULT = range(4)  # to the process
_ANSWER, _ORDER, _LOG, _DONE, _FAILED = range(5)  # and back
_logger = logging.getLogger("j2a.bridge")
# What else there is follows from the topic.
_sample_of = attrgetter(
    *("board", "sequence", "host_time", "lost", "missed", "is_reset", "payload", "host_us", "gone")
)
_times_of = attrgetter("times_us", "shift_us", "arrived_ns", "uncertainty_us")
_new_sample = quick_maker(Sample)
_new_update = quick_maker(Update)


class SinkProcess(Sink):
    """Stands for a sink that is a process.

    Args:
        made: a sink like it, which has found its argument and options right, and is never opened.

    Raises:
        LocalError: this system or this sink cannot do that.
    """

    SUMMARY = "another sink, in a process of its own"

    def __init__(self, made: Sink) -> None:
        super().__init__(made.argument, made.options, made.control)
        if os.name != "posix":
            raise LocalError("a sink can be a process of its own on Linux and macOS only")
        try:
            pickle.dumps((type(made), dict(made.options)))
        except Exception as error:  # of a class or an option of anybody
            raise LocalError(f"this sink cannot be a process of its own: {error}") from None
        self.RETRY_S = made.RETRY_S
        self.WAITING = made.WAITING
        self._kind = type(made)
        self._process: subprocess.Popen[bytes] | None = None
        self._sending = threading.Lock()
        self._told = ""
        self._next = itertools.count()
        self._numbers: dict[str, int] = {}  # of topics
        self._batch: list[tuple[Any, ...]] = []
        self._given = self._done = 0
        self._failure: Exception | None = None

    # ------------------------------------------------------------------ life

    def open(self) -> None:
        """Start the process, and have it open the sink."""
        self.close()
        self._failure = None
        ours, theirs = socket.socketpair()
        # Seconds and microseconds, as the system has them.
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", _WRITE_S, 0))
        self._socket, self._link = ours, Connection(ours.fileno())
        self._answers: queue.SimpleQueue[tuple[bool, Any]] = queue.SimpleQueue()
        try:
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", _START, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    env={**os.environ, "PYTHONSAFEPATH": "1"},  # no module of the folder it is in
                    process_group=0,  # Ctrl-C is for the bridge, which then ends it
                )
        except OSError:
            self._link.close()
            ours.detach()
            raise
        self._results = ThreadPoolExecutor(1, thread_name_prefix="j2a sink results")
        self._reader = threading.Thread(
            target=self._read, args=(self._link, self._process), daemon=True
        )
        self._reader.start()
        level = _logger.getEffectiveLevel()
        self._told = self._ask("open", self._kind, self.argument, dict(self.options), level)

    def told(self) -> str:
        """Return what the sink tells."""
        return self._told

    def close(self) -> None:
        """End the process, behind what it was given.

        Raises:
            SinkError: it has not done all of that.
            Exception: that with which the sink has failed.
        """
        process = self._process
        if process is None:
            return
        with contextlib.suppress(Exception):  # it may have failed with any
            self._send_batch()
        self._process = None
        with contextlib.suppress(OSError), self._sending:
            self._socket.shutdown(socket.SHUT_WR)  # what it still says is read
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._reader.join(_END_S)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # a process that the sink forked may have it
        self._reader.join(_END_S)
        self._results.shutdown(cancel_futures=True)
        self._link.close()
        self._socket.detach()
        lost = self._given - self._done
        self.lost += lost
        self._given = self._done = 0
        self._numbers.clear()
        if self._failure is not None:
            raise self._failure
        if lost:
            raise SinkError(_why_ended(process))

    # ------------------------------------------------------------------ topics

    def announce(self, topic: Topic) -> None:
        """Announce a topic there."""
        number = self._numbers[topic.name] = next(self._next)
        self._ask("announce", number, topic)

    def retract(self, topic: Topic) -> None:
        """Retract it there."""
        number = self._numbers.pop(topic.name, None)
        if number is not None:
            self._ask("retract", number)

    def publish(self, update: Update) -> None:
        """Have a sample published there, together with others that come at the same time."""
        if len(self._batch) >= _TOGETHER:
            self._send_batch()  # before: where this fails, the runner counts this sample
        number = self._numbers[update.topic.name]
        self._batch.append((number, _sample_of(update.sample), _times_of(update)))

    def flush(self) -> None:
        """Send what came together."""
        if self._batch:  # one message costs less than two
            self._send_batch(is_last=True)
        else:
            self._write(_TELL, "flush")

    def status(self, status: Status) -> None:
        """Tell the state of all there."""
        self._send(_TELL, "status", status)

    # ------------------------------------------------------------------ to the process

    def _send_batch(self, *, is_last: bool = False) -> None:
        if self._batch:
            # Behind this they are the process's, whatever comes.
            batch, self._batch = self._batch, []
            self._given += len(batch)
            self._write(_SAMPLES, marshal.dumps(batch), is_last)

    def _send(self, *message: Any) -> None:
        """Send a message behind the samples that were published before; raises as `_write`."""
        self._send_batch()
        self._write(*message)

    def _write(self, *message: Any) -> None:
        """Send a message; from any thread.

        Raises:
            SinkError: the process has ended, or takes nothing.
            Exception: that with which the sink has failed.
        """
        process = self._process
        if process is None:
            raise SinkError("its process has ended")
        if self._failure is not None:
            raise self._failure
        try:
            with self._sending:
                self._link.send(message)
        except BlockingIOError:
            process.kill()  # what is behind a part of a message would be none
            raise SinkError(f"its process takes nothing for {_WRITE_S} s") from None
        except OSError:
            raise SinkError(_why_ended(process)) from None

    def _ask(self, name: str, *args: Any) -> Any:
        """Return what the sink returns.

        Raises:
            SinkError: as `_write`, or there is no answer.
            Exception: what the sink raises.
        """
        self._send(_CALL, name, *args)
        try:
            is_done, found = self._answers.get(timeout=_ANSWER_S)
        except queue.Empty:
            if self._process is not None:
                self._process.kill()
            raise SinkError(f"its process does not answer within {_ANSWER_S:g} s") from None
        if not is_done:
            raise found
        return found

    # ------------------------------------------------------------------ from the process

    def _read(self, link: Connection, process: "subprocess.Popen[bytes]") -> None:
        """Take what the process says, in a thread of its own."""
        try:
            while True:
                what, *rest = link.recv()
                if what == _ANSWER:
                    self._answers.put(tuple(rest))
                elif what == _ORDER:
                    self._order(*rest)
                elif what == _LOG:
                    level, text = rest
                    _logger.log(level, "%s", text)
                elif what == _DONE:
                    done, left_out = rest
                    self._done += done
                    self.lost += left_out
                else:
                    [self._failure] = rest
        except (EOFError, OSError):
            pass
        finally:
            self._answers.put((False, SinkError(_why_ended(process))))

    def _order(self, number: int, name: str, args: Sequence[Any], options: Any) -> None:
        """Do what the sink asks the bridge for."""
        results = self._results

        def tell(is_done: bool, found: Any) -> None:
            with contextlib.suppress(Exception):  # nobody waits for it any more
                self._write(_RESULT, number, is_done, found)

        def told(done: "Future[Any]") -> None:
            error = LocalError("the bridge ends") if done.cancelled() else done.exception()
            found = done.result() if error is None else _plain(error)
            # The loop of the bridge must not wait for the process.
            with contextlib.suppress(RuntimeError):  # it has ended meanwhile
                results.submit(tell, error is None, found)

        future: Future[Any]
        try:
            future = getattr(self.control, name)(*args, **options)
        except Exception as error:  # wrong arguments, too: the sink is told, as it is in the bridge
            future = Future()
            future.set_exception(error)
        future.add_done_callback(told)


def _why_ended(process: "subprocess.Popen[bytes]") -> str:
    code = None
    with contextlib.suppress(subprocess.TimeoutExpired):
        code = process.wait(_END_S)
    return "its process has ended" + ("" if code is None else f" with code {code}")


def _plain(error: BaseException) -> Exception:
    """Return an error that can be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # classes of anybody
        for kind in (SinkError, NotTaken, OSError):  # which mean something to the runner
            if isinstance(error, kind):
                return kind(str(error))
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error if isinstance(error, Exception) else RuntimeError(repr(error))


# ---------------------------------------------------------------------- in the process


def serve() -> None:
    """Be the process of a sink; the first argument is the descriptor of the link."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # systemd tells all processes
        signal.signal(number, signal.SIG_IGN)  # that is for the bridge, which then ends this one
    gc.set_threshold(10_000)  # as in the bridge: samples make no cycles
    link = Connection(int(sys.argv[1]))
    threading.Thread(target=_end_alone, args=(link,), daemon=True).start()
    served = _Served(link)
    try:
        served.run()
    finally:
        # A sink that does not end is ended, even if nobody is left to do it.
        signal.alarm(2 * _END_S)
        served.end()


def _end_alone(link: Connection) -> None:
    """End the process some time after the bridge, whatever the sink does."""
    bridge = select.poll()
    bridge.register(link, 0)
    bridge.poll()  # until nobody has the other end
    signal.alarm(2 * _END_S)


class _Served:
    """The sink in its process.

    Args:
        link: to the bridge.
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self._sending = threading.Lock()
        self._sink: Sink | None = None
        self._topics: dict[int, _Known] = {}
        self._orders = _Orders(self)
        self._done = self._left_out = 0  # samples, since that was told
        self._lost = 0  # of the sink, as it was told
        self._has_failed = False

    def run(self) -> None:
        """Do what the bridge asks for, until its end."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                what, *rest = self._link.recv()
                if what == _RESULT:
                    self._orders.take(*rest)
                elif what == _CALL:
                    self._answer(*rest)
                elif not self._has_failed:
                    try:
                        if what == _TELL:
                            self._tell(*rest)
                        else:
                            self._publish(*rest)
                    except Exception as error:  # of a sink of anybody
                        self._fail(error)

    def end(self) -> None:
        """End the sink."""
        if self._sink is not None:
            try:
                self._sink.close()
            except Exception as error:
                self._fail(error)
        self._tell_done()

    def send(self, *message: Any) -> None:
        """Send a message to the bridge; from any thread."""
        with contextlib.suppress(OSError), self._sending:
            self._link.send(message)

    def _answer(self, name: str, *args: Any) -> None:
        try:
            found = getattr(self, f"_{name}")(*args)
        except Exception as error:
            self.send(_ANSWER, False, _plain(error))
        else:
            self.send(_ANSWER, True, found)

    def _open(self, kind: Any, argument: str, options: Mapping[str, Any], level: int) -> str:
        logger = logging.getLogger("j2a")
        logger.setLevel(level)
        logger.addHandler(_Handler(self))
        self._sink = sink = kind(argument, options, self._orders)
        sink.open()
        return str(sink.told())

    def _announce(self, number: int, topic: Topic) -> None:
        assert self._sink is not None
        self._topics[number] = _Known(topic)
        self._sink.announce(topic)

    def _retract(self, number: int) -> None:
        assert self._sink is not None
        self._sink.retract(self._topics.pop(number).topic)

    def _tell(self, name: str, *args: Any) -> None:
        getattr(self._sink, name)(*args)
        if name == "status":  # each second
            self._tell_done()

    def _tell_done(self) -> None:
        lost = 0 if self._sink is None else self._sink.lost
        self.send(_DONE, self._done + self._left_out, self._left_out + lost - self._lost)
        self._done = self._left_out = 0
        self._lost = lost

    def _fail(self, error: Exception) -> None:
        if self._has_failed:  # and does not close, either
            return
        self._has_failed = True
        if not isinstance(error, SinkError | OSError):
            _logger.error("a sink in its process", exc_info=error)
        self.send(_FAILED, _plain(error))

    def _publish(self, batch: bytes, is_last: bool) -> None:
        assert self._sink is not None
        publish = self._sink.publish
        for number, sample, times in marshal.loads(batch):
            there = self._topics[number]
            topic = there.topic
            try:
                publish(_new_update(topic, there.sample(*sample), *times))
            except NotTaken as error:
                self._left_out += 1
                if not there.has_warned:
                    there.has_warned = True
                    _logger.warning("a sample of %s is left out: %s", topic.name, error)
            else:
                self._done += 1
        if is_last:
            self._sink.flush()


class _Known:
    """A topic in the process of the sink."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.has_warned = False
        transducer = topic.transducer
        self._unit = transducer.unit
        is_structure = isinstance(transducer.type.element, Structure)
        self._field_units = tuple(transducer.units.items()) if is_structure else ()
        codec = SampleCodec(transducer, PythonTypes())
        self._readings: Callable[[bytes], Any] = (
            (lambda payload: codec.times_queued(payload)[1])
            if transducer.queue
            else (lambda payload: codec.times(payload)[0])
        )

    def sample(  # noqa: PLR0917 - as they were sent, for each sample
        self,
        board: str,
        sequence: int,
        host_time: float,
        lost: int,
        missed: int,
        is_reset: bool,
        payload: bytes,
        host_us: int | None,
        gone: int,
    ) -> Sample:
        """Return a sample that was sent."""
        return _new_sample(
            board,
            self.topic.transducer.name,
            sequence,
            self._readings(payload),
            host_time,
            self._unit,
            lost,
            missed,
            is_reset,
            payload,
            host_us,
            self._field_units,
            gone,
        )


class _Orders:
    """What the sink may ask the bridge for; see `Control`.

    Args:
        served: sends it.
    """

    def __init__(self, served: _Served) -> None:
        self._served = served
        self._numbers = itertools.count()
        self._futures: dict[int, Future[Any]] = {}

    def take(self, number: int, is_done: bool, found: Any) -> None:
        """Take the result of an order."""
        future = self._futures.pop(number)
        if not future.set_running_or_notify_cancel():  # the sink does not wait any more
            return
        if is_done:
            future.set_result(found)
        else:
            future.set_exception(found)

    def _order(self, name: str, *args: Any, **options: Any) -> "Future[Any]":
        number = next(self._numbers)
        future = self._futures[number] = Future()
        self._served.send(_ORDER, number, name, args, options)
        return future

    def set(self, topic: str, values: Sequence[Any], **options: Any) -> "Future[None]":
        """Set channels of an actuator."""
        return self._order("set", topic, list(values), **options)

    def configure(self, topic: str, settings: Mapping[str, Any]) -> "Future[dict[str, Any]]":
        """Change settings of a transducer."""
        return self._order("configure", topic, dict(settings))

    def settings(self, topic: str) -> "Future[dict[str, Any]]":
        """Return the settings of a transducer."""
        return self._order("settings", topic)

    def call(self, board: str, function: str, values: Sequence[Any]) -> "Future[Any]":
        """Call a function of a board."""
        return self._order("call", board, function, list(values))

    def client(self, board: str) -> NoReturn:
        """Refuse: a client belongs to one process."""
        raise LocalError(f"a sink that is a process has no client of {board}")

    def submit(self, coroutine: Any) -> NoReturn:
        """Refuse, likewise."""
        coroutine.close()
        raise LocalError("a sink that is a process runs nothing in the bridge")


class _Handler(logging.Handler):
    """Has the bridge log what the sink logs."""

    def __init__(self, served: _Served) -> None:
        super().__init__()
        self._served = served

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._served.send(_LOG, record.levelno, self.format(record))
        except Exception:
            self.handleError(record)
