# SPDX-License-Identifier: Apache-2.0
"""Wind, hold, release: beds knots and turns until the zero stays where it is, and ends with a slack that is stated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from softgrip_driver.errors import DriverError, NoReplyError
from softgrip_driver.tendon.backend import Setpoint
from softgrip_driver.tendon.gripper import GripperController, MoveMode, MoveRequest, Ticket
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.wizard.drive_setup import SetupBackend

#: a zero that moves less between two rounds [m] has settled
SETTLED_M = 2e-4
#: [s] for a spool to come to rest, and beyond that for one that turns slowly; [m] from its goal where it has come there
SETTLING_S, SLOWEST_S, THERE_M = 0.5, 10.0, 5e-4


class TensioningError(DriverError):
    """A tendon could not be tensioned."""


@dataclass(frozen=True)
class TensioningPlan:
    """What is done.

    Attributes:
        tension_n: [N] that each tendon is held at. hold_s: [s] for how long.
        rounds: at most; it ends earlier once every zero has settled.
        speed_m_s: [m/s] of the tendons.
    """

    tension_n: float = 5.0
    hold_s: float = 1.0
    rounds: int = 4
    speed_m_s: float = 0.02


@dataclass(frozen=True)
class SettledZero:
    """Where the tendon of the straight finger is just taut.

    Attributes:
        zero_m: [m] in the device's frame.
        shift_m: [m] by which the last round moved it.
        rounds: that it took.
    """

    zero_m: float
    shift_m: float
    rounds: int

    @property
    def has_settled(self) -> bool:
        """Whether the last round left it where it was."""
        return abs(self.shift_m) < SETTLED_M


class Tensioner:
    """Homes, pulls, homes again.

    Args:
        loop: over a connected backend, not running.
        controller: of the loop.
        plan: what to do.
        report: told what was found, in words.
    """

    def __init__(
        self,
        loop: BusLoop,
        controller: GripperController,
        plan: TensioningPlan,
        report: Callable[[str], object] = lambda _: None,
    ) -> None:
        self._loop, self._controller, self._plan, self._report = loop, controller, plan, report

    def settle(self) -> Mapping[str, SettledZero]:
        """Return the zero of each tendon once it stays; torque is off afterwards on every path.

        Raises:
            TensioningError: a tendon that does not home or hold; says which and why.
        """
        self._loop.start()
        try:
            if self._loop.wait_for(lambda seen: all(drive.time > 0.0 for drive in seen.drives), 5.0) is None:
                raise TensioningError("expected readings of every servo within 5 s, found none; check cable and supply")
            self._loop.power(on=True)
            return self._rounds()
        finally:
            self._loop.stop()

    def _rounds(self) -> Mapping[str, SettledZero]:
        before = self._home()
        for number in range(1, self._plan.rounds + 1):
            self._hold()
            zeros = self._home()
            found = {name: SettledZero(zeros[name], zeros[name] - before[name], number) for name in zeros}
            shifts = ", ".join(f"{name} {one.shift_m * 1e3:+.2f} mm" for name, one in found.items())
            self._report(f"round {number}: held at {self._plan.tension_n:g} N, zero moved by {shifts}")
            if all(one.has_settled for one in found.values()):
                break
            before = zeros
        return found

    def _home(self) -> dict[str, float]:
        self._run(lambda controller, now: controller.home(now), "homing", 60.0)
        zeros = self._loop.call(lambda controller, _: {name: one.zero for name, one in controller.drives.items()})
        return {name: zero for name, zero in zeros.items() if zero is not None}

    def _hold(self) -> None:
        plan = self._plan
        pull = MoveRequest((), MoveMode.TENSION, (plan.tension_n,), plan.speed_m_s)
        self._run(lambda controller, now: controller.move(pull, now), f"holding {plan.tension_n:g} N", 30.0)
        until = self._loop.clock.now_s() + plan.hold_s
        self._loop.wait_for(lambda seen: seen.time >= until, plan.hold_s + 5.0)
        back = MoveRequest((), MoveMode.LENGTH, (0.0,), plan.speed_m_s, plan.tension_n)
        self._run(lambda controller, now: controller.move(back, now), "releasing", 30.0)

    def _run(self, request: Callable[[GripperController, float], Ticket], what: str, timeout_s: float) -> None:
        ticket = self._loop.call(request)
        seen = self._loop.wait_for(lambda one: ticket.result(one.drives)[0] is not None, timeout_s)
        if seen is None:
            raise TensioningError(f"{what}: expected an end within {timeout_s:g} s, found none; check supply and cable")
        outcome, reason = ticket.result(seen.drives)
        if outcome is not MoveOutcome.REACHED:
            raise TensioningError(f"{what}: {reason}")


def release(backend: SetupBackend, goals: Mapping[str, float], plan: TensioningPlan) -> dict[str, float]:
    """Pay tendons out to positions [m, device frame] and return where they came to rest, torque off on every path.

    Raises:
        DriverError: of a servo.
    """
    clock = backend.bus.clock
    here = _read_all(backend)
    way_m = max(here[name] - goal for name, goal in goals.items())
    began, duration_s = clock.now_s(), max(0.0, way_m) / plan.speed_m_s + SETTLING_S
    try:
        for name in goals:
            backend.power(name, on=True)
        is_there = False
        # Heavy gears turn slower than asked for by a pull that is limited.
        while (now := clock.now_s()) < began + duration_s or (not is_there and now < began + duration_s + SLOWEST_S):
            paid_m = plan.speed_m_s * (now - began)
            backend.write(
                {name: Setpoint(max(goal, here[name] - paid_m), plan.tension_n) for name, goal in goals.items()}
            )
            readings = backend.read()
            is_there = all(
                name in readings and readings[name].position < goal + THERE_M for name, goal in goals.items()
            )
    finally:
        for name in goals:
            backend.power(name, on=False)
    return _read_all(backend)


def _read_all(backend: SetupBackend) -> dict[str, float]:
    deadline = backend.bus.clock.now_s() + 1.0
    while backend.bus.clock.now_s() < deadline:
        readings = backend.read()
        if len(readings) == len(backend.tendons):
            return {name: reading.position for name, reading in readings.items()}
    raise NoReplyError("expected readings of every servo within 1 s, found some missing; check cable and supply")
