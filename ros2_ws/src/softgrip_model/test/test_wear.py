# SPDX-License-Identifier: Apache-2.0
"""What the predictor concludes from closings that go otherwise than predicted: wear, and of what."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from softgrip_model.finger import FRICTIONLESS, Kernel, Strip
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.matching import TendonInput
from softgrip_model.finger.predictor import TendonReading
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.finger.session import MeasuredFinger, Residual, Session
from softgrip_model.finger.wear import Cusum, WearMonitor, WearSettings, WearShift, WearVerdict
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.profile import Profile

MILLISECOND = 1_000_000


class Closings:
    """Empty closings of a finger whose friction and stiffness differ from what the session believes."""

    def __init__(self, session: Session, rng: np.random.Generator) -> None:
        self.session, self.rng, self.stamp = session, rng, 0
        self.residuals: list[Residual] = []

    def run(self, count: int, friction_factor: float, stiffness_factor: float, off: float = 0.0) -> None:
        finger = self.session.configuration.fingers["index"]
        law = self.session.configuration.friction_of("index").law
        a, n, e, lam = law.coefficients
        other = law.with_coefficients([friction_factor * a, n, friction_factor * e, friction_factor * lam])
        quadratic, linear, constant = (stiffness_factor * m for m in finger.strip.modulus_mpa)
        true = dataclasses.replace(
            finger, strip=dataclasses.replace(finger.strip, modulus_mpa=(quadratic, linear, constant))
        )
        pulls = np.linspace(0.5, 18.0, 36) * (1.0 + off)
        truth = Kernel([true], other).solve(pulls)
        assert not truth.failed.any()
        for _ in range(count):
            for k, pull in enumerate(pulls):
                tension = truth.actuator_tension_n[0, k] * (1 + 0.05 * self.rng.standard_normal())
                tip = truth.tip_mm[0, k] + self.rng.standard_normal(2)
                self.at(pull, 0.01, tension, truth.angle_rad[0, k], tip)
            self.at(17.0, -0.05, 1.0, truth.angle_rad[0, -1], truth.tip_mm[0, -1])

    def at(self, pull: float, velocity: float, tension: float, angles: np.ndarray, tip: np.ndarray) -> None:
        self.stamp += 20 * MILLISECOND
        sample = TendonInput(self.stamp, 1e-3 * pull, velocity, tension)
        self.residuals += self.session.on_tendons([sample], ["index"])
        seen = MeasuredFinger("index", tuple(angles), (1e-3 * tip[0], 1e-3 * tip[1]))
        self.residuals += self.session.on_measured(self.stamp, [seen])


def power_closings(profiles: dict[str, Profile], seed: int) -> Closings:
    return Closings(
        Session(profiles, {"index": "power"}, WearSettings(), uncertainty=None, watch=None), np.random.default_rng(seed)
    )


@pytest.fixture
def closings(profiles: dict[str, Profile]) -> Closings:
    return power_closings(profiles, 7)


@pytest.mark.parametrize("seed", range(7, 12))
def test_nothing_moved_raises_no_alarm(profiles: dict[str, Profile], seed: int) -> None:
    """A baseline of few closings is uncertain; that is no shift."""
    closings = power_closings(profiles, seed)
    closings.run(40, 1.1, 0.9)  # a finger that differs from its model from the start is the baseline
    assert {residual.verdict for residual in closings.residuals} <= {WearVerdict.OK, WearVerdict.WATCH}


def test_slow_wear_is_not_taken_into_the_baseline(closings: Closings) -> None:
    closings.run(30, 1.0, 1.0)
    for closing in range(40):
        closings.run(1, 1.0 + 0.01 * closing, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is WearVerdict.RECALIBRATE
    assert last.cusum_friction > last.cusum_stiffness


def test_a_length_that_is_off_by_rounding_counts_all_the_same(profiles: dict[str, Profile]) -> None:
    """Samples a spacing apart: which of them count may not hang on the last bit of a pulled length."""
    said = []
    for off in (-1e-15, 0.0, 1e-15):
        closings = power_closings(profiles, 7)
        closings.run(8, 1.0, 1.0, off)
        said.append([residual.cusum_friction for residual in closings.residuals])
    assert said[0] == pytest.approx(said[1], abs=1e-6)
    assert said[2] == pytest.approx(said[1], abs=1e-6)


def test_decision_statistic_by_hand() -> None:
    """Hawkins 1987 with k = 1/2: every closing against the calm ones before it, by the deviation of that comparison."""
    cusum = Cusum(WearSettings(baseline=5, allowance=0.5, limit=5.0, largest_score=4.0, settled=6))
    for value in (0.0, 0.02, -0.01, 0.01, -0.02):
        cusum.add(value, 0.01)
    assert (cusum.ready, cusum.statistic) == (True, 0.0)
    spread = math.sqrt(10e-4 / 4)  # of these five, above the 0.01 of one closing's own noise
    score = 0.06 / (spread * math.sqrt(1 + 1 / 5))
    cusum.add(0.06, 0.01)
    assert cusum.statistic == pytest.approx(score - 0.5)
    assert cusum.statistic > 5.0 / 2  # not calm: no part of the baseline
    cusum.add(-1.0, 0.01)  # one odd closing counts as four deviations
    assert (cusum.up, cusum.down) == (0.0, pytest.approx(4.0 - 0.5))
    cusum.add(0.0, 0.01)
    cusum.add(0.0, 0.01)
    assert cusum.down == pytest.approx(4.0 - 3 * 0.5)
    cusum.add(0.06, 0.1)  # the last zero was calm and taken in; with it the baseline has settled
    assert cusum.up == pytest.approx(0.06 / (0.1 * math.sqrt(1 + 1 / 6)) - 0.5)
    assert cusum.statistic < 5.0 / 2
    assert cusum.values == [0.0, 0.02, -0.01, 0.01, -0.02, 0.0]


def test_friction_shift_asks_for_calibration(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    closings.run(12, 1.25, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is WearVerdict.RECALIBRATE
    assert last.reason.startswith("friction +")
    assert last.cusum_friction > last.cusum_stiffness


def test_soft_strips_mean_a_worn_finger(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    closings.run(12, 1.0, 0.8)
    last = closings.residuals[-1]
    assert last.verdict is WearVerdict.WORN
    assert re.match(r"friction [+-]\d %, stiffness -(1[5-9]|2\d) % .*strips have changed", last.reason)


def test_closings_on_an_object_do_not_count(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    before = closings.residuals[-1]
    closings.session.set_free(False)
    closings.run(12, 1.5, 0.6)
    after = closings.residuals[-1]
    assert (after.cusum_friction, after.cusum_stiffness) == (before.cusum_friction, before.cusum_stiffness)


def test_a_grasp_that_is_heard_of_spoils_no_earlier_closing(closings: Closings) -> None:
    """A frame comes later than the tendon samples about it; it is judged by what was so at its time."""
    closings.run(6, 1.0, 1.0)
    closings.run(6, 1.25, 1.0)
    closings.session.set_free(False)
    closings.run(6, 1.0, 0.5)
    assert closings.residuals[-1].verdict is WearVerdict.RECALIBRATE


def test_much_more_friction_means_a_worn_cable(closings: Closings) -> None:
    """To first order twice the friction also looks like strips a quarter stiffer; they have not changed."""
    closings.run(6, 1.0, 1.0)
    closings.run(6, 1.9, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is WearVerdict.WORN
    assert re.match(r"friction \+[89]\d %, stiffness [+-]\d % .*cable or channel is worn", last.reason)


def test_where_both_moved_both_are_told(closings: Closings) -> None:
    """The strips decide: measuring the friction again would hide them in a new baseline."""
    closings.run(6, 1.0, 1.0)
    closings.run(6, 1.3, 0.8)
    last = closings.residuals[-1]
    assert last.verdict is WearVerdict.WORN
    assert re.match(r"friction \+[23]\d %, stiffness -[12]\d % .*strips have changed", last.reason)


def test_a_moment_at_one_length_is_no_closing(closings: Closings, profiles: dict[str, Profile]) -> None:
    """Samples count a spacing apart, and a closing has eight of them at least."""
    closings.run(6, 1.0, 1.0)
    before = closings.residuals[-1].cusum_stiffness
    (prediction,) = closings.session.configuration.predict([TendonReading("index", 0.009)])
    tip = 1e3 * np.array(prediction.tip)
    for _ in range(5):
        for _ in range(100):
            closings.at(9.0, 0.01, 3.0 * prediction.tension, prediction.joint_angles, tip)
        closings.at(8.0, -0.05, prediction.tension, prediction.joint_angles, tip)
    assert closings.residuals[-1].cusum_stiffness == before


@pytest.mark.parametrize(("friction", "stiffness"), [(0.0, -0.4), (0.9, 0.0), (-0.5, 0.3), (0.3, -0.2)])
@pytest.mark.parametrize("law", [Law.CAPSTAN, Law.HEAP, Law.MATTE])
def test_one_closing_tells_friction_from_stiffness(law: Law, friction: float, stiffness: float) -> None:
    """Least squares on samples without noise: a factor on ln Rf and one on the moduli come back as they were put in."""
    coefficients = {Law.CAPSTAN: (0.3,), Law.HEAP: (0.3, 0.8), Law.MATTE: (0.27, 0.82, 0.065, 0.0085)}[law]
    scaled = {Law.CAPSTAN: (1,), Law.HEAP: (1, 0), Law.MATTE: (1, 0, 1, 1)}[law]
    believed = FrictionLaw(law, coefficients, 3.125)
    true = believed.with_coefficients([c * (1.0 + friction * s) for c, s in zip(coefficients, scaled, strict=True)])
    shift = one_closing(believed, true, 1.0 + stiffness)
    assert shift.friction == pytest.approx(friction, abs=1e-6)
    assert shift.stiffness == pytest.approx(stiffness, abs=1e-6)


def test_a_cable_that_slides_freely_has_a_stiffness_all_the_same() -> None:
    shift = one_closing(FRICTIONLESS, FRICTIONLESS, 0.97)
    assert math.isnan(shift.friction)
    assert shift.stiffness == pytest.approx(-0.03, abs=1e-6)


def one_closing(believed: FrictionLaw, true: FrictionLaw, stiffness_factor: float) -> WearShift:
    """What a monitor makes of one closing of the power finger."""
    finger = chapter_4_finger("power")
    a, b, c = (stiffness_factor * modulus for modulus in finger.strip.modulus_mpa)
    made = dataclasses.replace(finger, strip=Strip((a, b, c)))
    monitor = WearMonitor(finger, believed, WearSettings())
    for pull in np.linspace(1.0, 18.0, 18):
        expected, seen = Kernel([finger], believed).solve([pull]), Kernel([made], true).solve([pull])
        found, tension = float(expected.tension_n[0, 0, 0]), float(seen.tension_n[0, 0, 0])
        sample = ClosingInstant(0, pull, seen.tip_mm[0, 0], tension, found)
        monitor.add(sample, pulling=True, free=True)
    monitor.add(sample, pulling=False, free=True)
    assert monitor.shift is not None
    return monitor.shift
