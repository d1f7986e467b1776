"""The host of one simulated board, for several threads: transfers in, what became of them out.

Rules: only one thread runs the simulator at a time, the one that waits for something and finds it
not run by another, or one that does nothing else (`drive`); it takes what the others have asked for
before each slice of simulated time, and tells each whose transfer is done. Timeouts are in
simulated time. Simulated time passes only while a thread waits. A board that takes its power from
the bus, by its descriptor, starts anew when it is plugged in again. Speed 0 is as fast as possible
while something moves on the bus, and real time at most while nothing does, so that a reader that
waits costs next to nothing; any other speed is simulated seconds per second at most.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING, Final, TypeVar

from j2a_spec.usb import CONFIGURATION

from j2a_sim._avr import AvrSim
from j2a_sim._errors import FirmwareStopped, SimError
from j2a_sim._pace import Pacer
from j2a_sim._usb.descriptors import (
    IN,
    SETUP,
    Descriptors,
    parse_configuration,
    parse_device,
)
from j2a_sim._usb.transfer import (
    CLEAR_FEATURE,
    SET_ADDRESS,
    SET_CONFIGURATION,
    SET_INTERFACE,
    Transfer,
)

if TYPE_CHECKING:
    from j2a_sim._usb_bus.bus import Completion

SLICE_S: Final = 0.001
# At speed 0, simulated time after the last sign of traffic that still passes at full speed.
ACTIVE_S: Final = 0.005
LOOK_S: Final = 0.1  # so often a wait looks whether it shall end
RESET_RECOVERY_S: Final = 0.01  # USB 2.0, 7.1.7.5
SET_ADDRESS_RECOVERY_S: Final = 0.002  # USB 2.0, 9.2.6.3

_Result = TypeVar("_Result")


class UsbHost:
    """The host that one simulated board is plugged into.

    Args:
        sim: the simulator; nothing else may run it or use its bus.
        speed: see the module's rules.
        on_gone: called when the board has gone from the bus, by the thread that runs it.

    Attributes:
        sim: the simulator.
        present: whether the board is plugged in, enumerated, and was not seen to go since.
        configuration: bConfigurationValue of the configuration that was set; 0: none.
        descriptors: what the board told when it was plugged in last.
        error: why the firmware stopped, if it did.

    Raises:
        SimError: the chip has no USB.
    """

    def __init__(
        self,
        sim: AvrSim,
        *,
        speed: float = 0.0,
        on_gone: Callable[[], None] = lambda: None,
    ) -> None:
        if not 0 <= speed < float("inf"):
            raise SimError(f"speed {speed} is out of range: 0, or simulated seconds per second")
        self.sim = sim
        self._bus = sim.usb
        self.on_gone = on_gone
        self.present = False
        self.configuration = 0
        self.descriptors: Descriptors | None = None
        self.error: FirmwareStopped | None = None
        self._address = 0
        self._speed = speed
        self._pacer = Pacer(speed or 1.0)
        self._pacer.restart(sim.time_s)
        self._active_until = 0
        self._moved = (0, 0)
        self._changed = threading.Condition()
        self._driven = False
        self._jobs: deque[Callable[[], None]] = deque()
        self._pending: dict[int, Transfer] = {}

    # -- for any thread -----------------------------------------------------------------------

    def submit(self, transfer: Transfer) -> None:
        """Begin a transfer as soon as somebody waits or drives."""
        self._post(lambda: self._begin(transfer))

    def cancel(self, transfer: Transfer, fate: str = "cancelled") -> None:
        """Give a transfer up; it is done with this status unless it ends in another way before."""
        self._post(lambda: self._give_up([transfer], fate))

    def wait(self, transfer: Transfer) -> None:
        """Return when a submitted transfer is done, and run the simulator until then."""
        try:
            self._wait_until(lambda: transfer.status != "")
        except BaseException:
            self.cancel(transfer)
            raise

    def drive(self, stop: threading.Event) -> None:
        """Run the simulator until `stop` is set.

        Raises:
            FirmwareStopped: the firmware can go no further.
        """
        self._wait_until(lambda: stop.is_set() or self.error is not None)
        if self.error is not None:
            raise self.error

    def call(self, function: Callable[[], _Result]) -> _Result:
        """Return what a function returns, or raise what it raises, that may use the simulator."""
        result: Future[_Result] = Future()

        def job() -> None:
            try:
                result.set_result(function())
            except FirmwareStopped as error:
                self._stop(error)
                result.set_exception(error)
            except BaseException as error:  # raised in the caller's thread
                result.set_exception(error)

        self._post(job)
        self._wait_until(result.done)
        return result.result()

    def plug(self, address: int) -> Descriptors:
        """Plug the board in, enumerate it and set its first configuration.

        Args:
            address: which it gets, 1..127.

        Returns:
            What it has told of itself.

        Raises:
            SimError: it does not attach, answer, or describe itself.
        """
        return self.call(lambda: self._plug(address))

    def unplug(self) -> None:
        """Unplug the board; its transfers end as "unplugged"."""
        self.call(self._unplug)

    def reset(self) -> None:
        """Reset the bus, and give the board its address and configuration back.

        Raises:
            SimError: it does not answer any more.
        """
        self.call(self._reset)

    # -- for the thread that runs the simulator -----------------------------------------------

    def _post(self, job: Callable[[], None]) -> None:
        with self._changed:
            self._jobs.append(job)
            self._changed.notify_all()

    def _wait_until(self, done: Callable[[], bool]) -> None:
        """Run the simulator until `done`, or wait while another thread runs it."""
        while True:
            with self._changed:
                while self._driven and not done():
                    self._changed.wait()
                if done():
                    return
                self._driven = True
            try:
                while not done():
                    self._step()
            finally:
                with self._changed:
                    self._driven = False
                    self._changed.notify_all()

    def _step(self) -> None:
        """Take what was asked for, let a slice of simulated time pass, and tell who is done."""
        wait_s = self._wait_s()
        with self._changed:
            if wait_s and not self._jobs:
                self._changed.wait(min(wait_s, LOOK_S))
                if wait_s > LOOK_S and not self._jobs:
                    return  # not yet due, and whoever waits may have to stop
            jobs = list(self._jobs)
            self._jobs.clear()
        for job in jobs:
            job()
            self._stay_active()
        if self.error is None:
            try:
                self._run_slice()
            except FirmwareStopped as error:
                self._stop(error)
        if self._collect() or jobs:
            with self._changed:
                self._changed.notify_all()

    def _run_slice(self) -> None:
        now = self.sim.cycle
        nearest = min((t.deadline for t in self._pending.values()), default=float("inf"))
        self.sim.run_until_usb(int(max(1, min(self.sim.cycles(SLICE_S), nearest - now))))
        self.sim.drop_untaken()
        counters = self._bus.counters
        moved = (counters.bytes_in, counters.bytes_out)
        if moved != self._moved:
            self._moved = moved
            self._stay_active()

    def _collect(self) -> bool:
        """Give each transfer what became of it; returns whether there was one."""
        any_done = self._take_completed()
        now = self.sim.cycle
        late = [t for t in self._pending.values() if t.deadline <= now]
        if late:
            self._give_up(late, "timeout")
        if self.present and not self._bus.enabled:
            self._lose()
            return True
        return any_done or bool(late)

    def _take_completed(self) -> bool:
        completed = self._bus.completed()
        for done in completed:
            transfer = self._pending.pop(done.id, None)
            if transfer is not None:
                status = done.status
                if status == "cancelled" and transfer.fate:
                    status = transfer.fate
                elif status == "no_answer" and not self._bus.enabled:
                    status = "unplugged"
                self._finish(transfer, status, done)
        return bool(completed)

    def _begin(self, transfer: Transfer) -> None:
        if self.error is not None:
            self._finish(transfer, "stopped")
            return
        if not self.present or self.descriptors is None:
            self._finish(transfer, "unplugged")
            return
        try:
            number = self._submit(transfer, self.descriptors.packet(transfer.endpoint))
        except SimError:  # its parts contradict one another
            self._finish(transfer, "invalid")
            return
        transfer.number = number
        if transfer.timeout_s is not None:
            transfer.deadline = self.sim.cycle + self.sim.cycles(transfer.timeout_s)
        self._pending[number] = transfer

    def _submit(self, transfer: Transfer, packet: int) -> int:
        endpoint = transfer.endpoint
        if transfer.setup:
            return self._bus.submit_control(transfer.setup, transfer.data)
        if endpoint & IN:
            return self._bus.submit_in(endpoint, transfer.length, packet=packet)
        zero = transfer.zero_packet
        return self._bus.submit_out(endpoint, transfer.data, packet=packet, zero_packet=zero)

    def _give_up(self, transfers: list[Transfer], fate: str) -> None:
        """Cancel transfers that are under way; what they have brought so far is kept.

        One whose packet is on the wire ends after that packet.
        """
        for transfer in transfers:
            if self._pending.get(transfer.number) is transfer:
                transfer.fate, transfer.deadline = fate, float("inf")
                self._bus.cancel(transfer.number)
        self._take_completed()

    def _finish(self, transfer: Transfer, status: str, done: Completion | None = None) -> None:
        if done is not None:
            transfer.received, transfer.transferred = bytes(done.data), done.transferred
        if status == "ok" and transfer.setup:
            self._after_control(transfer.setup)
        transfer.status = status
        if transfer.on_done is not None:
            transfer.on_done(transfer)

    def _after_control(self, setup: bytes) -> None:
        """Let the host's side follow a request that sets data toggles back."""
        request = SETUP.parse(setup)
        kind = (request.bmRequestType, request.bRequest)
        if kind == (0x00, SET_CONFIGURATION):
            self.configuration = request.wValue & 0xFF
            self._bus.clear_toggle(None)
        elif kind == (0x01, SET_INTERFACE):
            for endpoint in self._endpoints(request.wIndex):
                self._bus.clear_toggle(endpoint)
        elif kind == (0x02, CLEAR_FEATURE) and request.wIndex & 0x0F:  # of ENDPOINT_HALT
            self._bus.clear_toggle(request.wIndex & 0xFF)

    def _endpoints(self, interface: int) -> set[int]:
        """The addresses of an interface's endpoints, in all its alternate settings."""
        found = self.descriptors and self.descriptors.configuration(self.configuration)
        return {
            endpoint.fields.bEndpointAddress
            for part in (found.parts if found else [])
            if part.fields.bInterfaceNumber == interface
            for endpoint in part.parts
        }

    def _plug(self, address: int) -> Descriptors:
        if self.error is not None:
            raise self.error
        self._unplug()
        if self.descriptors is not None and not self.descriptors.self_powered:
            self.sim.reset()  # it was without power
        found = self._bus.enumerate(address=address)
        self._address = address
        device = parse_device(found.device)
        others = [
            self._bus.descriptor(CONFIGURATION, index, length=0xFFFF)
            for index in range(1, device.bNumConfigurations)
        ]
        self.descriptors = Descriptors(
            device,
            tuple(parse_configuration(data) for data in (found.configuration, *others)),
        )
        self.configuration = self.descriptors.configurations[0].fields.bConfigurationValue
        self.present = True
        return self.descriptors

    def _unplug(self) -> None:
        self._end_all("unplugged")
        self._bus.unplug()
        self._lose()

    def _lose(self) -> None:
        """End all transfers of a board that is not there any more."""
        was_there, self.present, self.configuration = self.present, False, 0
        self._end_all("unplugged")
        if was_there:
            self.on_gone()

    def _reset(self) -> None:
        if not self.present or self.descriptors is None:
            raise SimError("the board is unplugged")
        self._end_all("cancelled")
        self._bus.reset()
        self.sim.run(self.sim.cycles(RESET_RECOVERY_S))
        self._bus.packet0 = self.descriptors.device.bMaxPacketSize0
        self._bus.control(0x00, SET_ADDRESS, self._address)
        self.sim.run(self.sim.cycles(SET_ADDRESS_RECOVERY_S))
        self._bus.address = self._address
        if self.configuration:
            self._bus.control(0x00, SET_CONFIGURATION, self.configuration)
        self._bus.clear_toggle(None)

    def _stop(self, error: FirmwareStopped) -> None:
        self.error = error
        self._end_all("stopped")

    def _end_all(self, fate: str) -> None:
        self._give_up(list(self._pending.values()), fate)
        while self._pending:  # whose packet is on the wire, and gets lost
            self._finish(self._pending.popitem()[1], fate)

    # -- pace ---------------------------------------------------------------------------------

    def _wait_s(self) -> float:
        """How long to wait for something to do before the next slice."""
        sim = self.sim
        if self._speed == 0 and sim.cycle < self._active_until:
            self._pacer.restart(sim.time_s)
            return 0.0
        return self._pacer.wait_s(sim.time_s)

    def _stay_active(self) -> None:
        self._active_until = self.sim.cycle + self.sim.cycles(ACTIVE_S)
