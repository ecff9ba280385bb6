# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: ARG002  verbs of a drive that has one tendon
"""A backend as somebody else would ship it: a winch on paper that pulls a spring. Nothing of softgrip knows it."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

from softgrip_driver.errors import ConfigurationError, PortLostError
from softgrip_driver.tendon.backend import Counters, DriveIdentity, DriveReading
from softgrip_time import WallClock

#: [N/m], [m], [m/s]
STIFFNESS, TAUT, SPEED = 2000.0, 0.001, 0.05


@dataclass
class Winch:
    """The device."""

    position: float = 0.0
    goal: float = 0.0
    limit: float = 0.0
    powered: bool = False
    mark: int = 0
    silent: bool = False
    plugged: bool = True
    time: float = 0.0

    @property
    def tension(self):
        return max(0.0, STIFFNESS * (self.position - TAUT))

    def live(self, now):
        step, self.time = SPEED * (now - self.time), now
        if self.powered:
            goal = min(self.goal, TAUT + self.limit / STIFFNESS)
            self.position += max(-step, min(step, goal - self.position))
        else:
            self.position = min(self.position, TAUT)


class PaperDrive:
    """The backend (TendonBackend)."""

    def __init__(self, tendon, port, winch, clock=None):
        self._tendon, self._port, self._winch, self._clock = tendon, port, winch, clock or WallClock()
        self._is_open = False
        self.counters = Counters()

    @property
    def tendons(self):
        return (self._tendon,)

    def connect(self, *, keep_torque=False):
        self._reach()
        self._is_open = True
        self._winch.powered = self._winch.powered and keep_torque
        return [DriveIdentity(self._tendon, "paper winch")]

    def is_powered(self, tendon):
        return self._winch.powered

    def goal_position(self, tendon):
        return self._winch.goal if self._winch.powered else float("nan")

    def disconnect(self, *, keep_torque=False):
        if self._is_open and not keep_torque:
            self._winch.powered = False
        self._is_open = False

    def reconnect(self):
        if not self._winch.plugged:
            return False
        self.counters.reopened += 1
        self._is_open = True
        return True

    def restore(self, tendon):
        yield
        self._winch.powered, self._winch.mark = False, 0

    def read(self):
        self._reach()
        self.counters.transactions += 1
        if self._winch.silent:
            self.counters.lost += 1
            return {}
        now, winch = self._clock.now_s(), self._winch
        winch.live(now)
        return {
            self._tendon: DriveReading(
                now, winch.position, 0.0, winch.tension, 0.1, winch.tension, powered=winch.powered,
                session_mark=winch.mark,
            )
        }  # fmt: skip

    def write(self, setpoints):
        self._reach()
        setpoint = setpoints.get(self._tendon)
        if setpoint is not None:
            self._winch.limit = setpoint.tension_limit
            if setpoint.position is not None:
                self._winch.goal = setpoint.position

    def power(self, tendon, on):
        self._winch.goal, self._winch.powered = self._winch.position, on

    def mark_session(self, tendon, mark):
        self._winch.mark = mark

    def _reach(self):
        if not self._winch.plugged:
            raise PortLostError(f"port {self._port}: expected a winch, found nothing; plug it in again")


def configure(request):
    """Entry point of `softgrip.drives`."""
    if len(request.tendons) != 1:
        raise ConfigurationError(f"parameter tendons: expected one with a paper winch, found {list(request.tendons)}")
    port = request.options.get("folder", "servos")
    return SimpleNamespace(backend=lambda _report, clock: PaperDrive(request.tendons[0], port, Winch(), clock))


class PaperDevice:
    """Entry point of `softgrip.drive_contracts`: what the contract suite does to the device, and asks of it."""

    tolerance, limits_tension, limit, tension_error = 5e-4, True, 6.0, 0.5
    name = "pull"

    def __init__(self, tmp_path, world):
        self.world, self.winch = world, Winch()
        self.backend = PaperDrive(self.name, tmp_path / "servos", self.winch, world.clock)

    def tension(self):
        return self.winch.tension

    def pulls(self):
        return self.winch.powered

    def fall_silent(self):
        self.winch.silent = True

    def unplug(self):
        self.winch.plugged = False

    def recover(self):
        self.winch.silent, self.winch.plugged = False, True

    def close(self):
        pass
