# SPDX-License-Identifier: Apache-2.0
"""The thread that owns the bus: read, think, write, at a fixed rate. Nobody else touches the port while it runs."""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, TypeVar

from softgrip_driver.errors import DriverError, PortLostError
from softgrip_driver.tendon.backend import DriveReading, Setpoint, TendonBackend
from softgrip_driver.tendon.gripper import GripperController, StopPolicy
from softgrip_driver.tendon.ownership import OwnerRow
from softgrip_driver.tendon.rest import RestWatch
from softgrip_driver.tendon.status import DriveActions, DriveSnapshot
from softgrip_time import Clock, WallClock

Result = TypeVar("Result")

#: after these the device may have lost its volatile settings, or holds an error until it restarts
FAULTS_OF_THE_DEVICE = frozenset(
    {"rebooted", "overload", "overheated", "electrical_shock", "encoder_fault", "input_voltage", "stage_alarm"}
)


@dataclass(frozen=True)
class LoopSnapshot:
    """The gripper after a cycle.

    Attributes:
        sequence: number of the cycle.
        time: [s] of the loop's clock, when the readings came.
        drives: one for each tendon.
        estop: the emergency stop is on.
        rate: [Hz] over the last second; jitter_p99: [s] 99th percentile of ``|period - nominal|``.
        missed_cycles: cycles left out because the one before took too long.
        port_lost: why the port is gone, empty when it is there.
        asked_rate: [Hz] that the rate is to be compared with: less than the loop's own while the drives rest.
        is_resting: the next cycle comes later than after a period, unless somebody asks for something.
    """

    sequence: int
    time: float
    drives: tuple[DriveSnapshot, ...]
    estop: bool
    rate: float
    jitter_p99: float
    missed_cycles: int
    port_lost: str = ""
    asked_rate: float = math.nan
    is_resting: bool = False


@dataclass(frozen=True)
class _Statistics:
    """Of the last second: rate [Hz], 99th percentile of the period's error [s], rate that was asked for [Hz]."""

    rate: float
    jitter_p99: float
    asked_rate: float


class _Pace:
    """Keeps the period and its statistics; cycles begin at whole periods of the clock, whenever the first one came.

    At rest only every so many periods have a cycle.
    """

    def __init__(self, rate: float, now: float) -> None:
        self.period = 1.0 / rate
        self.missed = 0
        self._stride = 1
        self._due = math.floor(now / self.period) * self.period
        self._starts: deque[float] = deque(maxlen=max(16, round(rate)))
        self._errors: deque[float] = deque(maxlen=max(16, round(rate)))

    @property
    def interval(self) -> float:
        """[s] between the cycles asked for."""
        return self._stride * self.period

    def set_stride(self, stride: int) -> None:
        """From now on let a cycle come after so many periods."""
        if stride != self._stride:
            self._stride = stride
            self._starts.clear()
            self._errors.clear()

    def next_due(self, now: float) -> float:
        """Return when the next cycle shall begin; cycles that cannot be caught up are counted and left out."""
        self._due += self.interval
        late = now - self._due
        if late > self.interval:
            skipped = int(late / self.interval)
            self.missed += skipped
            self._due += skipped * self.interval
        return self._due

    def resume(self, now: float) -> float:
        """End a rest in the middle of a wait; return when the next cycle shall begin."""
        if self._stride > 1:
            self.set_stride(1)
            self._due = (math.floor(now / self.period) + 1) * self.period
        return self._due

    def begin_cycle(self, now: float) -> None:
        """Record that a cycle begins."""
        if self._starts:
            self._errors.append(abs(now - self._starts[-1] - self.interval))
        self._starts.append(now)

    def statistics(self) -> _Statistics | None:
        """Return those of the cycles since the last change between work and rest; None before there are two."""
        if len(self._starts) < 2:
            return None
        rate = (len(self._starts) - 1) / (self._starts[-1] - self._starts[0])
        ordered = sorted(self._errors)
        return _Statistics(rate, ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))], 1.0 / self.interval)


class BusLoop:
    """Runs a controller over a backend in a thread of its own.

    Args:
        backend: connected.
        controller: its drives are the backend's tendons.
        rate: [Hz]
        history: cycles kept for `since`.
        clock: that the cycles follow; the computer's where none is given.
        rest_stride: periods between two cycles while the drives rest; 1 = they never do.
    """

    #: [s] between attempts to reopen a lost port
    REOPEN_PERIOD = 0.2
    STATISTICS_EVERY = 10
    #: [s] of the computer's time between looks at the loop's clock
    MIN_WAIT_S = 0.005
    #: requests that are served before a cycle that is due
    MAX_LATE_REQUESTS = 16

    def __init__(
        self,
        backend: TendonBackend,
        controller: GripperController,
        rate: float,
        history: int = 256,
        clock: Clock | None = None,
        rest_stride: int = 1,
    ) -> None:
        self.clock = clock or WallClock()
        self._backend = backend
        self._controller = controller
        self._rate = rate
        self._rest_stride = rest_stride
        self._rest = RestWatch()
        # Requests wake the loop by `_wake`, cycles wake those who watch.
        self._changed = threading.Condition()
        self._requests: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._history: deque[LoopSnapshot] = deque(maxlen=history)
        self._restores: dict[str, Iterator[None]] = {}
        self._stopping = False
        self._ended = False
        #: set at the end: drives were left holding; every drive confirmed that its torque is off
        self.keeps_hold = self.has_let_go = False
        self._port_lost = ""
        self._reopen_at = 0.0
        self._thread: threading.Thread | None = None
        #: readable when there is a request, or the loop shall end
        self._wake: int | None = None
        self.failure: BaseException | None = None

    # --- from any thread -------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name="tendon-bus", daemon=True)
        self._thread.start()

    def stop(self, timeout: float = 2.0) -> None:
        """Let go of every tendon, or leave it holding where the policy says so, and end the thread."""
        with self._changed:
            self._stopping = True
            self._wake_up()
        if self._thread is not None:
            self._thread.join(timeout)

    @property
    def running(self) -> bool:
        """Whether the thread lives."""
        return self._thread is not None and self._thread.is_alive()

    def call(
        self, request: Callable[[GripperController, float], Result], timeout: float = 1.0, *, urgent: bool = False
    ) -> Result:
        """Run a request between two cycles and return what it returns, or raise what it raises.

        A request that could not begin within ``timeout`` [s] is never obeyed later; one that has begun is waited for.
        An urgent one overtakes all others and stays asked for: it is obeyed as soon as the bus is free. Nobody waits
        longer for it, as whoever stops has more to do than that.

        Raises:
            DriverError: the loop does not run.
            TimeoutError: not begun in time; an urgent one: not done in time.
        """
        future: Future[Result] = Future()
        with self._changed:
            if self._ended or not self.running:
                raise DriverError("the bus loop does not run; configure and activate the driver")
            entry = (lambda: request(self._controller, self.clock.now_s()), future)
            if urgent:
                self._requests.appendleft(entry)
            else:
                self._requests.append(entry)
            self._wake_up()
        try:
            return self._result(future, timeout)
        except TimeoutError:
            if not urgent and future.cancel():
                raise TimeoutError(
                    f"the bus was busy for {timeout:g} s, so the order was taken back and nothing moves by it; "
                    "see tendon/status"
                ) from None
            if urgent and not future.done():
                state = "has begun, and has had no answer" if future.running() else "stands and is obeyed first"
                raise TimeoutError(f"the bus has been busy for {timeout:g} s; the order {state}") from None
            return future.result()

    def _result(self, future: Future[Result], timeout: float) -> Result:
        """Return a result; TimeoutError when none came within ``timeout`` [s] of the loop's clock, which may stand."""
        deadline = self.clock.now_s() + timeout
        while True:
            try:
                return future.result(max(deadline - self.clock.now_s(), self.MIN_WAIT_S))
            except TimeoutError:
                if future.done() or self.clock.now_s() >= deadline:
                    raise

    def power(self, *, on: bool, timeout: float = 2.0) -> None:
        """Take hold of every tendon that can be held, or let go of all."""
        self.call(lambda controller, _: self._power_all(controller, on=on), timeout)

    def order(self, request: Callable[[GripperController, float], Result], *, power: bool) -> Result:
        """With ``power`` take hold of what a lock made slack; then run a request as `call` does.

        Raises:
            DriverError, TimeoutError: see `call`.
        """

        def serve(controller: GripperController, now: float) -> Result:
            if power and not controller.is_blocked:
                self._power_all(controller, on=True)
            return request(controller, now)

        return self.call(serve)

    def post(self, request: Callable[[GripperController, float], object]) -> None:
        """Run a request between two cycles; nobody waits for it. A loop that has ended does nothing."""
        with self._changed:
            if not self._ended:
                self._requests.append((lambda: request(self._controller, self.clock.now_s()), Future()))
                self._wake_up()

    def is_owner(self, token: str) -> bool:
        """Whether a token is that of a lease in force."""
        return self._controller.ownership.is_known(token)

    @property
    def owners(self) -> tuple[OwnerRow, ...]:
        """Who owns which tendon."""
        return self._controller.ownership.rows()

    def take_over(self) -> list[str]:
        """Go on holding what the process before left holding; return those tendons."""

        def adopt(controller: GripperController, _: float) -> list[str]:
            held = [name for name in controller.drives if self._backend.is_powered(name)]
            for name in held:
                controller.drives[name].take_over(self._backend.goal_position(name))
            controller.enforce_block()
            return held

        return self.call(adopt)

    def mark_session(self, tendon: str, mark: int, timeout: float = 1.0) -> None:
        """Leave a mark in a device; see TendonBackend.mark_session."""
        self.call(lambda _controller, _now: self._backend.mark_session(tendon, mark), timeout)

    def enforce_block(self) -> str:
        """Do at once what a latched stop or a lock asks for; return what could not be done yet, empty when all was.

        Raises:
            DriverError: the loop does not run, so torque is off.
            TimeoutError: the bus is busy; it is done as soon as it is free.
        """
        return self.call(lambda controller, _: self._enforce_block(controller), urgent=True)

    def reset(self, *, power: bool) -> str:
        """Leave the emergency stop and latched faults; say what happens now.

        A drive whose device may have lost its settings is set up again; those that can be are taken hold of again when
        ``power`` is set. Nothing moves.
        """
        return self.call(lambda controller, _: self._reset(controller, power=power))

    @property
    def snapshot(self) -> LoopSnapshot | None:
        """The last cycle, None before the first."""
        return self._history[-1] if self._history else None

    def since(self, sequence: int, timeout: float) -> list[LoopSnapshot]:
        """Wait up to ``timeout`` [s] for cycles after a sequence number and return them, oldest first."""
        with self._changed:
            self._changed.wait_for(lambda: self._newer(sequence) or not self.running, timeout)
            newest_first = takewhile(lambda one: one.sequence > sequence, reversed(self._history))
            return list(newest_first)[::-1]

    def _newer(self, sequence: int) -> bool:
        return bool(self._history) and self._history[-1].sequence > sequence

    def wait_for(self, condition: Callable[[LoopSnapshot], bool], timeout: float) -> LoopSnapshot | None:
        """Wait until a snapshot meets a condition; None when none did in time or the loop has ended."""
        deadline = self.clock.now_s() + timeout
        with self._changed:
            while True:
                if self._history and condition(self._history[-1]):
                    return self._history[-1]
                remaining = deadline - self.clock.now_s()
                if remaining <= 0.0 or not self.running:
                    return None
                self._changed.wait(min(remaining, 0.5))

    # --- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        with self.clock.stepping():
            self._run_cycles()

    def _run_cycles(self) -> None:
        pace = _Pace(self._rate, self.clock.now_s())
        statistics = _Statistics(0.0, 0.0, self._rate)
        sequence = 0
        try:
            while not self._stopping:
                self._serve_until(pace.next_due(self.clock.now_s()), pace)
                now = self.clock.now_s()
                pace.begin_cycle(now)
                self._cycle(now)
                sequence += 1
                drives = self._controller.snapshots()
                is_resting = self._is_resting(now, drives)
                if sequence % self.STATISTICS_EVERY == 0:
                    statistics = pace.statistics() or statistics
                pace.set_stride(self._rest_stride if is_resting else 1)
                self._publish(LoopSnapshot(
                    sequence, now, drives, self._controller.estop, statistics.rate, statistics.jitter_p99, pace.missed,
                    self._port_lost, statistics.asked_rate, is_resting,
                ))  # fmt: skip
        except BaseException as error:  # noqa: BLE001  whatever it is, the tendons are let go and the node is told
            self.failure = error
        finally:
            self._leave()

    def _is_resting(self, now: float, drives: tuple[DriveSnapshot, ...]) -> bool:
        if self._rest_stride == 1:
            return False
        is_calm = not self._port_lost and not self._restores and self._controller.is_calm
        return self._rest.is_at_rest(now, drives, is_calm=is_calm)

    def _serve_until(self, due: float, pace: _Pace) -> None:
        """Serve requests until the next cycle is due; a request is served at once, also in the middle of the wait.

        Who asks for something ends a rest: the next cycle comes within a period. A flood of requests delays no cycle by
        more than `MAX_LATE_REQUESTS` of them.
        """
        assert self._wake is not None
        late = 0
        while late < self.MAX_LATE_REQUESTS:
            with self._changed:
                request = self._requests.popleft() if self._requests else None
            if request is not None:
                self._serve(*request)
                self._rest.disturb()
                now = self.clock.now_s()
                due = pace.resume(now)
                late += now >= due
            elif self._stopping or self.clock.now_s() >= due:
                return
            elif self.clock.wait_readable((self._wake,), due):
                os.eventfd_read(self._wake)

    def _wake_up(self) -> None:
        """End a wait of the thread; to be called with the lock."""
        if self._wake is not None:
            os.eventfd_write(self._wake, 1)

    @staticmethod
    def _serve(request: Callable[[], Any], future: Future[Any]) -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(request())
        except Exception as error:  # noqa: BLE001  it belongs to whoever asked
            future.set_exception(error)

    def _cycle(self, now: float) -> None:
        if self._port_lost and not self._reopened(now):
            self._controller.lose_port(self._port_lost)
            return
        try:
            readings = self._backend.read()
            self._act(self._controller.step(self.clock.now_s(), readings))
            self._void_marks(readings)
            self._restore_a_step(readings)
        except PortLostError as error:
            self._port_lost = str(error)
            self._reopen_at = now
            self._restores.clear()
            self._controller.lose_port(self._port_lost)

    def _void_marks(self, readings: Mapping[str, DriveReading]) -> None:
        """Take the mark away where a fault has voided the zero, so that no later start of the driver trusts it."""
        for tendon, drive in self._controller.drives.items():
            if drive.zero_lost and tendon in readings:
                drive.zero_lost = False
                try:
                    self._backend.mark_session(tendon, 0)
                except PortLostError:
                    raise
                except DriverError:
                    drive.zero_lost = True

    def _reopened(self, now: float) -> bool:
        if now < self._reopen_at:
            return False
        self._reopen_at = now + self.REOPEN_PERIOD
        if self._backend.reconnect():
            self._port_lost = ""
        return not self._port_lost

    def _enforce_block(self, controller: GripperController) -> str:
        actions = controller.enforce_block()
        try:
            deaf = self._act(actions)
        except PortLostError as error:
            return f"nothing could be switched off: {error}; it is as soon as the port is back"
        return f"no answer from {', '.join(deaf)}: switched off as soon as they answer" if deaf else ""

    def _act(self, actions: Mapping[str, DriveActions]) -> list[str]:
        """Do what the drives ask for; return those that could not be switched."""
        setpoints: dict[str, Setpoint] = {}
        deaf: list[str] = []
        for tendon, action in actions.items():
            if action.power is not None and not self._switched(tendon, on=action.power):
                deaf.append(tendon)
            if action.restore:
                self._restores.setdefault(tendon, self._backend.restore(tendon))
            if action.setpoint is not None:
                setpoints[tendon] = action.setpoint
        if setpoints:
            self._backend.write(setpoints)
        return deaf

    def _switched(self, tendon: str, *, on: bool) -> bool:
        try:
            self._backend.power(tendon, on)
        except PortLostError:
            raise
        except DriverError as error:
            # It does not answer: the loop notices that by itself and names it. Off is said again when it answers, on
            # only on request.
            self._controller.drives[tendon].set_fault("no_reply", str(error))
            return False
        return True

    def _power_all(self, controller: GripperController, *, on: bool) -> None:
        for drive in controller.drives.values():
            if on and drive.ready and not drive.powered and drive.tendon not in self._restores:
                self._act({drive.tendon: drive.switch_on()})
            elif not on:
                self._act({drive.tendon: drive.switch_off()})

    def _reset(self, controller: GripperController, *, power: bool) -> str:
        affected = [drive for drive in controller.drives.values() if FAULTS_OF_THE_DEVICE & {drive.fault}]
        controller.reset()
        for drive in affected:
            drive.begin_restore(power=power)
            self._restores[drive.tendon] = self._backend.restore(drive.tendon)
        if power:
            self._power_all(controller, on=True)
        names = ", ".join(drive.tendon for drive in affected)
        return f"reset; set up again, home afterwards: {names}" if names else "reset"

    def _restore_a_step(self, readings: Mapping[str, DriveReading]) -> None:
        for tendon, steps in list(self._restores.items()):
            drive = self._controller.drives[tendon]
            try:
                next(steps)
            except StopIteration:
                if tendon in readings:
                    del self._restores[tendon]
                    self._act({tendon: drive.restored(success=True)})
            except PortLostError:
                raise
            except DriverError as error:
                del self._restores[tendon]
                drive.restored(success=False)
                drive.set_fault("no_reply", str(error))

    def _publish(self, snapshot: LoopSnapshot) -> None:
        with self._changed:
            self._history.append(snapshot)
            self._changed.notify_all()

    def _leave(self) -> None:
        """Let go of every tendon, or leave it holding where the policy says so and nobody's hands are in the cell."""
        policies = self._controller.policies
        policy = policies.estop if self.failure is None else policies.unclean_end
        self.keeps_hold = policy is StopPolicy.HOLD and not self._controller.is_letting_go
        self.has_let_go = not self.keeps_hold and self._let_go()
        self._refuse_pending()

    def _let_go(self) -> bool:
        """Switch every drive off; return whether all of them confirmed it."""
        confirmed = True
        for tendon, drive in self._controller.drives.items():
            drive.switch_off()
            try:
                self._backend.power(tendon, False)
            except DriverError:
                confirmed = False
        return confirmed

    def _refuse_pending(self) -> None:
        with self._changed:
            self._ended = True
            if self._wake is not None:
                os.close(self._wake)
                self._wake = None
            pending = list(self._requests)
            self._requests.clear()
            self._changed.notify_all()
        for _, future in pending:
            if future.set_running_or_notify_cancel():
                future.set_exception(DriverError("the bus loop has ended"))
