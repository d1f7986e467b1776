"""A caller that waits reads for itself, where the transport has a descriptor."""

import contextlib
import gc
import itertools
import signal
import sys
import threading
import time

import pytest
from j2a_spec import oracle
from j2a_spec.constants import SOF, SOS
from j2a_transports import TransportError
from j2a_transports._tcp import TcpTransport

import j2a

from .sockets import tcp_pair
from .support import PATIENCE_S
from .wire import Background


class Noted(TcpTransport):
    """Notes which threads have read something; raises once what it is told to, after reading."""

    def __init__(self, *args):
        super().__init__(*args)
        self.readers = set()
        self.raises = None

    def read(self, timeout_s):
        data = super().read(timeout_s)
        if data:
            self.readers.add(threading.current_thread())
            is_caller = threading.current_thread() is threading.main_thread()
            if self.raises is not None and is_caller:
                error, self.raises = self.raises, None
                raise error
        return data


@contextlib.contextmanager
def linked(**options):
    """A client and the far end of its link."""
    near, far = tcp_pair(Noted)
    with far, j2a.Client(near, timeout=PATIENCE_S, **options) as client:
        yield client, near, far


def answer(far, *before, code=0, data=b"ok"):
    """Answer the request that comes, with frames before the reply."""
    stream = b""
    while not (frames := oracle.decode(stream)):
        stream += far.read(PATIENCE_S)
    reply = oracle.Frame(SOF, frames[-1].seq, code, data)
    far.write(b"".join(map(oracle.encode, (*before, reply))))


def calls(client, far, count):
    """Make calls one after the other; the device is a thread of this process."""
    device = Background(lambda: [answer(far) for _ in range(count)])
    for _ in range(count):
        assert client.call(1).payload == b"ok"
    device.result()


def test_the_caller_reads_for_itself():
    with linked() as (client, near, far):
        calls(client, far, 50)
        assert threading.current_thread() in near.readers


def test_sifs_come_between_calls_and_without_any():
    with linked() as (client, _near, far):
        seen, came = [], threading.Event()

        @client.on_sif()
        def handler(sif):
            seen.append(sif.seq)
            if len(seen) == 20:
                came.set()

        for n in range(10):
            device = Background(answer, far, oracle.Frame(SOS, n, 7, b""))
            client.call(1)
            device.result()
        for n in range(10, 20):
            far.write(oracle.encode(oracle.Frame(SOS, n, 7, b"")))
        assert came.wait(PATIENCE_S)
        assert seen == list(range(20))


def test_a_call_that_takes_long_is_left_to_the_reading_thread(monkeypatch):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", 0.0)
    with linked() as (client, near, far):
        calls(client, far, 5)
        assert threading.current_thread() not in near.readers


def test_many_callers_get_their_own_replies():
    with linked() as (client, _near, far):

        def device():
            stream = b""
            for _ in range(400):
                while len(frames := oracle.decode(stream)) == 0:
                    stream += far.read(PATIENCE_S)
                stream = b"".join(map(oracle.encode, frames[1:]))
                far.write(oracle.encode(oracle.Frame(SOF, frames[0].seq, 0, frames[0].payload)))

        def caller(number):
            for n in range(50):
                payload = bytes((number, n))
                assert client.call(1, payload).payload == payload

        served = Background(device)
        for one in [Background(caller, number) for number in range(8)]:
            one.result()
        served.result()


def test_the_time_limit_of_a_caller_that_reads():
    with linked() as (client, _near, far):
        start = time.monotonic()
        for limit_s in (0.001, 0.004, 0.006, 0.05):
            with pytest.raises(j2a.CallTimeout):
                client.call(1, timeout=limit_s)
        assert time.monotonic() - start >= 0.061
        far.read(PATIENCE_S)
        calls(client, far, 3)


def test_the_link_is_lost_while_the_caller_reads():
    with linked() as (client, _near, far):
        call = Background(client.call, 1)
        far.read(PATIENCE_S)
        far.close()
        with pytest.raises(j2a.LinkLost):
            call.result()
        with pytest.raises(j2a.LinkLost):
            client.call(1)


def test_another_thread_closes_while_the_caller_reads():
    with linked() as (client, _near, far):
        call = Background(client.call, 1)
        far.read(PATIENCE_S)
        client.close()
        with pytest.raises(j2a.LinkClosed):
            call.result()


@pytest.fixture
def on_alarm():
    """on_alarm(function) has the signal SIGALRM call it."""
    before = signal.getsignal(signal.SIGALRM)
    yield lambda function: signal.signal(signal.SIGALRM, lambda *_: function())
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("leads", [True, False])
def test_a_signal_handler_calls_while_its_thread_waits(on_alarm, monkeypatch, leads):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", PATIENCE_S if leads else 0.0)
    with linked() as (client, _near, far):
        calls(client, far, 3)
        seen = []

        def device():
            stream = b""
            while not (frames := oracle.decode(stream)):
                stream += far.read(PATIENCE_S)
            with client._engine._turn:  # a call that is being sent cannot be interrupted by one
                pass
            signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)
            while client._session.waiting < 2:
                time.sleep(0.001)
            # The window is one: the second request is sent when the first has its reply.
            far.write(oracle.encode(oracle.Frame(SOF, frames[0].seq, 0, b"outer")))
            answer(far, data=b"inner")

        on_alarm(lambda: seen.append(client.call(2).payload))
        served = Background(device)
        assert client.call(1).payload == b"outer"
        served.result()
        assert seen == [b"inner"]


class StopError(Exception):
    """What a signal handler raises."""


@pytest.mark.parametrize("error", [KeyboardInterrupt, StopError])
def test_an_exception_of_a_signal_handler_leaves_the_link_usable(on_alarm, error):
    def stop():
        raise error

    def device():
        far.read(PATIENCE_S)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)

    with linked() as (client, _near, far):
        on_alarm(stop)
        served = Background(device)
        with pytest.raises(error):
            client.call(1)
        served.result()
        calls(client, far, 3)


@pytest.mark.parametrize("error", [KeyboardInterrupt, StopError])
def test_bytes_in_hand_when_a_signal_handler_raises(error, monkeypatch):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", PATIENCE_S)
    with linked() as (client, near, far):
        near.raises = error()
        for _ in range(1000):  # until it is the caller that reads
            served = Background(answer, far)
            try:
                client.call(1)
            except error:
                served.result()
                break
            served.result()
        assert near.raises is None
        calls(client, far, 3)
        assert client._session.waiting == 0


def test_a_state_left_in_the_middle_is_put_in_order():
    with linked() as (client, _near, far):
        session = client._session
        call = session.start_call("x", 1, b"", now=0.0, timeout_s=9.0, waiter=threading.Lock())
        # As if the reply had been taken and nothing else had come of it.
        call.reply, call.has_ended = j2a.Reply(0, b""), True
        assert session.recover() == [call]
        assert session.waiting == 0
        session.data_to_send()
        calls(client, far, 3)


def test_calls_made_at_once_are_all_given_up_when_a_signal_handler_raises(on_alarm):
    def stop():
        raise StopError

    def device():
        far.read(PATIENCE_S)
        with client._engine._turn:  # all of them are made by then
            pass
        signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)

    with linked() as (client, _near, far):
        on_alarm(stop)
        served = Background(device)
        with pytest.raises(StopError):
            client._engine.call_all([("one of three", 1, b"", PATIENCE_S)] * 3)
        served.result()
        assert client._session.waiting == 0


def test_a_call_of_a_signal_handler_keeps_its_time_limit(on_alarm, monkeypatch):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", PATIENCE_S)
    with linked() as (client, _near, far):
        calls(client, far, 3)
        is_over = threading.Event()

        def inner():
            with pytest.raises(j2a.CallTimeout):
                client.call(2, timeout=0.05)
            is_over.set()

        def device():
            stream = b""
            while not (frames := oracle.decode(stream)):
                stream += far.read(PATIENCE_S)
            with client._engine._turn:  # a call that is being sent cannot be interrupted by one
                pass
            signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)
            if is_over.wait(PATIENCE_S):
                far.write(oracle.encode(oracle.Frame(SOF, frames[0].seq, 0, b"outer")))
            else:
                far.close()

        on_alarm(inner)
        served = Background(device)
        assert client.call(1).payload == b"outer"
        served.result()


def interrupted_at(place, work):
    """Do the work, and raise at so many places of our code where a signal handler may.

    Returns: whether it came to that.
    """
    left = itertools.count(place, -1)

    def profile(frame, event, what):
        if not frame.f_globals["__name__"].startswith(("j2a.io", "j2a.protocol", "j2a_transports")):
            return
        # The interpreter looks for signals behind a call, not between a block and its `__exit__`.
        if event == "c_call" and what.__name__ == "__exit__":
            return
        if next(left) == 0:
            sys.setprofile(None)
            raise StopError

    gc.disable()  # what a destructor raises goes nowhere
    sys.setprofile(profile)
    try:
        work()
    except StopError:
        return True
    finally:
        sys.setprofile(None)
        gc.enable()
    return False


def answers(far):
    """Answer each request until the link ends."""
    stream = b""
    with contextlib.suppress(TransportError):
        while data := far.read(PATIENCE_S):
            stream += data
            while frames := oracle.decode(stream):
                far.write(oracle.encode(oracle.Frame(SOF, frames[0].seq, 0, b"ok")))
                stream = b"".join(map(oracle.encode, frames[1:]))


@pytest.mark.parametrize("leads", [True, False])
@pytest.mark.parametrize("is_nested", [False, True])
def test_wherever_a_signal_handler_raises_no_lock_stays_taken(caplog, leads, is_nested):
    for place in itertools.count():
        with linked() as (client, _near, far):
            device = Background(answers, far)
            client.call(1)
            link = client._engine._link
            if leads:  # the next call finds nobody who reads, or that this thread does
                while not link.start_leading():
                    client.call(1)
                if not is_nested:
                    link.stop_leading(False)
            was_raised = interrupted_at(place, lambda client=client: client.call(1))
            assert link.is_leading == (leads and is_nested)
            if link.is_leading:
                link.stop_leading(True)
            # Other threads can call, and nobody waits for a lock at the end.
            assert Background(client.call, 1).result().payload == b"ok"
        device.result()
        if not was_raised:
            break
    assert place > 90
    assert not caplog.records


@pytest.mark.parametrize("came", [0, 1, 3])
def test_a_signal_handler_closes_while_its_thread_reads(on_alarm, monkeypatch, caplog, came):
    monkeypatch.setattr("j2a.io.blocking.LEAD_S", PATIENCE_S)
    with linked() as (client, _near, far):
        seen = []
        client.on_sif()(lambda sif: seen.append(sif.seq))
        link = client._engine._link
        while not link.start_leading():
            calls(client, far, 1)

        def close():
            for seq in range(came):
                far.write(oracle.encode(oracle.Frame(SOS, seq, 7, b"")))
            client.close()

        def device():
            far.read(PATIENCE_S)
            with client._engine._turn:
                pass
            signal.pthread_kill(threading.main_thread().ident, signal.SIGALRM)

        on_alarm(close)
        served = Background(device)
        with pytest.raises(j2a.LinkClosed):
            client.call(1)
        link.stop_leading(False)
        served.result()
        assert seen == list(range(came))
    assert not caplog.records
