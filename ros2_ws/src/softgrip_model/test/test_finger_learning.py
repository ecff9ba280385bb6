# SPDX-License-Identifier: Apache-2.0
"""What predictions do not know, and what closings teach: slopes, intervals, bounds, and independence of arrival."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from softgrip_model.finger import Finger
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.kernel import Kernel
from softgrip_model.finger.learning import ChangedFinger, Expectation, FingerLearner, Knowledge, measured
from softgrip_model.finger.matching import SPAN_NS, TendonInput
from softgrip_model.finger.predictor import ActiveFriction, assumed_friction
from softgrip_model.finger.session import MeasuredFinger, Session
from softgrip_model.finger.uncertainty import MAX_DEVIATION, PRIOR, Causes, Uncertainty
from softgrip_model.finger.wear import WearSettings
from softgrip_model.profile import Profile

MILLISECOND = 1_000_000
PULLS = np.arange(1.0, 16.5, 1.0)


@pytest.fixture
def causes(profiles: dict[str, Profile]) -> Causes:
    finger, law = Finger.from_profile(profiles["hook"], "index"), assumed_friction(profiles["hook"]).law
    return Causes(finger, law, np.diag([0.012, 0.03, 0.02, 0.01]) ** 2, Uncertainty(tip_noise_mm=0.3))


def drawn(causes: Causes, seed: int) -> np.ndarray:
    z = np.clip(np.random.default_rng(seed).normal(size=len(causes.names)), -2.0, 2.0)
    z[causes.stretch] = abs(z[causes.stretch])  # no cable gets shorter when it is pulled
    return z


def closing(causes: Causes, z: np.ndarray, rng: np.random.Generator, pulls: np.ndarray = PULLS) -> list[ClosingInstant]:
    """A closing of the finger with deviations z, scattered as the prior says."""
    plain = ChangedFinger(causes, 0.0 * z).at(pulls)
    assert plain is not None
    predicted = plain[2].value[:, 0]
    empty = [ClosingInstant(0, p, np.zeros(2), 0.0, t) for p, t in zip(pulls, predicted, strict=True)]
    expected = Expectation.of(causes, z, empty)
    assert expected is not None
    seen = rng.multivariate_normal(expected.value, expected.noise)
    count = len(pulls)
    return [
        dataclasses.replace(one, tip_mm=seen[2 * i : 2 * i + 2], tension_n=float(seen[2 * count + i]))
        for i, one in enumerate(empty)
    ]


def test_slopes_are_exact(causes: Causes) -> None:
    """Every deviation against differences; at deviations off the kinks of |phi| and of the friction's clamp."""
    z, step = 0.3 * drawn(causes, 4), 1e-3
    samples = closing(causes, z, np.random.default_rng(1), np.array([3.0, 9.0]))

    def value(at: np.ndarray) -> np.ndarray:
        found = Expectation.of(causes, at, samples)
        assert found is not None
        return found.value

    exact = Expectation.of(causes, z, samples)
    assert exact is not None
    for i, name in enumerate(causes.names):
        shift = step * np.eye(len(z))[i]
        differences = (value(z + shift) - value(z - shift)) / (2.0 * step)
        np.testing.assert_allclose(exact.slope[:, i], differences, atol=2e-4, rtol=2e-3, err_msg=name)


@pytest.mark.parametrize("finger_set", ["pinch", "power"])
def test_a_cable_stretches_by_the_tension_that_is_left(profiles: dict[str, Profile], finger_set: str) -> None:
    """Where grooves close and tensions shoot up, and where an inextensible cable could not be pulled any further.

    The expected values are those of a finger without stretch at shorter pulls, whose tension says what is pulled.
    """
    finger = Finger.from_profile(profiles[finger_set], "index")
    causes = Causes(finger, assumed_friction(profiles[finger_set]).law, None, Uncertainty())
    z = np.zeros(len(causes.names))
    z[causes.stretch] = 2.0
    taken = np.array([2.0, 8.0, 14.0, 17.0, 19.0, 20.0])
    plain = Kernel([finger], causes.law).solve(taken, march=False)
    pulled = taken + 2.0 * causes.prior.stretch_mm_per_n * plain.actuator_tension_n[0]
    found = ChangedFinger(causes, z).at(pulled)
    assert found is not None
    angle, tip, tension = found
    np.testing.assert_allclose(angle.value, plain.angle_rad[0], atol=1e-6)
    np.testing.assert_allclose(tip.value, plain.tip_mm[0], atol=1e-4)
    np.testing.assert_allclose(tension.value[:, 0], plain.actuator_tension_n[0], rtol=1e-6)


@pytest.mark.parametrize("lead_mm", [0.0, 40.0, 400.0])
def test_a_stretch_is_expected_as_what_of_the_normal_distribution_lies_above_none(
    causes: Causes, lead_mm: float
) -> None:
    """By drawn numbers without those below none: half of them without a profile's stretch, hardly any with much."""
    finger = dataclasses.replace(causes.finger, compliance_per_n=1e-3, lead_mm=lead_mm)
    drawn_mm_per_n = causes.prior.stretch_mm_per_n * np.random.default_rng(1).normal(size=400_000)
    possible = drawn_mm_per_n[drawn_mm_per_n > -1e-3 * lead_mm] / causes.prior.stretch_mm_per_n
    mean, covariance = dataclasses.replace(causes, finger=finger).expected
    assert mean[causes.stretch] == pytest.approx(possible.mean(), abs=0.005)
    assert covariance[causes.stretch, causes.stretch] == pytest.approx(possible.var(), abs=0.01)


def test_no_cable_gets_shorter_when_it_is_pulled(causes: Causes) -> None:
    """A tip that runs ahead is put down to other causes: as likely as can be with a stretch of nothing."""
    z = drawn(causes, 3)
    z[causes.stretch] = 0.0
    ahead = closing(causes, z, np.random.default_rng(1), PULLS)
    further = [dataclasses.replace(one, pulled_mm=one.pulled_mm - 0.2 * one.tension_n) for one in ahead]
    known = Knowledge.prior(causes).learnt(further)
    assert known.mean[causes.stretch] == pytest.approx(0.0, abs=1e-12)
    expected, seen = Expectation.of(causes, known.mean, further), measured(further)
    assert expected is not None
    precision = np.linalg.inv(expected.noise)
    downhill = expected.slope.T @ precision @ (seen - expected.value) - known.mean
    inside = (np.abs(known.mean) < MAX_DEVIATION) & (np.arange(len(known.mean)) != causes.stretch)
    assert downhill[causes.stretch] < 0.0
    assert np.abs(downhill[inside]).max() < 0.05 * abs(downhill[causes.stretch])


def test_intervals_hold_before_and_after_closings(causes: Causes) -> None:
    """Fingers drawn from the prior: errors are as large as their deviations say, before and after three closings."""
    rng, closings = np.random.default_rng(3), 3
    scores: dict[int, list[np.ndarray]] = {0: [], closings: []}
    width: dict[int, list[float]] = {0: [], closings: []}
    for seed in range(8):
        z = drawn(causes, seed)
        known, true = Knowledge.prior(causes), ChangedFinger(causes, z).at(PULLS)
        assert true is not None
        for number in range(closings + 1):
            if number in scores:
                found = known.predict(PULLS)
                assert found is not None
                scores[number].append((true[1].value - found.tip_mm) / found.tip_stddev_mm)
                width[number].append(float(np.median(found.tip_stddev_mm)))
            known = known.learnt(closing(causes, z, rng))
    for number, found_scores in scores.items():
        assert 0.5 <= np.sqrt(np.mean(np.square(found_scores))) <= 1.3, number
    assert np.mean(width[closings]) < 0.4 * np.mean(width[0])


def test_tensions_that_are_off_alike_move_no_tip(causes: Causes) -> None:
    """Of a warm winding: tips as expected, all tensions 0.4 N above; independent errors would move the tips to fit."""

    def moved_mm(tension_error_n: float) -> float:
        known = Knowledge.prior(dataclasses.replace(causes, prior=Uncertainty(tension_error_n=tension_error_n)))
        before = known.predict(PULLS)
        assert before is not None
        plain = ChangedFinger(causes, np.zeros(len(causes.names))).at(PULLS)
        assert plain is not None
        tensions = plain[2].value[:, 0]
        seen = [
            ClosingInstant(0, pull, tip, tension + 0.4, tension)
            for pull, tip, tension in zip(PULLS, before.tip_mm, tensions, strict=True)
        ]
        found = known.learnt(seen).predict(PULLS)
        assert found is not None
        return float(np.abs(found.tip_mm - before.tip_mm).max())

    assert moved_mm(PRIOR.tension_error_n) < 0.5 * moved_mm(1e-6)


def test_what_was_learnt_stays_bounded(causes: Causes) -> None:
    """Impossible closings: the mean keeps within three deviations, the covariance below the prior's."""
    known = Knowledge.prior(causes)
    for _ in range(10):
        absurd = [
            dataclasses.replace(one, tip_mm=one.tip_mm + 40.0)
            for one in closing(causes, known.mean, np.random.default_rng(0))
        ]
        known = known.learnt(absurd)
    assert np.abs(known.mean).max() <= MAX_DEVIATION
    assert np.linalg.eigvalsh(known.covariance).max() <= 1.0 + 1e-9
    assert np.linalg.eigvalsh(known.covariance).min() > 0.0
    assert known.misfit > 5.0
    wide, narrow = known.predict(PULLS), dataclasses.replace(known, misfit=1.0).predict(PULLS)
    assert wide is not None
    assert narrow is not None
    assert (wide.tip_stddev_mm > 2.0 * narrow.tip_stddev_mm).all()


def test_what_is_not_seen_is_forgotten_slowly(causes: Causes) -> None:
    """Between closings all fades towards the prior, which is its own fixed point."""
    known = Knowledge.prior(causes).learnt(closing(causes, drawn(causes, 1), np.random.default_rng(1)))
    faded = known.faded()
    assert np.abs(faded.mean).sum() < np.abs(known.mean).sum()
    assert np.trace(faded.covariance) > np.trace(known.covariance)
    prior = Knowledge.prior(causes)
    np.testing.assert_allclose(prior.faded().mean, prior.mean)
    np.testing.assert_allclose(prior.faded().covariance, prior.covariance)


def test_a_closing_counts_once_the_finger_is_open_two_seconds_after_its_end(causes: Causes) -> None:
    learner = FingerLearner(causes)
    before = learner.at(0)
    for i, sample in enumerate(closing(causes, drawn(causes, 2), np.random.default_rng(2))):
        learner.add(dataclasses.replace(sample, stamp=i), pulling=True, free=True)
    learnt = learner.add(dataclasses.replace(sample, stamp=100), pulling=False, free=True)
    assert learnt is not None
    learner.note_open(100 + SPAN_NS - 1)
    assert learner.at(100 + SPAN_NS + 1) is before, "too early: a measurement may still come"
    assert learner.newest is learnt
    late = 100 + 10 * SPAN_NS
    assert learner.at(late) is before, "the finger has not been open since"
    learner.note_open(late)
    assert (learner.at(late), learner.at(late + 1)) == (before, learnt)
    learner.note_open(late + 1)
    assert learner.at(late) is before, "what was predicted stays predicted with it"


def session_run(profiles: dict[str, Profile], causes: Causes, order: str) -> list[tuple[object, ...]]:
    """Two closings through a session, tendons first or frames first; what was predicted on the way."""
    friction = ActiveFriction("rig", causes.law, causes.covariance)
    session = Session(profiles, {"index": "hook"}, WearSettings(), uncertainty=causes.prior)
    session.set_friction(friction)
    rng, stamp, predicted = np.random.default_rng(5), 0, []
    z = drawn(causes, 6)
    for _ in range(2):
        samples = closing(causes, z, rng, np.arange(0.5, 16.0, 0.5))
        for one in [*samples, dataclasses.replace(samples[-1], stamp=-1)]:
            stamp += 20 * MILLISECOND
            tendon = TendonInput(stamp, 1e-3 * one.pulled_mm, -0.05 if one.stamp < 0 else 0.02, one.tension_n)
            seen = MeasuredFinger("index", (), (1e-3 * one.tip_mm[0], 1e-3 * one.tip_mm[1]))
            (found,) = session.predict([tendon], ["index"])
            predicted.append((found.tip, found.tip_stddev, session.in_use.digest_at(stamp)))
            if order == "frames first":
                session.on_measured(stamp, [seen])
                session.on_tendons([tendon], ["index"])
            else:
                session.on_tendons([tendon], ["index"])
                session.on_measured(stamp, [seen])
        stamp += SPAN_NS
        session.on_tendons([TendonInput(stamp, 0.0, 0.0, 0.0)], ["index"])
    assert len(session.take_learnt()) == 2
    assert session.take_learnt() == []
    return predicted


def test_predictions_learn_whatever_the_order_of_arrival(profiles: dict[str, Profile], causes: Causes) -> None:
    """The second closing is predicted with what the first taught, by stamps alone, and the digest says so."""
    frames, tendons = (session_run(profiles, causes, order) for order in ("frames first", "tendons first"))
    assert frames == tendons
    half = len(frames) // 2
    first, second = frames[half - 2], frames[-2]
    assert max(second[1]) < 0.7 * max(first[1])
    assert len({one[2] for one in frames[:half]}) == len({one[2] for one in frames[half:]}) == 1
    assert first[2] != second[2]


def test_tensions_stay_the_profiles(profiles: dict[str, Profile], causes: Causes) -> None:
    """The cell keeps tables of tensions beside the predicted ones."""
    friction = ActiveFriction("rig", causes.law, causes.covariance)
    sessions = [
        Session(profiles, {"index": "hook"}, WearSettings(), uncertainty=prior) for prior in (causes.prior, None)
    ]
    for session in sessions:
        session.set_friction(friction)
    sample = TendonInput(1, 0.012, 0.01, 5.0)
    (known,), (plain,) = (session.predict([sample], ["index"]) for session in sessions)
    np.testing.assert_array_equal(known.tensions, plain.tensions)
    assert known.joint_angles.sum() < plain.joint_angles.sum()  # the cable stretches
    assert all(a > b for a, b in zip(known.tip_stddev, plain.tip_stddev, strict=True))
    slack, _ = (session.predict([dataclasses.replace(sample, pulled_length_m=0.0)], ["index"]) for session in sessions)
    assert slack[0].tip == pytest.approx((1e-3 * causes.finger.length_from_joint_mm, 0.0))
    assert measured([ClosingInstant(0, 1.0, np.array([1.0, 2.0]), 3.0, 3.0)]).tolist() == [1.0, 2.0, 3.0]
