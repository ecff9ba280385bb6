# SPDX-License-Identifier: Apache-2.0
"""The predictor without ROS: predictions, pairing with measurements, wear decisions."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.finger import FRICTIONLESS, FingerError, Kernel, Strip
from softgrip_model.finger.matching import Matcher, TendonSample
from softgrip_model.finger.predictor import ActiveFriction, Configuration, TendonReading, Validity, assumed_friction
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.finger.session import MeasuredFinger, Residual, Session
from softgrip_model.finger.wear import Cusum, Shift, Verdict, WearMonitor, WearSettings
from softgrip_model.friction.laws import FrictionLaw, Law
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
    correlation = np.eye(4)
    # n, epsilon and lambda, as fits have them: together they are known three times better than each alone
    correlation[1:, 1:] = [[1.0, 0.74, 0.80], [0.74, 1.0, 0.92], [0.80, 0.92, 1.0]]
    return ActiveFriction("rig-1", law, correlation * np.outer(stddev, stddev))


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


def test_only_the_last_two_seconds_are_kept() -> None:
    matcher: Matcher[str] = Matcher()
    for t in range(400):
        matcher.add_tendon(TendonSample(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    assert matcher.add_measured(1_005 * MILLISECOND, "late") == []
    ((sample, _),) = matcher.add_measured(2_005 * MILLISECOND, "in time")
    assert sample.pulled_length == pytest.approx(0.2005)


def test_a_source_that_starts_again_is_paired_again() -> None:
    """Simulated time that begins anew; a sample that is merely late changes nothing."""
    matcher: Matcher[str] = Matcher()
    for t in range(100, 120):
        matcher.add_tendon(TendonSample(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    assert matcher.add_tendon(TendonSample(1_100 * MILLISECOND, 9.0, 0.1, 2.0)) == []
    ((sample, _),) = matcher.add_measured(1_100 * MILLISECOND, "seen")
    assert sample.pulled_length == pytest.approx(0.11)
    for t in range(5):
        matcher.add_tendon(TendonSample(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    ((sample, _),) = matcher.add_measured(15 * MILLISECOND, "seen again")
    assert sample.pulled_length == pytest.approx(0.0015)


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
                self.at(pull, 0.01, tension, truth.angle_rad[0, k], tip)
            self.at(17.0, -0.05, 1.0, truth.angle_rad[0, -1], truth.tip_mm[0, -1])

    def at(self, pull: float, velocity: float, tension: float, angles: np.ndarray, tip: np.ndarray) -> None:
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
    assert last.verdict is Verdict.RECALIBRATE
    assert last.reason.startswith("friction +")
    assert last.cusum_friction > last.cusum_stiffness


def test_soft_strips_mean_a_worn_finger(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    closings.run(12, 1.0, 0.8)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.WORN
    assert re.match(r"friction [+-]\d %, stiffness -(1[5-9]|2\d) % .*strips have changed", last.reason)


def test_closings_on_an_object_do_not_count(closings: Closings) -> None:
    closings.run(6, 1.0, 1.0)
    before = closings.residuals[-1]
    closings.session.set_free(closings.stamp, free=False)
    closings.run(12, 1.5, 0.6)
    after = closings.residuals[-1]
    assert (after.cusum_friction, after.cusum_stiffness) == (before.cusum_friction, before.cusum_stiffness)


def test_what_the_cell_does_counts_from_its_stamp_on(closings: Closings) -> None:
    """cell/state comes by another way than the tendons' state: a grasp that begins later spoils no earlier closing."""
    closings.run(6, 1.0, 1.0)
    closings.session.set_free(closings.stamp + 10_000 * MILLISECOND, free=False)
    closings.run(6, 1.25, 1.0)
    assert closings.residuals[-1].verdict is Verdict.RECALIBRATE


def test_much_more_friction_means_a_worn_cable(closings: Closings) -> None:
    """To first order twice the friction also looks like strips a quarter stiffer; they have not changed."""
    closings.run(6, 1.0, 1.0)
    closings.run(6, 1.9, 1.0)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.WORN
    assert re.match(r"friction \+[89]\d %, stiffness [+-]\d % .*cable or channel is worn", last.reason)


def test_where_both_moved_both_are_told(closings: Closings) -> None:
    """The strips decide: measuring the friction anew would hide them in a new baseline."""
    closings.run(6, 1.0, 1.0)
    closings.run(6, 1.3, 0.8)
    last = closings.residuals[-1]
    assert last.verdict is Verdict.WORN
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


def one_closing(believed: FrictionLaw, true: FrictionLaw, stiffness_factor: float) -> Shift:
    """What a monitor makes of one closing of the power finger."""
    finger = chapter_4_finger("power")
    a, b, c = (stiffness_factor * modulus for modulus in finger.strip.modulus_mpa)
    made = dataclasses.replace(finger, strip=Strip((a, b, c)))
    monitor = WearMonitor(finger, believed, WearSettings())
    for pull in np.linspace(1.0, 18.0, 18):
        expected, seen = Kernel([finger], believed).solve([pull]), Kernel([made], true).solve([pull])
        monitor.add(expected, seen.tip_mm[0, 0], float(seen.tension_n[0, 0, 0]), pulling=True, free=True)
    monitor.add(expected, seen.tip_mm[0, 0], 0.0, pulling=False, free=True)
    assert monitor.shift is not None
    return monitor.shift


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


def test_a_frame_from_before_a_swap_says_nothing_about_the_finger_that_sits_there_now(
    profiles: dict[str, Profile],
) -> None:
    """It comes late, or waits for the tendon's next state: either way it is of the finger that was taken out."""
    session = Session(profiles, {"index": "pinch"}, WearSettings())
    (prediction,) = session.configuration.predict([TendonReading("index", 0.01)])
    seen = MeasuredFinger("index", tuple(prediction.joint_angles), prediction.tip, "pinch")
    session.on_tendons([TendonSample(5, 0.01, 0.0, prediction.tension)], ["index"])
    assert len(session.on_measured(5, [seen])) == 1
    assert not session.on_measured(8, [seen])
    session.set_mounted({"index": "power"})
    assert not session.on_tendons([TendonSample(10, 0.01, 0.0, prediction.tension)], ["index"])
    assert not session.on_measured(9, [seen])
    assert len(session.on_measured(9, [dataclasses.replace(seen, profile="power")])) == 1


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
