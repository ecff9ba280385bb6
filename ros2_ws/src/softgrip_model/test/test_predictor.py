# SPDX-License-Identifier: Apache-2.0
"""The predictor without ROS: predictions, pairing with measurements, residuals."""

from __future__ import annotations

import dataclasses
import math
import weakref

import numpy as np
import pytest

from softgrip_model.finger import FingerError, JointModel, Kernel
from softgrip_model.finger.active_configuration import ActiveConfiguration, Timeline
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import WATCH, WATCHED, CauseWatch
from softgrip_model.finger.learning import Knowledge
from softgrip_model.finger.matching import Matcher, TendonInput
from softgrip_model.finger.predictor import ActiveFriction, Configuration, TendonReading, Validity, assumed_friction
from softgrip_model.finger.room_temperature import MAX_AGE_NS, RoomTemperature
from softgrip_model.finger.session import MeasuredFinger, Residual, Session
from softgrip_model.finger.uncertainty import PRIOR
from softgrip_model.finger.wear import WearSettings
from softgrip_model.profile import Profile

MILLISECOND = 1_000_000


@pytest.fixture
def friction(profiles: dict[str, Profile]) -> ActiveFriction:
    law = assumed_friction(profiles["power"]).law
    stddev = np.array([0.012, 0.07, 0.03, 0.02])
    correlation = np.eye(4)
    # n, epsilon and lambda, as fits have them: together they are known three times better than each alone
    correlation[1:, 1:] = [[1.0, 0.74, 0.80], [0.74, 1.0, 0.92], [0.80, 0.92, 1.0]]
    return ActiveFriction("rig-1", law, correlation * np.outer(stddev, stddev))


def test_published_power_finger(profiles: dict[str, Profile]) -> None:
    """docs: chapter 4 index finger, |strain| tangent law, 20 mm (reference table, no stop); hinges, as the thesis."""
    configuration = Configuration(profiles, {"index": "power"}, None, JointModel.HINGE)
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


def test_a_finger_that_stands_is_not_solved_again_and_nothing_old_is_given(
    profiles: dict[str, Profile], friction: ActiveFriction
) -> None:
    configuration = Configuration(profiles, {"index": "power"}, friction)
    still, letting_out = TendonReading("index", 0.02), TendonReading("index", 0.02, -0.01)
    prior = Knowledge.prior(configuration.causes("index", PRIOR))
    (first,) = configuration.predict([still])
    assert configuration.predict([still])[0] is first
    asked = [(still, prior), (letting_out, prior), (TendonReading("index", 0.0201), prior), (still, None)]
    for reading, known in asked:
        knowledge = {} if known is None else {"index": known}
        (again,) = configuration.predict([reading], knowledge)
        (fresh,) = Configuration(profiles, {"index": "power"}, friction).predict([reading], knowledge)
        assert again is not first
        assert again.joint_angles.tobytes() == fresh.joint_angles.tobytes()
        assert (again.tip, again.tip_stddev, again.validity, again.reason) == (
            fresh.tip, fresh.tip_stddev, fresh.validity, fresh.reason
        )  # fmt: skip


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
    samples = [TendonInput(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0 + t) for t in range(20)]
    measured = [(35 * MILLISECOND, "a"), (70 * MILLISECOND, "b"), (104 * MILLISECOND, "c")]

    def run(order: str) -> list[tuple[TendonInput, str]]:
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
    assert first.pulled_length_m == pytest.approx(3.5e-3)
    assert first.tension == pytest.approx(5.5)


def test_no_pair_across_a_gap_of_the_tendon_stream() -> None:
    matcher: Matcher[str] = Matcher(largest_gap=50 * MILLISECOND)
    matcher.add_tendon(TendonInput(0, 0.0, 0.0, 0.0))
    matcher.add_tendon(TendonInput(400 * MILLISECOND, 0.0, 0.0, 0.0))
    assert matcher.add_measured(200 * MILLISECOND, "lost") == []


def test_only_the_last_two_seconds_are_kept() -> None:
    matcher: Matcher[str] = Matcher()
    for t in range(400):
        matcher.add_tendon(TendonInput(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    assert matcher.add_measured(1_005 * MILLISECOND, "late") == []
    ((sample, _),) = matcher.add_measured(2_005 * MILLISECOND, "in time")
    assert sample.pulled_length_m == pytest.approx(0.2005)


def test_a_source_that_starts_again_is_paired_again() -> None:
    """Simulated time that starts again; a sample that is merely late changes nothing."""
    matcher: Matcher[str] = Matcher()
    for t in range(100, 120):
        matcher.add_tendon(TendonInput(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    assert matcher.add_tendon(TendonInput(1_100 * MILLISECOND, 9.0, 0.1, 2.0)) == []
    ((sample, _),) = matcher.add_measured(1_100 * MILLISECOND, "seen")
    assert sample.pulled_length_m == pytest.approx(0.11)
    for t in range(5):
        matcher.add_tendon(TendonInput(t * 10 * MILLISECOND, 1e-3 * t, 0.1, 2.0))
    ((sample, _),) = matcher.add_measured(15 * MILLISECOND, "seen again")
    assert sample.pulled_length_m == pytest.approx(0.0015)


class Seen:
    """A measurement whose end can be watched."""


def test_measurements_of_a_silent_tendon_are_let_go() -> None:
    """A tendon without a zero says no length for hours, and the camera sees on."""
    matcher: Matcher[Seen] = Matcher()
    matcher.add_tendon(TendonInput(0, 0.0, 0.0, 0.0))
    kept: weakref.WeakSet[Seen] = weakref.WeakSet()
    for t in range(1, 1000):
        seen = Seen()
        kept.add(seen)
        assert matcher.add_measured(t * 50 * MILLISECOND, seen) == []
    assert len(kept) == 41  # two seconds at 20 Hz, both ends


def test_measurements_that_begin_anew_are_paired_though_the_tendon_was_silent() -> None:
    matcher: Matcher[str] = Matcher()
    for t in range(100, 200):
        matcher.add_measured(t * 50 * MILLISECOND, "of the time before")
    matcher.add_measured(15 * MILLISECOND, "seen")
    pairs = [pair for t in range(5) for pair in matcher.add_tendon(TendonInput(t * 10 * MILLISECOND, 0.0, 0.0, 0.0))]
    assert [measured for _, measured in pairs] == ["seen"]


def test_velocity_that_nobody_gives_comes_from_the_lengths() -> None:
    matcher: Matcher[str] = Matcher()
    for t in range(3):
        matcher.add_tendon(TendonInput(t * 10 * MILLISECOND, 2e-4 * t, math.nan, 1.0))
    ((sample, _),) = matcher.add_measured(15 * MILLISECOND, "seen")
    assert sample.velocity == pytest.approx(0.02)


def test_residual_of_a_perfect_measurement_is_zero(profiles: dict[str, Profile]) -> None:
    session = Session(profiles, {"index": "pinch"}, WearSettings())
    (prediction,) = session.predict([TendonInput(1, 0.01, 0.0, 0.0)], ["index"])
    session.on_tendons([TendonInput(5, 0.01, 0.0, prediction.tension)], ["index"])
    seen = MeasuredFinger("index", tuple(prediction.joint_angles), prediction.tip)
    (residual,) = session.on_measured(5, [seen])
    assert residual.tip_error < 1e-12
    assert abs(residual.tension_error) < 1e-9
    assert max(map(abs, residual.joint_angle_errors)) < 1e-12
    shifted = dataclasses.replace(seen, tip=(prediction.tip[0] + 0.00095, prediction.tip[1]))
    (off,) = session.on_measured(5, [shifted])
    assert off.tip_error == pytest.approx(0.00095)
    assert off.tip_error_percent == pytest.approx(1.0)  # of 95 mm


def test_a_frame_is_judged_by_the_finger_that_sat_there_at_its_stamp(profiles: dict[str, Profile]) -> None:
    """A swap between two tendon samples; frames come late, wait for the next sample, or run ahead of the swap."""
    session = Session(profiles, {"index": "pinch"}, WearSettings())
    (prediction,) = session.predict([TendonInput(1, 0.01, 0.0, 0.0)], ["index"])
    seen = MeasuredFinger("index", tuple(prediction.joint_angles), prediction.tip, "pinch")
    other = dataclasses.replace(seen, profile="power")
    session.on_tendons([TendonInput(5, 0.01, 0.0, prediction.tension)], ["index"])
    assert len(session.on_measured(5, [seen])) == 1
    assert not session.on_measured(8, [seen, other])
    session.set_mounted({"index": "power"})
    (late,) = session.on_tendons([TendonInput(10, 0.01, 0.0, prediction.tension)], ["index"])
    assert (late.stamp, late.tip_error) == (8, pytest.approx(0.0, abs=1e-12))
    assert not session.on_measured(10, [seen])
    assert len(session.on_measured(10, [other])) == 1


def test_residuals_do_not_depend_on_the_order_of_frames_and_swaps(profiles: dict[str, Profile]) -> None:
    """Only the order of each against the tendons' samples is in a recording."""

    def residuals(order: str) -> list[Residual]:
        session = Session(profiles, {"index": "pinch", "thumb": "pinch"}, WearSettings())
        seen = MeasuredFinger("index", (0.1, 0.2, 0.3), (0.05, 0.03))
        step = {
            "frame": lambda: session.on_measured(8, [seen]),
            "swap": lambda: session.set_mounted({"index": "power"}),
            "grasp": lambda: session.set_free(False),
        }
        found = session.on_tendons([TendonInput(5, 0.01, 0.0, 3.0)], ["index"])
        for name in order.split():
            found += step[name]() or []
        return found + session.on_tendons([TendonInput(10, 0.012, 0.0, 3.5)], ["index"])

    first = residuals("frame swap grasp")
    assert len(first) == 1
    assert residuals("swap frame grasp") == residuals("grasp swap frame") == first


def test_what_is_predicted_names_whether_the_fingers_were_free(profiles: dict[str, Profile]) -> None:
    session = Session(profiles, {"index": "power"}, WearSettings())
    before = session.in_use.digest
    session.set_free(False)
    assert session.in_use.digest != before
    session.set_free(True)
    assert session.in_use.digest == before


class Listener(CauseWatch):
    """A watch that writes down in which temperature its closings were made."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.configuration.causes("index", WATCHED), WATCH)
        self.heard: list[float] = []

    def add(self, sample: ClosingInstant, *, pulling: bool, free: bool, temperature_c: float = math.nan) -> None:
        self.heard.append(temperature_c)
        super().add(sample, pulling=pulling, free=free, temperature_c=temperature_c)


def test_a_closing_is_watched_in_the_temperature_of_its_time(profiles: dict[str, Profile]) -> None:
    session = Session(profiles, {"index": "pinch"}, WearSettings())
    listener = Listener(session)
    monitors = session.in_use.monitors
    assert isinstance(monitors, dict)
    monitors["index"] = listener
    seen = MeasuredFinger("index", (0.1, 0.2, 0.3), (0.05, 0.03))

    def closes(stamp: int) -> None:
        session.on_tendons([TendonInput(stamp, 0.01, 0.0, 3.0)], ["index"])

    closes(1)
    session.on_measured(1, [seen])
    assert math.isnan(listener.heard[-1])  # there is no thermometer
    session.set_room(RoomTemperature(2, 24.0))
    closes(10)
    session.set_room(RoomTemperature(12, 31.0))
    session.on_measured(10, [seen])  # the frame of before is late
    assert listener.heard[-1] == 24.0
    closes(20)
    session.on_measured(20, [seen])
    assert listener.heard[-1] == 31.0
    closes(12 + MAX_AGE_NS + 1)
    session.on_measured(12 + MAX_AGE_NS + 1, [seen])
    assert math.isnan(listener.heard[-1])  # nobody has read it for ten minutes


@pytest.mark.parametrize("celsius", [math.nan, math.inf, 296.15, -273.15])
def test_what_is_no_rooms_temperature_is_refused(celsius: float) -> None:
    with pytest.raises(FingerError, match=r"cell/temperature: expected -40 to 85 degC"):
        RoomTemperature(1, celsius)


def test_a_late_sample_does_not_change_what_was_in_use(profiles: dict[str, Profile]) -> None:
    session, timeline = Session(profiles, {"index": "power"}, WearSettings()), Timeline(span_ns=100)
    first, second = session.in_use, replace_free(session.in_use)
    timeline.record(10, first)
    timeline.record(20, second)
    timeline.record(15, first)
    assert [timeline.at(stamp) for stamp in (9, 10, 19, 20, 30)] == [None, first, first, second, second]
    timeline.record(-100, first)  # the source has started again
    assert (timeline.at(30), timeline.at(-100)) == (first, first)


def replace_free(in_use: ActiveConfiguration) -> ActiveConfiguration:
    return dataclasses.replace(in_use, free=not in_use.free)


def test_service_names_what_is_unknown(profiles: dict[str, Profile], friction: ActiveFriction) -> None:
    session = Session(profiles, {"index": "power"}, WearSettings())
    session.set_friction(friction)
    states = session.closing("hook", "", "", [0.005, 0.01])
    assert [(s.finger, s.pulled_length_m) for s in states] == [
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
