# SPDX-License-Identifier: Apache-2.0
"""Fingers that something happens to: closed again and again, as a camera and the servo's current see it.

One has hinges (mode P), creeps by one term and can have a single contact changed exactly; the other is the emulated
cell's (beams, Prony's series, Mullins' effect, room in the holes, another friction), with the friction model that its
cell's rig measures.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from softgrip_emulator.camera.optics import draw_optics
from softgrip_emulator.plant.fingers import FingerBank, run_in
from softgrip_emulator.plant.truth import FingerTruth, draw_finger
from softgrip_model.finger import Finger, JointModel, Kernel
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import ClosingConditions
from softgrip_model.finger.parts import bends, groove, strip_moment
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.finger.uncertainty import SCALED_COEFFICIENTS
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.virtual_cell import calibrated

Array = NDArray[np.float64]

SETS = ("power", "hook", "pinch")
PULLS_MM = np.arange(1.0, 16.5, 1.0)
#: Share of the stress that creeps, and how fast [s] (docs/emulator.md: 10 % in 6 s).
CREEP, CREEP_S = 0.10, 6.0
#: Of a closing: pull [mm], tips [mm], tension; friction and stiffness beside the closing before.
SCATTER_MM, TIP_MM, TENSION, WANDER = 0.03, 0.3, 0.02, 0.01
#: [K] standard deviation of a thermometer's reading: what it is off by all the time does not count.
THERMOMETER_K = 0.5
#: Of the beams: step [s] while they move and while they rest, temperature that data sheets are for [degC], how much
#: softer TPU becomes [1/K] (softgrip_emulator/plant/material.py), and how fast they are opened [mm/s].
STEP_S, REST_STEP_S, ROOM_C, SOFTER_PER_K, OPENING_MM_PER_S = 2e-3, 2e-2, 23.0, 0.01, 20.0


@dataclass(frozen=True)
class Truth:
    """How a true finger differs from its profile, and how it is seen."""

    friction: float = 1.0
    stiffness: float = 1.0
    strips: tuple[float, ...] = (1.0, 1.0, 1.0)
    contact: tuple[int, float] = (0, 1.0)
    zero_mm: float = 0.0
    stretch_mm_per_n: float = 0.0
    camera_mm: tuple[float, float] = (0.0, 0.0)
    camera_scale: float = 1.0
    tilt_rad: float = 0.0
    gain: float = 1.0
    creep: float = CREEP
    speed_mm_per_s: float = 16.0
    rest_s: float = 12.0
    further_mm: float = 0.0
    thermometer: bool = False

    @property
    def room_c(self) -> float:
        """Of the room [degC]: who becomes softer without having gone further is warm."""
        return ROOM_C if self.further_mm else ROOM_C - math.log(self.stiffness) / SOFTER_PER_K


class ChangedFinger(Protocol):
    """A finger that is closed again and again."""

    believed: Finger
    law: FrictionLaw

    def close(self, truth: Truth) -> tuple[tuple[ClosingInstant, ...], ClosingConditions]:
        """Close once; return what is seen of it."""


def seen(
    rng: np.random.Generator, truth: Truth, tips_mm: Array, tensions_n: Array, predicted_n: Array
) -> tuple[tuple[ClosingInstant, ...], ClosingConditions]:
    """Return what camera and current show of tips and tensions at PULLS_MM, with their noise."""
    tips = tips_mm + TIP_MM * rng.standard_normal(tips_mm.shape)
    measured_n = tensions_n * (1.0 + TENSION * rng.standard_normal(len(tensions_n)))
    closing = tuple(
        ClosingInstant(0, float(p), tip, float(n), float(expected))
        for p, tip, n, expected in zip(PULLS_MM, tips, measured_n, predicted_n, strict=True)
    )
    temperature_c = truth.room_c + THERMOMETER_K * rng.standard_normal() if truth.thermometer else math.nan
    return closing, ClosingConditions(truth.speed_mm_per_s, truth.rest_s, temperature_c, truth.further_mm)


class View:
    """The emulated cell's camera, and the side that a finger which is turned leans to.

    Args:
        seed: of both.
    """

    def __init__(self, seed: int) -> None:
        self._optics = draw_optics(640, 480, seed)
        self._side = float(np.random.default_rng(seed).choice([-1.0, 1.0]))

    def seen(self, truth: Truth, tips_mm: Array) -> Array:
        """Return where a camera that may have moved sees tips (K, 2) [mm] of a finger that may be turned about x."""
        x, y = 1e-3 * tips_mm.T
        tilt_rad = self._side * truth.tilt_rad
        points = np.column_stack([x, y * math.cos(tilt_rad), y * math.sin(tilt_rad)])
        return 1e3 * self._optics.in_plane(points) * truth.camera_scale + truth.camera_mm


class HingedFinger:
    """A printed finger of a set whose joints are hinges."""

    def __init__(self, finger_set: str, seed: int) -> None:
        profile = load_directory(shipped_directory())[finger_set]
        self.believed, friction = Finger.from_profile(profile, "index"), assumed_friction(profile)
        self.law = friction.law
        self._rng, self._view = np.random.default_rng([seed, SETS.index(finger_set)]), View(seed)
        hinges = self.believed.with_joint_model(JointModel.HINGE)
        self._printed = hinges.with_design(
            np.array(hinges.thickness_mm) + 0.07 * self._rng.standard_normal(3),
            np.array(hinges.routing_mm) + 0.07 * self._rng.standard_normal(6),
        )
        self._own = self._rng.normal(1.0, 0.05, 2)
        self._predicted_n = Kernel([self.believed], self.law).solve(PULLS_MM).tension_n[0, :, 0]

    def close(self, truth: Truth) -> tuple[tuple[ClosingInstant, ...], ClosingConditions]:
        """Close once; return what is seen of it."""
        wander = 1.0 + WANDER * self._rng.standard_normal(2)
        tips, tensions = self.answer(truth, SCATTER_MM * self._rng.standard_normal(), *wander)
        return seen(self._rng, truth, tips, tensions, self._predicted_n)

    def answer(
        self, truth: Truth, shift_mm: float = 0.0, friction: float = 1.0, stiffness: float = 1.0
    ) -> tuple[Array, Array]:
        """Return tips [mm] and tensions [N] of a closing as it would be seen without noise."""
        t = PULLS_MM / truth.speed_mm_per_s
        loading = 1.0 - truth.creep * (1.0 - CREEP_S / t * (1.0 - np.exp(-t / CREEP_S)))
        unrecovered = 1.0 - 0.5 * truth.creep * math.exp(-truth.rest_s / CREEP_S)
        own = self._own * np.array([friction * truth.friction, stiffness * unrecovered])
        pulled = PULLS_MM + truth.zero_mm + shift_mm
        found = [self._solve(truth, pull, own[0], own[1] * share) for pull, share in zip(pulled, loading, strict=True)]
        tips = self._view.seen(truth, np.array([tip for tip, _ in found]))
        return tips, truth.gain * np.array([tension for _, tension in found])

    def _solve(self, truth: Truth, pull: float, friction: float, stiffness: float) -> tuple[Array, float]:
        """Return tip [mm] and actuator tension [N]."""
        strip = self._printed.strip
        moduli = tuple(stiffness * truth.stiffness * modulus for modulus in strip.modulus_mpa)
        finger = dataclasses.replace(
            self._printed,
            strip=dataclasses.replace(strip, modulus_mpa=moduli),
            strip_width_mm=tuple(self._printed.width_mm * np.array(truth.strips)),
        )
        scaled = np.array(SCALED_COEFFICIENTS[self.law.law])
        law = self.law.with_coefficients(np.array(self.law.coefficients) * (1.0 + (friction - 1.0) * scaled))
        tension = 0.0
        for _ in range(3 if truth.stretch_mm_per_n else 1):
            found = Kernel([finger], law).solve([pull - truth.stretch_mm_per_n * tension], threads=1)
            tension = float(found.tension_n[0, 0, 0])
        if truth.contact[1] != 1.0:
            return _one_contact(
                finger, law, pull, truth.contact, found.angle_rad[0, 0], float(found.tension_n[0, 0, -1])
            )
        return found.tip_mm[0, 0], tension


def _one_contact(
    finger: Finger, law: FrictionLaw, pull: float, contact: tuple[int, float], start: Array, tip_n: float
) -> tuple[Array, float]:
    """Return tip and tension with ln Rf of one contact multiplied; by SciPy from the parts of mode P."""
    place, factor = contact
    spans = [groove(finger.routing_mm[2 * j], finger.routing_mm[2 * j + 1], 0.0).span_mm for j in range(3)]

    def chain(x: Array) -> list[float]:
        size = np.sqrt(np.asarray(bends(finger, x[:3])) ** 2 + finger.smoothing_rad**2)
        log = [float(x[3])]
        for i in range(5, -1, -1):
            ratio = float(law.evaluate(size[i], math.exp(log[-1])).log_ratio)
            log.append(log[-1] + ratio * (factor if i == place else 1.0))
        return log[::-1]

    def residual(x: Array) -> list[float]:
        log, taken, rows = chain(x), 0.0, []
        for j in range(3):
            at = groove(finger.routing_mm[2 * j], finger.routing_mm[2 * j + 1], float(x[j]))
            taken += spans[j] - at.span_mm
            rows.append(strip_moment(finger, j, float(x[j]))[0] - math.exp(log[2 * j + 1]) * at.arm_mm)
        return [*rows, 10.0 * (taken - pull)]

    x = root(residual, [*start, math.log(tip_n)], tol=1e-10).x
    heading = np.cumsum(x[:3])
    tip = np.array([np.dot(finger.link_mm, np.cos(heading)), -np.dot(finger.link_mm, np.sin(heading))])
    return tip, math.exp(chain(x)[0])


class BeamFinger:
    """A finger of the emulated cell, run in before it is used, and never again without what it has been through."""

    def __init__(self, finger_set: str, seed: int) -> None:
        profile = load_directory(shipped_directory())[finger_set]
        self.believed, self.law = Finger.from_profile(profile, "index"), calibrated(seed).law
        self._rng, self._view = np.random.default_rng([seed, SETS.index(finger_set)]), View(seed)
        drawn = draw_finger(
            profile.finger("index"), profile.material, profile.cable, profile=finger_set, serial="1", seed=seed
        )
        self._printed = dataclasses.replace(drawn, slack_m=0.0)
        self._memory = run_in(self._printed)
        self._predicted_n = Kernel([self.believed], self.law).solve(PULLS_MM).tension_n[0, :, 0]
        self._bank = self._mounted(Truth())
        self._truth = Truth()

    def close(self, truth: Truth) -> tuple[tuple[ClosingInstant, ...], ClosingConditions]:
        """Close once; return what is seen of it."""
        if truth != self._truth:
            self._memory = self._bank.core.recall(0)
            self._bank, self._truth = self._mounted(truth), truth
        self._bank.warm(truth.room_c)
        self._rest(truth.rest_s)
        tips, tensions = self._pull(truth, truth.zero_mm + SCATTER_MM * self._rng.standard_normal())
        return seen(self._rng, truth, self._view.seen(truth, tips), truth.gain * tensions, self._predicted_n)

    def _mounted(self, truth: Truth) -> FingerBank:
        bank = FingerBank([_changed(self._printed, truth)])
        bank.core.restore(0, self._memory)
        return bank

    def _rest(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / REST_STEP_S))):
            self._bank.step(np.zeros(1), REST_STEP_S)

    def _pull(self, truth: Truth, shift_mm: float) -> tuple[Array, Array]:
        """Wind to the last of PULLS_MM and back; return tips [mm] and tensions [N] on the way in."""
        at_mm, tips, tensions = shift_mm, [], []
        for pull_mm in PULLS_MM + shift_mm:
            steps = max(1, round((pull_mm - at_mm) / (truth.speed_mm_per_s * STEP_S)))
            for wound_mm in np.linspace(at_mm, pull_mm, steps + 1)[1:]:
                self._bank.step(np.array([1e-3 * wound_mm]), STEP_S)
            at_mm = pull_mm
            tips.append(1e3 * self._bank.chain()[0][0, -1])
            tensions.append(float(self._bank.tension_n[0]))
        for wound_mm in np.linspace(at_mm, 0.0, round(at_mm / (OPENING_MM_PER_S * STEP_S)))[1:]:
            self._bank.step(np.array([1e-3 * wound_mm]), STEP_S)
        return np.array(tips), np.array(tensions)


def _changed(printed: FingerTruth, truth: Truth) -> FingerTruth:
    """Return the finger as it has become; heat and what the camera sees are no part of it."""
    rubbing = truth.friction * np.where(np.arange(2 * printed.joints) == truth.contact[0], truth.contact[1], 1.0)
    softened = truth.stiffness if truth.further_mm else 1.0
    stretch_m_per_n = 1e-3 * truth.stretch_mm_per_n
    length_m = printed.lead_length_m + float(printed.link_lengths_m.sum())
    return dataclasses.replace(
        printed,
        friction_pressure=printed.friction_pressure * rubbing,
        friction_adhesion=printed.friction_adhesion * rubbing,
        bending_n=printed.bending_n * truth.friction,
        bending_share=printed.bending_share * truth.friction,
        stiffness=printed.stiffness * np.array(truth.strips) * softened,
        relaxing_share=printed.relaxing_share * truth.creep / CREEP,
        cable_stiffness_n=1.0 / (1.0 / printed.cable_stiffness_n + stretch_m_per_n / length_m),
    )
