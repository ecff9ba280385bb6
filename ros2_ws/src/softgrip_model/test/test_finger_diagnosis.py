# SPDX-License-Identifier: Apache-2.0
"""What the watch puts changes down to. The true finger has hinges (mode P), the watch's has flexures (mode F)."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest

from softgrip_model.finger import Finger, JointModel, Kernel
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import WATCH, WATCHED, CauseWatch, ClosingConditions
from softgrip_model.finger.hand import Softening, log_odds_of_heat
from softgrip_model.finger.hypotheses import Cause, OwnClosing, hypotheses
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.finger.session import Session
from softgrip_model.finger.uncertainty import Causes
from softgrip_model.finger.wear import WearSettings, WearVerdict
from softgrip_model.profile import Profile

PULLS = np.arange(1.0, 15.5, 1.0)
USUAL = ClosingConditions(16.0, 12.0, 20.0)


class TrueFinger:
    """A finger of the hook as it is, with the noise of its closings."""

    def __init__(self, profiles: dict[str, Profile], seed: int, slot: str = "index") -> None:
        self.believed = Finger.from_profile(profiles["hook"], slot)
        self.law = assumed_friction(profiles["hook"]).law
        self._rng = np.random.default_rng(seed)
        self._predicted_n = Kernel([self.believed], self.law).solve(PULLS).tension_n[0, :, 0]

    def watch(self) -> CauseWatch:
        return CauseWatch(Causes(self.believed, self.law, None, WATCHED), WATCH)

    def close(
        self, friction: float = 1.0, stiffness: float = 1.0, middle: float = 1.0, zero: float = 0.0, gain: float = 1.0,
        camera: tuple[float, float] = (0.0, 0.0), ripple: float = 0.0, relaxed: float = 0.0, slack: int = 0,
    ) -> tuple[ClosingInstant, ...]:  # fmt: skip
        alpha, n, epsilon, lam = self.law.coefficients
        friction *= 1.0 + 0.01 * self._rng.standard_normal()
        law = self.law.with_coefficients([friction * alpha, n, friction * epsilon, friction * lam])
        hinges = self.believed.with_joint_model(JointModel.HINGE)
        width, strip = hinges.width_mm * stiffness, hinges.strip
        made = dataclasses.replace(hinges, strip=strip, strip_width_mm=(width, middle * width, width))
        pulls = PULLS + zero + 0.03 * self._rng.standard_normal()
        found = Kernel([made], law).solve(pulls)
        tips = found.tip_mm[0] + camera + 0.3 * self._rng.standard_normal((len(PULLS), 2))
        tips[::2] += ripple
        tips[:slack] = tips[slack]
        kept = gain * (1.0 - relaxed * np.linspace(0.2, 1.8, len(PULLS)))
        kept[:slack] = 0.0
        tensions = kept * found.tension_n[0, :, 0] * (1.0 + 0.02 * self._rng.standard_normal(len(PULLS)))
        return tuple(
            ClosingInstant(0, float(p), tip, float(n), float(expected))
            for p, tip, n, expected in zip(PULLS, tips, tensions, self._predicted_n, strict=True)
        )


_SETTLED: dict[int, tuple[TrueFinger, CauseWatch]] = {}


def settled(profiles: dict[str, Profile], seed: int = 1) -> tuple[TrueFinger, CauseWatch]:
    """Return a finger whose baseline stands, and that has been quiet since; made once a seed."""
    if seed not in _SETTLED:
        finger = TrueFinger(profiles, seed)
        watch = finger.watch()
        for number in range(10):
            diagnosis = watch.add_closing(finger.close(), USUAL)
            assert diagnosis.explanations == (), number
        assert watch.judge() == (WearVerdict.OK, "")
        _SETTLED[seed] = finger, watch
    return copy.deepcopy(_SETTLED[seed])


def seen_tilted(tip_mm: np.ndarray, tilt_rad: float, camera_mm: np.ndarray) -> np.ndarray:
    """Return where in the plane a camera sees a tip that has been turned out of it about x [mm]."""
    x, y = tip_mm
    point, z = np.array([x, y * math.cos(tilt_rad)]), y * math.sin(tilt_rad)
    return np.asarray(camera_mm[:2] + camera_mm[2] / (camera_mm[2] - z) * (point - camera_mm[:2]))


CHANGES = {
    "friction": ({"friction": 1.25}, {Cause.FRICTION}, WearVerdict.RECALIBRATE),
    "worn friction": ({"friction": 1.9}, {Cause.FRICTION}, WearVerdict.WORN),
    "zero": ({"zero": 1.0}, {Cause.ZERO}, WearVerdict.RECALIBRATE),
    "zero the other way": ({"zero": -0.4}, {Cause.ZERO}, WearVerdict.RECALIBRATE),
    "camera": ({"camera": (1.4, -1.4)}, {Cause.CAMERA}, WearVerdict.RECALIBRATE),
    "softer": ({"stiffness": 0.85}, {Cause.STIFFNESS, Cause.TENSION_GAIN}, None),
    "stronger motor": ({"gain": 1.12}, {Cause.STIFFNESS, Cause.TENSION_GAIN}, None),
    "strips that creep more": ({"relaxed": 0.12}, {Cause.STIFFNESS}, WearVerdict.WATCH),
    "strips that stay bent": ({"relaxed": 0.12, "slack": 2}, {Cause.STIFFNESS}, WearVerdict.WATCH),
    "a wavy picture": ({"ripple": 4.0}, {Cause.NONE_OF_THESE}, WearVerdict.WATCH),
}


@pytest.mark.parametrize("name", CHANGES)
def test_the_cause_is_named(profiles: dict[str, Profile], name: str) -> None:
    to, causes, verdict = CHANGES[name]
    finger, watch = settled(profiles)
    for _ in range(3):
        watch.add_closing(finger.close(**to), USUAL)  # type: ignore[arg-type]
    assert watch.diagnosis.causes[0] in causes
    found, why = watch.judge()
    assert str(watch.diagnosis.causes[0]) in why
    assert found is verdict if verdict is not None else found in {WearVerdict.WATCH, WearVerdict.RECALIBRATE}


def test_an_odd_closing_is_over_when_it_is_over(profiles: dict[str, Profile]) -> None:
    """Closings before and after it have no mean, so the windows that still hold it say nothing."""
    for seed in (1, 2):
        finger, watch = settled(profiles, seed)
        for ripple in (4.0, 4.0):
            watch.add_closing(finger.close(ripple=ripple), USUAL)
            assert watch.diagnosis.causes == (Cause.NONE_OF_THESE,)
        for _ in range(12):
            watch.add_closing(finger.close(), USUAL)
            assert watch.judge() == (WearVerdict.OK, "")


def test_a_zero_that_moved_a_little_is_named_in_the_end(profiles: dict[str, Profile]) -> None:
    """0.15 mm, a third of what one closing shows: 12 in a row have a mean that says it."""
    for seed in (1, 2, 3, 4):
        finger, watch = settled(profiles, seed)
        for _ in range(2):  # of 12 calm ones
            watch.add_closing(finger.close(), USUAL)
        watch.add_closing(finger.close(zero=0.15), USUAL)
        assert watch.diagnosis.causes == ()
        for _ in range(11):
            watch.add_closing(finger.close(zero=0.15), USUAL)
        assert watch.diagnosis.causes == (Cause.ZERO,)


def test_heat_and_motor_never_wear_a_finger_out(profiles: dict[str, Profile]) -> None:
    """Softer by 15 % or a motor 12 % stronger condemned good fingers once."""
    for to in ({"stiffness": 0.85}, {"gain": 1.12}):
        finger, watch = settled(profiles)
        for _ in range(6):
            watch.add_closing(finger.close(**to), USUAL)
            assert watch.judge()[0] is not WearVerdict.WORN


def test_a_weaker_strip_is_told_from_softer_strips(profiles: dict[str, Profile]) -> None:
    """One closing is not enough to condemn a finger for it."""
    finger, watch = settled(profiles)
    watch.add_closing(finger.close(middle=0.8), USUAL)
    assert watch.judge()[0] is not WearVerdict.WORN
    for _ in range(3):
        watch.add_closing(finger.close(middle=0.8), USUAL)
    assert watch.diagnosis.causes[0] in {Cause.STRIP, Cause.NONE_OF_THESE}
    assert watch.diagnosis.causes[0] is not Cause.FRICTION


def test_other_fingers_tell_heat_from_a_motor(profiles: dict[str, Profile]) -> None:
    """Softer strips and a motor that reads less look alike, until the hand's other fingers are asked."""
    (hot, watch), (near, its) = settled(profiles), settled(profiles, 2)
    watch.join([its])
    for _ in range(3):
        watch.add_closing(hot.close(gain=0.88), dataclasses.replace(USUAL, temperature_c=math.nan))
        its.add_closing(near.close(), USUAL)
    assert watch.diagnosis.causes[0] is Cause.TENSION_GAIN
    assert watch.judge()[0] is WearVerdict.RECALIBRATE
    for _ in range(5):
        watch.add_closing(hot.close(stiffness=0.88), USUAL)
        its.add_closing(near.close(stiffness=0.88), USUAL)
    assert watch.diagnosis.causes[0] is Cause.TEMPERATURE
    assert watch.judge()[0] is WearVerdict.WATCH


def test_a_session_asks_the_fingers_of_its_hand(profiles: dict[str, Profile]) -> None:
    """Softer by one amount, of unknown temperature: one finger alone would be called softer."""
    session = Session(profiles, {"index": "hook", "middle": "hook"}, WearSettings())
    fingers = {slot: TrueFinger(profiles, seed, slot) for seed, slot in enumerate(("index", "middle"), 1)}
    unknown = dataclasses.replace(USUAL, temperature_c=math.nan)
    for stiffness in (*[1.0] * 10, *[0.88] * 5):
        for slot, finger in fingers.items():
            monitor = session.in_use.monitors[slot]
            assert isinstance(monitor, CauseWatch)
            monitor.add_closing(finger.close(stiffness=stiffness), unknown)
    for _, why in session.verdicts().values():
        assert why.startswith(Cause.TEMPERATURE)


def test_heat_takes_all_fingers_alike() -> None:
    """Odds from marginal likelihoods of normal amounts: agreement is for heat, one finger that stays is against it."""
    warm, still, other = Softening(-0.10, 0.005), Softening(0.0, 0.005), Softening(0.10, 0.005)
    assert log_odds_of_heat(warm, [warm, warm], 0.1) > log_odds_of_heat(warm, [warm], 0.1) > 3.0
    assert log_odds_of_heat(warm, [still], 0.1) < -3.0
    assert log_odds_of_heat(warm, [warm, still], 0.1) < -3.0
    assert log_odds_of_heat(warm, [other], 0.1) < -3.0
    assert log_odds_of_heat(warm, [], 0.1) == pytest.approx(0.0)
    # what is not known of the other finger says nothing but that changes are rare
    assert abs(log_odds_of_heat(warm, [Softening(0.0, 10.0)], 0.1)) < 0.1


def test_what_a_closing_reads_is_exact(profiles: dict[str, Profile]) -> None:
    """Gain, camera and mounting by hand, from the finger's own closing; the zero beside the kernel pulled further."""
    finger = TrueFinger(profiles, 9)
    causes = Causes(finger.believed, finger.law, None, WATCHED)
    count = len(PULLS)
    own = OwnClosing(causes, np.zeros(len(causes.names)), PULLS, np.ones(count), np.zeros(3 * count))
    found = {one.cause: one for one in hypotheses(own, Cause.STIFFNESS, 0.0) if one.cause is not Cause.STIFFNESS}
    tip, tension = own.value[: 2 * count].reshape(-1, 2), own.value[2 * count :]
    gain = found[Cause.TENSION_GAIN].effect(np.array([0.1]))
    assert gain == pytest.approx(np.concatenate([np.zeros(2 * count), 0.1 * tension]))
    seen = found[Cause.CAMERA].effect(np.array([1.0, -2.0, 0.01, 0.0]))
    assert seen is not None
    assert seen[: 2 * count].reshape(-1, 2) == pytest.approx(0.01 * tip + [1.0, -2.0])
    further = found[Cause.ZERO].effect(np.array([0.5]))
    direct = Kernel([finger.believed], finger.law).solve(PULLS + 0.5)
    assert further is not None
    assert (own.value + further)[: 2 * count].reshape(-1, 2) == pytest.approx(direct.tip_mm[0], abs=1e-6)


@pytest.mark.parametrize("tilt_rad", [0.02, -0.02])
def test_a_finger_that_leans_is_seen_larger_or_smaller_by_a_camera(
    profiles: dict[str, Profile], tilt_rad: float
) -> None:
    """Beside the exact perspective of a camera at (60, 40, 220) mm; what is left is of the second order."""
    finger, count = TrueFinger(profiles, 9), len(PULLS)
    causes = Causes(finger.believed, finger.law, None, WATCHED)
    own = OwnClosing(causes, np.zeros(len(causes.names)), PULLS, np.ones(count), np.zeros(3 * count))
    tilt = next(one for one in hypotheses(own, Cause.STIFFNESS, 0.0) if one.cause is Cause.OUT_OF_PLANE)
    tip, beside, distance = own.value[: 2 * count].reshape(-1, 2), np.array([60.0, 40.0]), 220.0
    seen = np.array([seen_tilted(one, tilt_rad, np.array([*beside, distance])) for one in tip])
    effect = tilt.effect(tilt_rad / distance * np.array([100.0, *beside]))
    assert effect is not None
    assert np.abs(seen - tip).max() > 0.2
    assert effect[: 2 * count].reshape(-1, 2) == pytest.approx(seen - tip, abs=0.03)
    assert not effect[2 * count :].any()


@pytest.mark.parametrize("tilt_rad", [0.26, -0.26])
def test_a_finger_mounted_out_of_its_plane_is_not_worn(profiles: dict[str, Profile], tilt_rad: float) -> None:
    """15 degrees, seen by a camera 220 mm away."""
    finger, watch = settled(profiles)
    for _ in range(6):
        closing = finger.close()
        tilted = [
            dataclasses.replace(one, tip_mm=seen_tilted(one.tip_mm, tilt_rad, np.array([60.0, 40.0, 220.0])))
            for one in closing
        ]
        watch.add_closing(tuple(tilted), USUAL)
        assert watch.judge()[0] is not WearVerdict.WORN
    assert watch.diagnosis.causes[0] is Cause.OUT_OF_PLANE


def test_how_a_closing_was_made_counts(profiles: dict[str, Profile]) -> None:
    """Speed, rest, temperature and history name what a common softening is; none of them is a fault."""
    for conditions, cause in [
        (ClosingConditions(6.0, 12.0, 20.0), Cause.CONDITIONS),
        (ClosingConditions(16.0, 0.5, 20.0), Cause.CONDITIONS),
        (ClosingConditions(16.0, 12.0, 32.0), Cause.TEMPERATURE),
        (ClosingConditions(16.0, 12.0, 20.0, further_mm=3.0), Cause.RUNNING_IN),
    ]:
        finger, watch = settled(profiles)
        for _ in range(3):
            watch.add_closing(finger.close(stiffness=0.88), conditions)
        assert cause in watch.diagnosis.causes
        assert watch.judge()[0] is not WearVerdict.WORN
    finger, watch = settled(profiles)
    watch.add_closing(finger.close(), ClosingConditions(6.0, 12.0, 20.0))
    assert watch.diagnosis.causes == (Cause.CONDITIONS,)
    assert watch.judge()[0] is WearVerdict.OK


def test_a_slow_closing_that_fits_nothing_is_asked_for_again(profiles: dict[str, Profile]) -> None:
    """What a new speed does to a finger is not known: only a usual closing shows that something else has happened."""
    finger, watch = settled(profiles)
    for _ in range(3):
        watch.add_closing(finger.close(ripple=4.0), dataclasses.replace(USUAL, speed_mm_per_s=6.0))
    assert watch.diagnosis.causes == (Cause.CONDITIONS,)
    verdict, why = watch.judge()
    assert verdict is WearVerdict.WATCH
    assert "6.0 mm/s beside 16.0 to 16.0: close at the usual speed" in why
    watch.add_closing(finger.close(ripple=4.0), USUAL)
    assert watch.diagnosis.causes == (Cause.NONE_OF_THESE,)


def test_instants_make_closings(profiles: dict[str, Profile]) -> None:
    """As the predictor feeds it; held objects are not looked at."""
    finger = TrueFinger(profiles, 6)
    watch, stamp = finger.watch(), 0
    for free in (True, True, False):
        for one in finger.close():
            stamp += 62_500_000
            watch.add(dataclasses.replace(one, stamp=stamp), pulling=True, free=free)
        watch.add(dataclasses.replace(one, stamp=stamp + 1), pulling=False, free=free)
        stamp += 12_000_000_000
    assert watch.closings == 2
    assert watch.judge()[1] == "learning the baseline: closing 2 of 5"
