# SPDX-License-Identifier: Apache-2.0
"""The predictor without ROS: predictions, pairing with measurements, wear decisions."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.finger import FingerError, Kernel
from softgrip_model.finger.matching import Matcher, TendonSample
from softgrip_model.finger.predictor import ActiveFriction, Configuration, TendonReading, Validity, assumed_friction
from softgrip_model.finger.session import MeasuredFinger, Residual, Session
from softgrip_model.finger.wear import Verdict, WearSettings
from softgrip_model.profile import Profile, load_directory

PROFILES = Path(__file__).resolve().parents[2] / "softgrip_bringup" / "profiles"
MILLISECOND = 1_000_000


@pytest.fixture(scope="module")
def profiles() -> dict[str, Profile]:
    return load_directory(PROFILES)


@pytest.fixture
def friction(profiles: dict[str, Profile]) -> ActiveFriction:
    law = assumed_friction(profiles["power"]).law
    stddev = np.array([0.012, 0.07, 0.03, 0.02])
    return ActiveFriction("rig-1", law, np.diag(stddev**2))


def test_published_power_finger(profiles: dict[str, Profile]) -> None:
    """docs: chapter 4 index finger, |strain| tangent law, 20 mm (reference table, no stop)."""
    configuration = Configuration(profiles, {"index": "power"}, None)
    (prediction,) = configuration.predict([TendonReading("index", 0.020)])
    np.testing.assert_allclose(np.degrees(prediction.joint_angles), [83.728, 46.710, 45.102], atol=6e-4)
    assert prediction.tension == pytest.approx(14.4452, abs=6e-5)
    assert prediction.tensions[-1] == pytest.approx(5.3478, abs=6e-5)
    assert prediction.joint_angles_stddev is None
    assert all(math.isnan(value) for value in prediction.tip_stddev)


def test_prediction_depends_on_its_own_reading_alone(profiles: dict[str, Profile], friction: ActiveFriction) -> None:
    mounted = {"index": "power", "middle": "hook", "thumb": "pinch"}
    readings = [TendonReading("index", 0.02), TendonReading("middle", 0.011), TendonReading("thumb", 0.004)]
    together = Configuration(profiles, mounted, friction).predict(readings)
    other_order = Configuration(profiles, mounted, friction)
    other_order.predict([TendonReading("middle", 0.001)])
    for prediction, reading in zip(together, readings, strict=True):
        (alone,) = other_order.predict([reading])
        assert alone.joint_angles.tobytes() == prediction.joint_angles.tobytes()
        assert alone.tensions.tobytes() == prediction.tensions.tobytes()
        assert alone.tip == prediction.tip
        assert alone.tip_stddev == prediction.tip_stddev


def test_standard_deviation_is_that_of_drawn_coefficients(
    profiles: dict[str, Profile], friction: ActiveFriction
) -> None:
    """First-order spread against the sample spread of small coefficient draws."""
    assert friction.covariance is not None
    covariance = 1e-4 * friction.covariance
    small = dataclasses.replace(friction, covariance=covariance)
    configuration = Configuration(profiles, {"index": "hook"}, small)
    (prediction,) = configuration.predict([TendonReading("index", 0.015)])
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(small.law.coefficients, covariance, size=400)
    fingers = [configuration.fingers["index"]] * len(draws)
    solution = Kernel(fingers, [small.law.with_coefficients(c) for c in draws]).solve([15.0])
    spread = solution.angle_rad[:, 0].std(axis=0)
    assert prediction.joint_angles_stddev is not None
    np.testing.assert_allclose(prediction.joint_angles_stddev, spread, rtol=0.12)
    np.testing.assert_allclose(prediction.tip_stddev, 1e-3 * solution.tip_mm[:, 0].std(axis=0), rtol=0.12)


def test_straight_failed_and_opening_fingers_are_marked(profiles: dict[str, Profile]) -> None:
    configuration = Configuration(profiles, {"index": "power"}, None)

    def validity(pulled: float, velocity: float = 0.0) -> tuple[Validity, str]:
        (prediction,) = configuration.predict([TendonReading("index", pulled, velocity)])
        assert np.isnan(prediction.joint_angles).all() == (prediction.validity is Validity.FAILED)
        return prediction.validity, prediction.reason

    assert validity(0.0) == (Validity.OK, "")
    assert validity(math.nan)[0] is Validity.FAILED
    assert "closed grooves" in validity(0.2)[1]
    assert validity(0.008)[0] is Validity.OK
    assert "let out" in validity(0.008, -0.01)[1]
    assert validity(0.020)[0] is Validity.EXTRAPOLATED  # 14 N; calibrated to 9.81 N


def test_unmounted_tendons_are_left_out(profiles: dict[str, Profile]) -> None:
    configuration = Configuration(profiles, {"index": "power"}, None)
    assert configuration.predict([TendonReading("wrist", 0.01)]) == []
    with pytest.raises(FingerError, match="unknown profile 'gentle'; loaded: hook, pinch, power"):
        Configuration(profiles, {"index": "gentle"}, None)


def test_configuration_digest_tells_profiles_apart(profiles: dict[str, Profile]) -> None:
    digests = {Configuration(profiles, {"index": name}, None).digest for name in profiles}
    assert len(digests) == len(profiles)


def test_pairs_do_not_depend_on_arrival_order() -> None:
    samples = [TendonSample(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0 + t) for t in range(20)]
    measured = [(35 * MILLISECOND, "a"), (70 * MILLISECOND, "b"), (104 * MILLISECOND, "c")]

    def run(order: str) -> list[tuple[TendonSample, str]]:
        matcher: Matcher[str] = Matcher()
        pairs = []
        if order == "measured first":
            pairs += [pair for item in measured for pair in matcher.add_measured(*item)]
        pairs += [pair for sample in samples for pair in matcher.add_tendon(sample)]
        if order == "tendon first":
            pairs += [pair for item in measured for pair in matcher.add_measured(*item)]
        return pairs

    assert run("measured first") == run("tendon first")
    first, _ = run("tendon first")[0]
    assert first.pulled_length == pytest.approx(3.5e-3)
    assert first.tension == pytest.approx(5.5)


def test_no_pair_across_a_gap_of_the_tendon_stream() -> None:
    matcher: Matcher[str] = Matcher(largest_gap=50 * MILLISECOND)
    matcher.add_tendon(TendonSample(0, 0.0, 0.0, 0.0))
    matcher.add_tendon(TendonSample(400 * MILLISECOND, 0.0, 0.0, 0.0))
    assert matcher.add_measured(200 * MILLISECOND, "lost") == []


def test_velocity_that_nobody_gives_comes_from_the_lengths() -> None:
    matcher: Matcher[str] = Matcher()
    for t in range(3):
        matcher.add_tendon(TendonSample(t * 10 * MILLISECOND, 2e-4 * t, math.nan, 1.0))
    ((sample, _),) = matcher.add_measured(15 * MILLISECOND, "seen")
    assert sample.velocity == pytest.approx(0.02)


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
                self._instant(pull, 0.01, tension, truth.angle_rad[0, k], tip)
            self._instant(17.0, -0.05, 1.0, truth.angle_rad[0, -1], truth.tip_mm[0, -1])

    def _instant(self, pull: float, velocity: float, tension: float, angles: np.ndarray, tip: np.ndarray) -> None:
        self.stamp += 20 * MILLISECOND
        sample = TendonSample(self.stamp, 1e-3 * pull, velocity, tension)
        self.residuals += self.session.on_tendons([sample], ["index"])
        seen = MeasuredFinger("index", tuple(angles), (1e-3 * tip[0], 1e-3 * tip[1]))
        self.residuals += self.session.on_measured(self.stamp, [seen])


def power_closings(profiles: dict[str, Profile], seed: int) -> Closings:
    return Closings(Session(profiles, {"index": "power"}, WearSettings()), np.random.default_rng(seed))


@pytest.fixture
def closings(profiles: dict[str, Profile]) -> Closings:
    return power_closings(profiles, 7)


@pytest.mark.parametrize("seed", range(7, 12))
def test_nothing_moved_raises_no_alarm(profiles: dict[str, Profile], seed: int) -> None:
    """A baseline of few closings is uncertain; that is no shift."""
    closings = power_closings(profiles, seed)
    closings.run(40, 1.1, 0.9)  # a finger that differs from its model from the start is the baseline
    assert {residual.verdict for residual in closings.residuals} <= {Verdict.OK, Verdict.WATCH}


def test_slow_wear_is_not_taken_into_the_baseline(closings: Closings) -> None:
    closings.run(30, 1.0, 1.0)
    for closing in range(40):
        closings.run(1, 1.0 + 0.01 * closing, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.RECALIBRATE
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


def test_friction_shift_asks_for_calibration(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    closings.run(12, 1.25, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.RECALIBRATE
    assert last.reason.startswith("friction +")
    assert last.cusum_friction > last.cusum_stiffness


def test_soft_strips_mean_a_worn_finger(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    closings.run(12, 1.0, 0.8)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.WORN
    assert last.reason.startswith("stiffness -")


def test_closings_on_an_object_do_not_count(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    before = closings.residuals[-1]
    closings.session.set_free(closings.stamp, free=False)
    closings.run(12, 1.5, 0.6)
    after = closings.residuals[-1]
    assert (after.cusum_friction, after.cusum_stiffness) == (before.cusum_friction, before.cusum_stiffness)


def test_residual_of_a_perfect_measurement_is_zero(profiles: dict[str, Profile]) -> None:
    session = Session(profiles, {"index": "pinch"}, WearSettings())
    (prediction,) = session.configuration.predict([TendonReading("index", 0.01)])
    session.on_tendons([TendonSample(5, 0.01, 0.0, prediction.tension)], ["index"])
    seen = MeasuredFinger("index", tuple(prediction.joint_angles), prediction.tip)
    (residual,) = session.on_measured(5, [seen])
    assert residual.tip_error < 1e-12
    assert abs(residual.tension_error) < 1e-9
    assert max(map(abs, residual.joint_angle_errors)) < 1e-12
    shifted = dataclasses.replace(seen, tip=(prediction.tip[0] + 0.00095, prediction.tip[1]))
    (off,) = session.on_measured(5, [shifted])
    assert off.tip_error == pytest.approx(0.00095)
    assert off.tip_error_percent == pytest.approx(1.0)  # of 95 mm


def test_service_names_what_is_unknown(profiles: dict[str, Profile], friction: ActiveFriction) -> None:
    session = Session(profiles, {"index": "power"}, WearSettings())
    session.set_friction(friction)
    states = session.closing("hook", "", "", [0.005, 0.01])
    assert [(s.finger, s.pulled_length) for s in states] == [
        (slot, pull) for slot in ("index", "middle", "thumb") for pull in (0.005, 0.01)
    ]
    with pytest.raises(FingerError, match="known: rig-1, braid-tpu-chapter4"):
        session.closing("hook", "", "rig-0", [0.01])
    with pytest.raises(FingerError, match="unknown profile"):
        session.closing("fist", "", "", [0.01])


def test_bad_mounting_keeps_the_good_one(profiles: dict[str, Profile]) -> None:
    session = Session(profiles, {"index": "power"}, WearSettings())
    with pytest.raises(FingerError):
        session.set_mounted({"index": "nothing"})
    assert session.configuration.mounted == {"index": "power"}
