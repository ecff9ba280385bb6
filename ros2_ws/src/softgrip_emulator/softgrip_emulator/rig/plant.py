# SPDX-License-Identifier: Apache-2.0
"""The rig's physics: a stage pulls an elastic cable over a surface; a weight hangs on the other end.

The gauge's end of the cable stretches until the friction breaks, then slips and catches again (a saw-tooth). Between
two such events the force is linear in travel, so the plant steps from event to event and is exact for any time step.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from softgrip_emulator.rig.truth import RigTruth

_GRAVITY_M_S2: Final = 9.81
#: Below it the cable does not touch the surface: it runs over the guide pulley alone.
_OFF_THE_SURFACE: Final = float(np.radians(1.0))
#: Wave lengths of the printed surface's waves [m], the longest about a layer stack.
_WAVE_LENGTHS: Final = (3.1e-3, 1.3e-3, 0.7e-3)


@dataclass(frozen=True)
class Setting:
    """What really hangs and how the cable really lies, once set.

    Attributes:
        angle: true wrap angle [rad]. tension: of the weight [N].
        pull_force: mean force at the gauge while pulling [N]. release_force: while letting back [N].
    """

    angle: float
    tension: float
    pull_force: float
    release_force: float


class RigPlant:
    """Stage, cable, surface and weight.

    All calls hold `lock`; times are cell time [s] and never run backwards.

    Args:
        truth: what is so.
        seed: of the scatter.
    """

    def __init__(self, truth: RigTruth, seed: int) -> None:
        self.truth = truth
        self.lock = threading.RLock()
        self._rng = np.random.default_rng([seed, 0x504C])
        # Apart from the slips, whose number depends on when a pull ends: each point of a seed is laid the same way.
        self._hand = np.random.default_rng([seed, 0x4841])
        self._phases = self._rng.uniform(0.0, 2.0 * np.pi, len(_WAVE_LENGTHS))
        self._now_s = 0.0
        self._velocity = 0.0
        self._target = 0.0
        self._jammed = False
        self.travel = 0.0
        self.force = 0.0
        self.setting = Setting(0.0, 0.0, 0.0, 0.0)
        self._threshold = self._next_threshold(pulling=True)

    # -- what a hand does ------------------------------------------------------------------------------------------

    def set(self, angle: float, load_kg: float) -> None:
        """Set the angle [rad] and hang a mass [kg] on the free end, with a hand's precision."""
        with self.lock:
            truth = self.truth
            on_surface = angle > _OFF_THE_SURFACE
            true_angle = max(angle + self._hand.normal(0.0, truth.angle_stddev), 0.0) if on_surface else 0.0
            tension = load_kg * _GRAVITY_M_S2 * float(1.0 + self._hand.normal(0.0, truth.load_stddev))
            if tension <= 0.0:
                self.setting = Setting(true_angle, 0.0, 0.0, 0.0)
                self.force = 0.0
                return
            scatter = float(np.exp(self._hand.normal(0.0, truth.repeatability))) if on_surface else 1.0
            ratio = max(float(truth.friction.ratio(true_angle, tension)) * scatter, 1.0) if on_surface else 1.0
            behind = truth.friction.tension_low(true_angle, tension / scatter) if on_surface else tension
            self.setting = Setting(
                true_angle, tension, tension * ratio * truth.pulley_ratio, behind / truth.pulley_ratio
            )
            # The hand lets the weight sink: the cable slid towards the weight last, so the gauge feels the low side.
            self.force = self.setting.release_force
            self._threshold = self._next_threshold(pulling=True)

    # -- what the stage does ---------------------------------------------------------------------------------------

    def move(self, target: float, velocity: float) -> None:
        """Run to a travel [m] at a speed [m/s, positive], pulling when the target lies ahead."""
        with self.lock:
            pulling = target > self.travel
            turned = (self._velocity < 0.0) == pulling
            self._target = target
            self._velocity = abs(velocity) if pulling else -abs(velocity)
            if turned:
                self._threshold = self._next_threshold(pulling=pulling)

    def stop(self) -> None:
        """Stand still."""
        with self.lock:
            self._velocity = 0.0

    def jam(self, jammed: bool) -> None:
        """Block the stage mechanically, or free it."""
        with self.lock:
            self._jammed = jammed

    @property
    def velocity(self) -> float:
        """Of the stage [m/s]."""
        return self._velocity

    def advance(self, now_s: float) -> None:
        """Live until a time [s]."""
        with self.lock:
            elapsed = max(now_s - self._now_s, 0.0)
            self._now_s = max(now_s, self._now_s)
            if self._velocity == 0.0 or self._jammed:
                return
            way = self._velocity * elapsed
            left = self._target - self.travel
            if abs(way) >= abs(left):
                way = left
                self._velocity = 0.0
            self._slide(way)

    def _slide(self, way: float) -> None:
        stiffness = self.truth.cable_stiffness
        pulling = way > 0.0
        while way != 0.0:
            to_break = (self._threshold - self.force) / stiffness
            if abs(to_break) >= abs(way) and (to_break > 0.0) == pulling:
                self.travel += way
                self.force += stiffness * way
                return
            step = to_break if (to_break > 0.0) == pulling else 0.0
            self.travel += step
            way -= step
            self.force = self._caught(pulling=pulling)
            self._threshold = self._next_threshold(pulling=pulling)
            if abs(self._threshold - self.force) < 1e-9:
                # No weight, no friction: the cable follows the stage without force.
                self.travel += way
                return

    def _mean(self, *, pulling: bool) -> float:
        base = self.setting.pull_force if pulling else self.setting.release_force
        waves = np.sin(2.0 * np.pi * self.travel / np.array(_WAVE_LENGTHS) + self._phases).mean()
        return base * (1.0 + self.truth.waviness * float(waves))

    def _next_threshold(self, *, pulling: bool) -> float:
        share = self.truth.stick_slip * self._rng.uniform(0.7, 1.3)
        return self._mean(pulling=pulling) * (1.0 + share if pulling else 1.0 - share)

    def _caught(self, *, pulling: bool) -> float:
        share = self.truth.stick_slip * self._rng.uniform(0.7, 1.3)
        return self._mean(pulling=pulling) * (1.0 - share if pulling else 1.0 + share)
