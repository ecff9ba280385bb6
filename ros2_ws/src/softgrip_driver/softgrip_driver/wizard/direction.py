# SPDX-License-Identifier: Apache-2.0
"""Which way a spool winds its tendon in: the way in which a small pull is held within a short way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from softgrip_description.cell_file import ChainServo, ServoChain
from softgrip_driver.errors import ConfigurationError, NoReplyError
from softgrip_driver.tendon.backend import DriveReading, Setpoint
from softgrip_driver.wizard.chain import model_of, spool_of
from softgrip_driver.wizard.drive_setup import SetupBackend

#: [m] that a goal may be ahead of a spool that is held
MAX_AHEAD_M = 0.003
#: a spool is held that is slower than this [m/s] for so long [s] while its goal is ahead
HELD_SPEED_M_S, HELD_FOR_S = 1e-3, 0.25
#: [m] beyond the way that was held in one direction, which must be free in the other
BEYOND_M = 0.003
#: a spool that turned less than this [m] may be held by its gears: it is pulled again, by so much more, up to so many
#: times what homing wants of the gears
STUCK_M, PULL_GROWTH, PULL_SHARE = 1e-3, 1.25, 1.3
_READ_TIMEOUT_S = 1.0


@dataclass(frozen=True)
class SpoolPull:
    """A small pull.

    Attributes:
        reach_m: [m] longest way.
        speed_m_s: [m/s] of the tendon.
        tension_n: [N] limit, above what turns the gears.
        back_tension_n: [N] limit on the way back to where it began; at least ``tension_n``.
    """

    reach_m: float = 0.02
    speed_m_s: float = 0.01
    tension_n: float = 2.0
    back_tension_n: float = 0.0

    def find_end(self, backend: SetupBackend) -> float | None:
        """Wind in from here; return the way [m] after which something held it, None where nothing did within reach.

        A spool that is not through its reach by the deadline counts as held.

        It is paid out again, and torque is off afterwards on every path.

        Raises:
            DriverError: of the servo.
        """
        (name,) = backend.tendons
        backend.power(name, True)
        try:
            start = read_drive(backend).position
            end = self._wind_in(backend, start)
            self._pay_out(backend, start)
        finally:
            backend.power(name, False)
        return None if end is None else end - start

    def _wind_in(self, backend: SetupBackend, start: float) -> float | None:
        (name,), clock = backend.tendons, backend.bus.clock
        goal, last = start, clock.now_s()
        held_since: float | None = None
        deadline = last + 3.0 * self.reach_m / self.speed_m_s + HELD_FOR_S
        while True:
            reading = read_drive(backend)
            now = clock.now_s()
            goal = min(
                goal + self.speed_m_s * (now - last), reading.position + MAX_AHEAD_M, start + self.reach_m + MAX_AHEAD_M
            )
            last = now
            if reading.position >= start + self.reach_m:
                return None
            is_held = abs(reading.velocity) < HELD_SPEED_M_S and goal - reading.position > 0.5 * MAX_AHEAD_M
            held_since = None if not is_held else now if held_since is None else held_since
            if (held_since is not None and now - held_since > HELD_FOR_S) or now > deadline:
                return reading.position
            backend.write({name: Setpoint(goal, self.tension_n)})

    def _pay_out(self, backend: SetupBackend, to: float) -> None:
        (name,), clock = backend.tendons, backend.bus.clock
        here = read_drive(backend).position
        began, deadline = clock.now_s(), clock.now_s() + 4.0 * abs(here - to) / self.speed_m_s + 2.0
        # A duty cycle that is limited for a light pull leaves the back-EMF of a geared motor little to turn with.
        limit_n = max(self.tension_n, self.back_tension_n)
        while read_drive(backend).position > to + HELD_SPEED_M_S * HELD_FOR_S and clock.now_s() < deadline:
            goal = max(to, here - self.speed_m_s * (clock.now_s() - began))
            backend.write({name: Setpoint(goal, limit_n)})


def read_drive(backend: SetupBackend) -> DriveReading:
    """Return a reading of the only drive of a backend; raises NoReplyError where none comes in a second."""
    (name,) = backend.tendons
    deadline = backend.bus.clock.now_s() + _READ_TIMEOUT_S
    while backend.bus.clock.now_s() < deadline:
        reading = backend.read().get(name)
        if reading is not None:
            return reading
    raise NoReplyError(
        f"tendon '{name}': expected a reading within {_READ_TIMEOUT_S:g} s, found none; check cable and supply"
    )


def measure_direction(
    chain: ServoChain,
    servo: ChainServo,
    make_backend: Callable[[ChainServo], SetupBackend],
    pull: SpoolPull | None = None,
) -> int:
    """Return the direction (1, -1) in which a servo winds its tendon in, found by small pulls both ways.

    Args:
        chain: of the servo.
        servo: whose direction is looked for; the one that it has is not believed.
        make_backend: a backend of this servo alone, not connected.
        pull: how it pulls; its tension is raised where it does not turn the gears of the servo's model.

    Raises:
        ConfigurationError: the tendon is held in neither direction, or in both.
        DriverError: of the servo.
    """
    pull = pull or SpoolPull()
    gears_n = model_of(chain, servo).needs.homing_torque / spool_of(servo).radius
    max_n = max(pull.tension_n, PULL_SHARE * gears_n)

    def find_end(direction: int, tension_n: float) -> float | None:
        backend = make_backend(replace(servo, direction=direction))
        try:
            with backend.bus.clock.stepping():
                backend.connect()
                return replace(pull, tension_n=tension_n, back_tension_n=max_n).find_end(backend)
        finally:
            backend.disconnect()

    try:
        return find_direction(lambda direction: _end_of_spool(find_end, direction, pull.tension_n, max_n), pull.reach_m)
    except ConfigurationError as error:
        raise ConfigurationError(f"{servo.tendon}: {error}") from error


def _end_of_spool(
    find_end: Callable[[int, float], float | None], direction: int, tension_n: float, max_n: float
) -> float | None:
    """Return where a spool is held that has begun to turn, by the smallest pull that turns it, ``max_n`` [N] at most.

    A pull that turns heavy gears in any case would wind a light finger in over the whole reach.
    """
    while True:
        end = find_end(direction, tension_n)
        if end is None or end > STUCK_M or tension_n >= max_n:
            return end
        tension_n = min(max_n, tension_n * PULL_GROWTH)


def reversed_spool_remedy(servo: ChainServo) -> str:
    """Return what to do about a tendon that is wound the other way round than the cell file says."""
    return (
        f"the tendon of '{servo.tendon}' is wound the other way round than the cell file says: wind it again, or take "
        "direction and slack_m of this servo out of the file and run `ros2 run softgrip_driver wizard`"
    )


def find_direction(find_end: Callable[[int], float | None], reach_m: float) -> int:
    """Return the direction in which a tendon is wound in.

    Args:
        find_end: wind in, taking a direction (1, -1) for the right one, and return the way [m] until it was held.
        reach_m: [m] that was tried.

    Raises:
        ConfigurationError: held in neither direction, or in both.
    """
    ends = {direction: find_end(direction) for direction in (1, -1)}
    held = {direction: end for direction, end in ends.items() if end is not None}
    if not held:
        raise ConfigurationError(
            f"expected a tendon that holds the spool within {reach_m * 1e3:g} mm of one direction, found none; "
            "tie it to spool and finger, take up its slack by hand, and let the finger be straight"
        )
    first = min(held, key=lambda direction: held[direction])
    if len(held) == 2 and held[-first] - held[first] < BEYOND_M:
        ways = " and ".join(f"{end * 1e3:.1f} mm" for end in held.values())
        raise ConfigurationError(
            f"expected a spool that is free in one direction, found it held after {ways}; is it jammed, or the tendon "
            "taut already? let out some tendon by hand"
        )
    return first
