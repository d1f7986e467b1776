"""The bridge: boards in, sinks out.

What flows in: the configuration, boards that come and go, and their samples. What flows out:
topics and samples for each sink, and orders of sinks for the boards.
Rules: all of it runs in one event loop; a sample passes it in one step, and whoever is slow is
behind a queue of its own. Times are those of the source: the clock of each board is set, or known.
"""

import asyncio
import contextlib
import logging
import socket
import statistics
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from concurrent.futures import Future
from typing import Any, Final

import j2a
from j2a.events import quick_maker
from j2a.protocol.roster import BoardChange
from j2a.types.transducers import Transducer
from j2a_bridge.config import BoardConfig, Config, SensorConfig, check_url
from j2a_bridge.runner import SinkRunner
from j2a_bridge.sink import BoardStatus, Status, Times, TopicStatus, Update
from j2a_bridge.sink_request import make_sink
from j2a_bridge.topics import Names, Topic

__all__ = ["Bridge"]

_RETRY_S: Final = 0.5
"""Topics of a board that is plugged in again shall be back within 1 s, learning it included."""
_EARLY: Final = 1024
"""So many samples of a board wait until its topics are known."""
_MAX_BOARDS: Final = 1000
_MAX_ORDERS: Final = 256
"""So many orders of all sinks may wait for boards; whoever sends more is refused."""
_OPEN_S: Final = 30.0
_LOOK_S: Final = 0.01
_EACH_S: Final = 1.0
_CLOCK_S: Final = 0.1
_US: Final = 1_000_000
_YEAR_US: Final = 365 * 86_400 * _US
_LATEST_US: Final = (1 << 63) // 1000
"""Until 2262; nanoseconds of what is later do not fit into 64 bits."""
_NS_PER_US: Final = 1000
_NS_PER_MS: Final = 1e6
_SETTINGS: Final = ("enabled", "period", "decimation", "threshold", "topic", "watchdog")
_Counts = tuple[int, int, int]
_new_update = quick_maker(Update)
_logger = logging.getLogger("j2a.bridge")


class _Flow:
    """One transducer: its topic, and how its samples come."""

    def __init__(self, topic: Topic, transducer: Any, wanted: SensorConfig) -> None:
        self.topic = topic
        self.transducer = transducer
        self.times = Times(topic.transducer)
        self._least_us = 0 if wanted.rate_hz is None else _US / wanted.rate_hz
        self._next_us = 0.0
        self.samples = self.lost = self.skipped = 0
        self._before = 0
        self._times: tuple[int, ...] = ()  # of the sample before
        self._ahead: dict[int, int] = {}  # times by channel, of before the clock went back
        self.latencies_ns: list[int] = []

    def take_times(self, sample: j2a.Sample) -> tuple[tuple[int, ...], int]:
        """Return the time of each reading, 0 where there is none, and the latest in the sample.

        Where the clock has gone back, a channel that was not read since is ahead of those that
        were, which tells nothing of the present: it has none until it is read.
        """
        times, before = self.times.of(sample.payload), self._times
        latest = max(times)
        self._times = times
        if sample.is_reset and not self.topic.transducer.queue:
            pairs = list(zip(times, before, strict=False))
            newest = max((time for time, last in pairs if time != last), default=latest)
            for channel, (time, last) in enumerate(pairs):
                if time == last and time > newest:
                    self._ahead[channel] = time
        if self._ahead:
            self._ahead = {key: time for key, time in self._ahead.items() if times[key] == time}
            times = tuple(0 if key in self._ahead else time for key, time in enumerate(times))
        return times, latest

    def is_as_announced(self) -> bool:
        """Whether the board still says what it said when the topic was announced."""
        try:
            descriptor = self.transducer.descriptor
        except j2a.UnknownTransducer:
            return False
        return descriptor is self.topic.transducer or descriptor == self.topic.transducer

    def is_due(self, sample: j2a.Sample, now_us: int) -> bool:
        """Whether a sample of a time is to be published, at the rate that was asked for."""
        if not self._least_us:
            return True
        if sample.is_reset:
            self._next_us = 0.0
        if now_us < self._next_us:
            self.skipped += 1
            return False
        # On a grid, so that jitter does not lower the rate; what comes behind a gap begins another.
        is_behind_gap = now_us >= self._next_us + self._least_us
        self._next_us = (now_us if is_behind_gap else self._next_us) + self._least_us
        return True

    @property
    def counts(self) -> _Counts:
        """So many samples came, of which so many were lost, and so many skipped."""
        return self.samples, self.lost, self.skipped

    def go_on_from(self, counts: _Counts) -> None:
        """Count on where the flow of this topic ended whose board was away, or has changed."""
        self.samples, self.lost, self.skipped = counts
        self._before = self.samples

    def status(self, span_s: float) -> TopicStatus:
        """Return how samples came since the last time."""
        rate = (self.samples - self._before) / span_s
        self._before = self.samples
        latencies, self.latencies_ns = self.latencies_ns, []
        latency = statistics.median(latencies) / _NS_PER_MS if latencies else None
        return TopicStatus(self.topic.name, self.samples, rate, latency, self.lost, self.skipped)


class _Board:
    """A board that has been here.

    Attributes:
        name: among the topics.
        url: where it is.
        client: of the board; None where it is not here.
        flows: its transducers by name; None until they are known.
        counts: by topic, of its transducers when it was here last.
        wishes: topics that its transducers had to get when they were learnt last.
        problem: what is wrong with it, or "".
    """

    def __init__(self, name: str, url: str, wanted: BoardConfig) -> None:
        self.name = name
        self.url = url
        self.wanted = wanted
        self.client: j2a.AsyncClient | None = None
        self.flows: dict[str, _Flow] | None = None
        self.counts: dict[str, _Counts] = {}
        self.wishes: dict[str, str] = {}
        self.early: deque[tuple[j2a.Sample, int]] = deque()  # and when they came
        self.early_lost: Counter[str] = Counter()  # by transducer
        self.learning = asyncio.Lock()  # what two had learnt at once would be announced twice
        self.problem = ""
        self.has_clock = False
        self.uncertainty_us: float | None = None

    def lose_early(self) -> None:
        """Count the samples that wait for topics in vain as lost, of those that come."""
        self.early_lost.update(sample.name for sample, _ in self.early)
        self.early.clear()


class Bridge:
    """Publishes each transducer of each board to each sink.

    Args:
        config: what it shall do.
        options: of `j2a.AsyncFleet`, such as `timeout`.

    Raises:
        j2a.BadUrl: a URL can never be opened.
        LocalError: a sink, its argument or an option is wrong.
    """

    def __init__(self, config: Config, **options: Any) -> None:
        for url in config.urls:
            check_url(url)
        self._config = config
        self._options = options
        chosen = {key: one.name for one in config.boards for key in (one.url, one.identity) if key}
        chosen = {key: name for key, name in chosen.items() if name}
        self._names = Names(with_board=config.with_board, boards=chosen)
        self._boards: dict[str, _Board] = {}
        self._unmet: dict[str, Counter[str]] = {}  # samples by board and transducer
        self._serials: dict[str, str] = {}  # and the URL of the board that is known by it
        self._twins: set[str] = set()  # serial numbers that two boards have had at one time
        self._tasks: set[asyncio.Task[None]] = set()
        self._retried: set[tuple[j2a.AsyncClient, Callable[..., Awaitable[bool]]]] = set()
        self._flows: dict[str, _Flow] = {}
        self._orders: set[Future[Any]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._fleet: j2a.AsyncFleet | None = None
        self._ended = asyncio.Event()
        self._error: Exception | None = None
        self._ticked = time.monotonic()
        self._host = socket.gethostname()
        self.runners = [
            SinkRunner(str(one), make_sink(one, self), self._sink_gave_up) for one in config.sinks
        ]

    # ------------------------------------------------------------------ life

    async def run(self, on_open: Callable[[], object] = lambda: None) -> None:
        """Bridge until `stop` is called, or no sink is left.

        Args:
            on_open: called when all sinks were opened or could not be, or after 30 s, before the
                first board is.
        """
        self._loop = asyncio.get_running_loop()
        try:
            for runner in self.runners:
                runner.start()
            await self._until_open()
            if self._ended.is_set():
                return
            on_open()
            options = {"identify": self._identify, "retry": _RETRY_S, **self._options}
            async with j2a.AsyncFleet(usb=self._config.usb, **options) as fleet:
                self._fleet = fleet
                fleet.on_change(self._change)
                fleet.on_sample(self._take)
                for url in dict.fromkeys(self._config.urls):
                    fleet.add(url)
                clocks = asyncio.create_task(self._know_clocks())
                try:
                    while not self._ended.is_set():
                        with contextlib.suppress(TimeoutError):
                            await asyncio.wait_for(self._ended.wait(), _EACH_S)
                        self._tick()
                finally:
                    clocks.cancel()
        finally:
            self._fleet = None
            for runner in self.runners:
                runner.end()
            joins = [asyncio.to_thread(runner.join) for runner in self.runners]
            for runner, has_ended in zip(self.runners, await asyncio.gather(*joins), strict=True):
                if not has_ended:
                    _logger.warning("sink %s does not end", runner.name)

    async def _until_open(self) -> None:
        """Wait until each sink was opened, or could not be; not behind `stop`, nor for ever."""
        end = time.monotonic() + _OPEN_S
        while not all(runner.opened.is_set() for runner in self.runners):
            if time.monotonic() >= end or self._ended.is_set():
                return
            await asyncio.sleep(_LOOK_S)

    def stop(self) -> None:
        """End; from the loop only."""
        self._ended.set()

    def _sink_gave_up(self) -> None:
        if self._loop is not None and all(
            runner.problem and runner.sink.RETRY_S is None for runner in self.runners
        ):
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._ended.set)

    # ------------------------------------------------------------------ boards

    async def _identify(self, client: j2a.AsyncClient) -> str:
        """Return the serial number of a board, or its URL: boards may be built with equal ones.

        Of such twins the one that was first stays known by the number, at its URL alone: whichever
        is plugged in again first must not get the topics of the other one.
        """
        serial = (await client.properties()).get("serial")
        if not serial:
            return client.url
        if self._serials.setdefault(serial, client.url) != client.url:
            self._twins.add(serial)
            return client.url
        return serial

    async def _change(self, change: BoardChange) -> None:
        if not change.is_here:
            self._serials = {
                one: url
                for one, url in self._serials.items()
                if url != change.url or one in self._twins
            }
        if change.board is None:
            if change.reason is not None:  # or the bridge ends before it came
                _logger.warning("%s", change.reason)
            return
        if change.is_here:
            await self._come(change.board, change.url)
        else:
            self._go(change.board, change.reason)

    async def _come(self, identity: str, url: str) -> None:
        assert self._fleet is not None
        client = self._fleet[identity]
        client.on_restart(lambda _restart: self._restarted(identity, client))
        await self._persist(client, self._meet, identity, url, client)

    async def _restarted(self, identity: str, client: j2a.AsyncClient) -> None:
        """Learn anew what a board has; its samples come behind this."""
        board = self._boards.get(identity)
        if board is None:
            return
        board.lose_early()  # what they are is known no more
        if board.client is client:  # or `_meet` is under way
            if not board.has_clock:
                await self._begin_clock(board, client)
            await self._persist(client, self._learn, board)

    async def _meet(self, identity: str, url: str, client: j2a.AsyncClient) -> bool:
        """Get to know a board that is here; return whether there is no more to try."""
        board = self._boards.get(identity)
        try:
            properties = await client.properties()
            if board is None:
                self._forget_boards()
                name = self._names.board(identity, url, properties)
                board = self._boards[identity] = _Board(name, url, self._wanted(identity, url))
                board.early_lost = self._unmet.pop(identity, Counter())
            board.client, board.url = client, url
            await self._begin_clock(board, client)
        except j2a.J2AError as error:
            _logger.warning("%s: %s", url, error)
            if board is not None:
                board.problem = str(error)
            return False
        await self._persist(client, self._learn, board)
        return True

    async def _persist(
        self, client: j2a.AsyncClient, attempt: Callable[..., Awaitable[bool]], *args: Any
    ) -> None:
        """Try something, and where that fails, each second while the board is here."""
        what = client, attempt
        # A board that restarts again and again must not have it tried side by side.
        if await attempt(*args) or what in self._retried:
            return
        self._retried.add(what)

        async def again() -> None:
            try:
                while client.is_open and not self._ended.is_set():
                    await asyncio.sleep(_EACH_S)
                    if await attempt(*args):
                        return
            finally:
                self._retried.discard(what)

        # Neither its samples nor other boards need wait for that.
        task = asyncio.create_task(again())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _forget_boards(self) -> None:
        """Forget the boards that went first, where there have been very many."""
        gone = [key for key, one in self._boards.items() if one.client is None]
        for identity in gone[: max(0, len(self._boards) - _MAX_BOARDS)]:
            del self._boards[identity]
            self._names.forget_board(identity)

    def _wanted(self, identity: str, url: str) -> BoardConfig:
        found = [one for one in self._config.boards if one.identity == identity]
        found += [one for one in self._config.boards if one.url == url]
        return found[0] if found else BoardConfig()

    async def _begin_clock(self, board: _Board, client: j2a.AsyncClient) -> None:
        """Know the clock of a board, and keep it right, as far as it can be."""
        board.has_clock = False
        if self._config.clock != "off":
            await self._persist(client, self._try_clock, board, client)

    async def _try_clock(self, board: _Board, client: j2a.AsyncClient) -> bool:
        """Begin to keep a clock; return whether there is no more to try."""
        if board.has_clock:
            return True  # since it was tried last, after a restart
        try:
            await self._measure_clock(board, client)
            can_be_set = "clock" in await client.capabilities()
            is_set = self._config.clock == "discipline" and can_be_set
            await (client.clock.discipline() if is_set else client.clock.follow())
            board.has_clock = True
        except j2a.NoClock as error:
            _logger.info("%s: times are those of arrival: %s", board.name, error)
        except j2a.J2AError:
            return not client.is_open
        return True

    async def _measure_clock(self, board: _Board, client: j2a.AsyncClient) -> None:
        """Know the clock for the first samples, before it is kept.

        Raises:
            NoClock: the board has none.
        """
        try:
            board.uncertainty_us = (await client.clock.measure(2)).uncertainty_us
        except j2a.NoClock as error:
            if client.clock.known_bound_us is None:
                raise
            _logger.info("%s: times are those of arrival as yet: %s", board.name, error)
        except j2a.LocalError:
            pass  # the exchanges contradict each other; those that follow will decide

    async def _learn(self, board: _Board) -> bool:
        """Announce the transducers of a board, and take those back that it has no more.

        Returns:
            There is no more to try.
        """
        async with board.learning:
            try:
                return await self._learn_alone(board)
            except j2a.J2AError as error:  # no answer, or it has restarted meanwhile
                board.problem = str(error)
                _logger.warning("%s: %s", board.name, error)
                return False

    async def _learn_alone(self, board: _Board) -> bool:
        client = board.client
        if client is None:
            return True
        transducers = await client.transducers()
        descriptors = transducers.descriptors
        found: dict[str, tuple[Any, Transducer, SensorConfig, str]] = {}
        for name, transducer in transducers.items():
            wanted = board.wanted.transducers.get(name, SensorConfig())
            if wanted.is_published:
                wish = wanted.topic or await self._topic_setting(transducer)
                found[name] = transducer, transducer.descriptor, wanted, wish
        if client is not board.client:
            return True  # it has gone meanwhile
        # Nothing waits from here on, so no other board gets a topic that is free for a moment. One
        # that a transducer has no more, or wants no more, is in the way of none of its own.
        wishes = {name: wish or one.topic for name, (_, one, _, wish) in found.items()}
        kept = {name for name, wish in wishes.items() if board.wishes.get(name) == wish}
        self._names.keep(board.name, kept)
        board.wishes = wishes
        before = board.flows or {}
        flows: dict[str, _Flow] = {}
        for name, (transducer, descriptor, wanted, wish) in found.items():
            assert descriptors is not None
            topic = Topic(
                self._names.topic(board.name, descriptor, wish),
                board.name,
                descriptor,
                descriptors,
                wanted.message,
            )
            old = before.get(name)
            if old is not None and old.topic == topic:
                old.transducer = transducer
                flows[name] = old
            else:
                flows[name] = _Flow(topic, transducer, wanted)
        for name, flow in before.items():
            if flows.get(name) is not flow:
                self._retract(flow)
        counts = board.counts | {one.topic.name: one.counts for one in before.values()}
        for name, flow in flows.items():
            if before.get(name) is not flow:
                flow.go_on_from(counts.get(flow.topic.name, (0, 0, 0)))
                self._announce(flow)
        if board.flows is None and flows:
            topics = ", ".join(flow.topic.name for flow in flows.values())
            _logger.info("%s is here: %s", board.name, topics)
        board.flows, board.counts = flows, {}
        missing = sorted(board.wanted.transducers.keys() - transducers.keys())
        board.problem = transducers.why if not transducers else ""
        if missing:
            board.problem = f"it has no transducer {', '.join(missing)}"
        if board.problem:
            _logger.warning("%s: %s", board.name, board.problem)
        early, board.early = board.early, deque()
        lost, board.early_lost = board.early_lost, Counter()
        for name, count in lost.items():
            if name in flows:
                flows[name].samples += count
                flows[name].lost += count
        for sample, arrived_ns in early:
            self._take_of(board, sample, arrived_ns)
        return True

    async def _topic_setting(self, transducer: Any) -> str:
        """Return the topic that was chosen at run time, where there is one.

        Raises:
            J2AError: the board did not tell it; its samples must not go to another one.
        """
        if not transducer.descriptor.has("topic"):
            return ""
        try:
            return str(await transducer.setting("topic"))
        except (j2a.FunctionFailed, j2a.OpcodeRefused, j2a.ProtocolError):
            return ""  # nor will it tell

    def _go(self, identity: str, reason: j2a.J2AError | None) -> None:
        board = self._boards.get(identity)
        if board is None:
            self._unmet.pop(identity, None)
            return
        board.client = None
        board.problem = str(reason) if reason is not None else "taken out"
        flows, board.flows = board.flows, None
        if flows is not None:
            board.counts = {one.topic.name: one.counts for one in flows.values()}
        board.lose_early()
        for flow in (flows or {}).values():
            self._retract(flow)
        if not self._ended.is_set():
            _logger.warning("%s is gone: %s", board.name, board.problem)

    def _announce(self, flow: _Flow) -> None:
        self._flows[flow.topic.name] = flow
        for runner in self.runners:
            runner.announce(flow.topic)

    def _retract(self, flow: _Flow) -> None:
        if self._flows.get(flow.topic.name) is flow:
            del self._flows[flow.topic.name]
        for runner in self.runners:
            runner.retract(flow.topic)

    # ------------------------------------------------------------------ samples

    def _take(self, sample: j2a.Sample) -> None:
        board = self._boards.get(sample.board)
        if board is None:  # its properties are still asked for; at the first time only
            self._unmet.setdefault(sample.board or "", Counter())[sample.name] += 1
            return
        arrived_ns = time.time_ns()
        if board.flows is None:
            if len(board.early) >= _EARLY:
                oldest, _ = board.early.popleft()
                board.early_lost[oldest.name] += 1
            board.early.append((sample, arrived_ns))
            return
        self._take_of(board, sample, arrived_ns)

    def _take_of(self, board: _Board, sample: j2a.Sample, arrived_ns: int) -> None:
        assert board.flows is not None
        flow = board.flows.get(sample.name)
        if flow is None:  # not wanted, or `_learn` is under way, which counts it
            board.early_lost[sample.name] += 1
            return
        flow.samples += 1
        flow.lost += sample.lost + sample.missed
        if not flow.is_as_announced():
            flow.lost += 1  # `_learn` is under way
            return
        times, latest = flow.take_times(sample)
        newest = max(times)
        if newest - min(times) > _YEAR_US:
            # The clock was set behind these readings, by decades: the shift is not theirs.
            times = tuple(one if newest - one <= _YEAR_US else 0 for one in times)
        if not flow.is_due(sample, newest):
            return
        uncertainty = None
        if not newest:
            shift = 0
        elif sample.host_us is None or not _YEAR_US < sample.host_us < _LATEST_US:
            # A time of a board that is out of its mind counts as none that is known.
            shift = arrived_ns // _NS_PER_US - newest
        else:
            shift = sample.host_us - latest
            flow.latencies_ns.append(arrived_ns - (newest + shift) * _NS_PER_US)
            uncertainty = board.uncertainty_us
        update = _new_update(flow.topic, sample, times, shift, arrived_ns, uncertainty)
        for runner in self.runners:
            runner.publish(update)

    async def _know_clocks(self) -> None:
        """Keep the uncertainty of the clocks at hand: to ask for each sample would cost more."""
        while True:
            for board in self._boards.values():
                board.uncertainty_us = None
                if board.client is not None and board.has_clock:
                    with contextlib.suppress(j2a.J2AError):
                        board.uncertainty_us = board.client.clock.uncertainty_us
            await asyncio.sleep(_CLOCK_S)

    # ------------------------------------------------------------------ status

    def _tick(self) -> None:
        now = time.monotonic()
        status = self._status(max(now - self._ticked, 1e-3))
        self._ticked = now
        for runner in self.runners:
            runner.tell_status(status)

    def _status(self, span_s: float) -> Status:
        boards = [self._board_status(key, one, span_s) for key, one in self._boards.items()]
        known = {board.url for board in boards}
        problems = self._fleet.problems if self._fleet is not None else {}
        boards += [
            BoardStatus("", "", url, False, str(why))
            for url, why in problems.items()
            if url not in known
        ]
        return Status(self._host, tuple(boards), tuple(runner.status for runner in self.runners))

    def _board_status(self, identity: str, board: _Board, span_s: float) -> BoardStatus:
        flows = [one for one in (board.flows or {}).values() if one.topic.transducer.is_sensor]
        topics = tuple(flow.status(span_s) for flow in flows)
        state, offset, uncertainty = "", None, None
        if board.client is not None and board.has_clock:
            with contextlib.suppress(j2a.J2AError):
                reading = board.client.clock.read()
                state = reading.state
                offset, uncertainty = reading.offset_us, reading.uncertainty_us
        is_here = board.client is not None
        return BoardStatus(
            board.name,
            identity,
            board.url,
            is_here,
            board.problem,
            state,
            offset,
            uncertainty,
            topics,
        )

    # ------------------------------------------------------------------ orders of sinks

    def submit(self, coroutine: Coroutine[Any, Any, Any]) -> "Future[Any]":
        """Run a coroutine in the loop of the bridge."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                return asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        coroutine.close()
        raise j2a.LocalError("the bridge does not run")

    def _order(self, coroutine: Coroutine[Any, Any, Any]) -> "Future[Any]":
        """Run an order of a sink, unless too many wait already."""
        if len(self._orders) >= _MAX_ORDERS:
            coroutine.close()
            refused: Future[Any] = Future()
            refused.set_exception(
                j2a.LocalError(f"{_MAX_ORDERS} orders wait already: this one was not done")
            )
            return refused
        future = self.submit(coroutine)
        self._orders.add(future)
        future.add_done_callback(self._orders.discard)
        return future

    def client(self, board: str) -> j2a.AsyncClient:
        """Return the client of a board, by its name among the topics.

        Raises:
            UnknownBoard: it is not here.
        """
        for one in self._boards.values():
            if one.name == board and one.client is not None:
                return one.client
        raise j2a.UnknownBoard(f"board {board!r:.80} is not here")

    def set(
        self,
        topic: str,
        values: Sequence[Any],
        *,
        channel: int = 0,
        at_ns: int = 0,
        raw: bool = False,
    ) -> "Future[None]":
        """Set channels of an actuator; see `j2a_bridge.sink.Control`."""

        async def order() -> None:
            flow = self._flow(topic)
            if flow.topic.transducer.is_sensor:
                raise j2a.WrongArgument(f"{topic} is a sensor, which cannot be set")
            if not flow.is_as_announced():
                await self.client(flow.topic.board).transducers()  # if it has just restarted
                if not flow.is_as_announced():
                    raise j2a.InterfaceChanged(
                        f"{topic} is another actuator now, after a restart of its board"
                    )
            at_us = 0
            if at_ns:
                at_us = self.client(flow.topic.board).clock.to_device(at_ns // _NS_PER_US)
            await flow.transducer.set(*values, channel=channel, at_us=at_us, raw=raw)

        return self._order(order())

    def configure(self, topic: str, settings: Mapping[str, Any]) -> "Future[dict[str, Any]]":
        """Change settings of a transducer."""

        async def order() -> dict[str, Any]:
            flow = self._flow(topic)
            await flow.transducer.configure(**settings)
            found = await self._settings(flow)
            if "topic" in settings:
                here = [one for one in self._boards.values() if one.name == flow.topic.board]
                for board in here:  # which is one, and others may come meanwhile
                    if board.client is not None:
                        await self._persist(board.client, self._learn, board)
            return found

        return self._order(order())

    def settings(self, topic: str) -> "Future[dict[str, Any]]":
        """Return the settings of a transducer."""

        async def order() -> dict[str, Any]:
            return await self._settings(self._flow(topic))

        return self._order(order())

    async def _settings(self, flow: _Flow) -> dict[str, Any]:
        has = flow.topic.transducer.has
        is_sensor = flow.topic.transducer.is_sensor
        names = [
            name for name in _SETTINGS if has(name) or (is_sensor and name in ("enabled", "period"))
        ]
        return {name: await flow.transducer.setting(name) for name in names}

    def call(self, board: str, function: str, values: Sequence[Any]) -> "Future[Any]":
        """Call a function of a board by its name."""

        async def order() -> Any:
            functions = await self.client(board).functions()
            return await functions[function](*values)

        return self._order(order())

    def _flow(self, topic: str) -> _Flow:
        found = self._flows.get(topic)
        if found is None:
            raise j2a.UnknownTransducer(f"no board that is here has the topic {topic!r:.80}")
        return found
