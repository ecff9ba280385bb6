# SPDX-License-Identifier: Apache-2.0
"""Tolerances that first closings correct: fingers drawn from known widths; the room that holes leave a cable."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from softgrip_model.finger import Finger, Kernel
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.learning import ChangedFinger, Expectation
from softgrip_model.finger.predictor import Configuration, assumed_friction, room_mm
from softgrip_model.finger.tolerances import calibrated
from softgrip_model.finger.uncertainty import STATED, Causes, Uncertainty
from softgrip_model.profile import Profile

PULLS = np.arange(1.0, 16.5, 1.5)
FINGERS = 16
#: How the fingers of the test are made: better printed and homed than stated, their cables half way out.
TRUE = dataclasses.replace(
    STATED, friction=0.05, stiffness=0.05, thickness_mm=0.03, routing_mm=0.03, zero_mm=0.05, stretch_mm_per_n=0.01,
    room_mm=0.03, room_share=0.5, model=0.003, tip_noise_mm=0.3,
)  # fmt: skip


def causes_of(profile: Profile, prior: Uncertainty) -> Causes:
    finger, friction = Finger.from_profile(profile, "index"), assumed_friction(profile)
    return Causes(finger, friction.law, None, prior, room_mm(profile, "index"))


def first_closing(causes: Causes, rng: np.random.Generator) -> list[ClosingInstant]:
    """Of a finger that is drawn from the causes' prior."""
    z = np.clip(rng.normal(size=len(causes.names)), -2.5, 2.5)
    z[causes.stretch] = abs(z[causes.stretch])
    samples = [ClosingInstant(0, pull, np.zeros(2), 0.0, 5.0) for pull in PULLS]
    expected = Expectation.of(causes, z, samples)
    assert expected is not None
    seen = rng.multivariate_normal(expected.value, expected.noise)
    count = len(PULLS)
    return [
        dataclasses.replace(one, tip_mm=seen[2 * i : 2 * i + 2], tension_n=float(seen[2 * count + i]))
        for i, one in enumerate(samples)
    ]


def test_first_closings_correct_stated_tolerances(profiles: dict[str, Profile]) -> None:
    """Widths come down to those that the fingers were drawn from, as far as sixteen closings tell them apart."""
    rng, stated = np.random.default_rng(11), dataclasses.replace(STATED, tip_noise_mm=0.3)
    drawn = [profiles[name] for name in ("power", "hook", "pinch", "hook")] * (FINGERS // 4)
    closings = [first_closing(causes_of(one, TRUE), rng) for one in drawn]
    found = calibrated(stated, [(causes_of(one, stated), seen) for one, seen in zip(drawn, closings, strict=True)])
    assert found.room_share == pytest.approx(TRUE.room_share, abs=0.1)
    for name in ("thickness_mm", "zero_mm", "stretch_mm_per_n"):
        assert getattr(found, name) < 0.8 * getattr(stated, name), name
        assert getattr(found, name) > 0.5 * getattr(TRUE, name), name
    for name in ("spool", "tension_gain", "camera_mm", "scatter_mm", "tip_noise_mm", "tension_error_n"):
        assert getattr(found, name) == getattr(stated, name), f"{name}: no first closing is asked for it"


def test_few_closings_leave_what_is_stated(profiles: dict[str, Profile]) -> None:
    """One finger counts as much as the stated width: no width falls below the root of half its square."""
    stated = dataclasses.replace(STATED, tip_noise_mm=0.3)
    hook = profiles["hook"]
    closings = [first_closing(causes_of(hook, TRUE), np.random.default_rng(seed)) for seed in range(5, 12)]
    found = [calibrated(stated, [(causes_of(hook, stated), closing)]) for closing in closings]
    for name in ("friction", "stiffness", "zero_mm", "stretch_mm_per_n", "room_mm"):
        shares = [getattr(one, name) / getattr(stated, name) for one in found]
        assert min(shares) > 0.7, name
        assert np.median(shares) < 1.5, name


def test_a_hole_is_cut_by_the_flank_of_its_groove(profiles: dict[str, Profile]) -> None:
    """A circle of 0.6 mm, cut at 45 degrees, reaches 0.8485 mm along the flank; the cable's own radius goes off."""
    power = profiles["power"]
    assert room_mm(power, "index") == pytest.approx([0.6 * math.sqrt(2.0) - 0.125] * 6)
    stated = dataclasses.replace(power, cable=dataclasses.replace(power.cable, hole_radius_m=0.4e-3))
    assert room_mm(stated, "thumb") == pytest.approx([0.4 * math.sqrt(2.0) - 0.125] * 4)
    tight = dataclasses.replace(power, cable=dataclasses.replace(power.cable, hole_radius_m=power.cable.radius_m))
    assert max(room_mm(tight, "index")) == pytest.approx(0.125 * (math.sqrt(2.0) - 1.0))


def test_a_pulled_cable_lies_outside_its_routing_points(profiles: dict[str, Profile]) -> None:
    """What is believed of a mounted finger is the finger whose routing points lie further out, but for the stretch."""
    finger = Finger.from_profile(profiles["pinch"], "index")
    friction = assumed_friction(profiles["pinch"])
    causes = Configuration(profiles, {"index": "pinch"}, friction).causes("index", STATED)
    routing = np.array(finger.routing_mm) + STATED.room_share * np.array(room_mm(profiles["pinch"], "index"))
    outside = finger.with_design(np.array(finger.thickness_mm), routing)
    found = ChangedFinger(causes, np.zeros(len(causes.names))).at(PULLS)
    assert found is not None
    expected = Kernel([outside], friction.law).solve(PULLS, march=False)
    np.testing.assert_allclose(found[1].value, expected.tip_mm[0], atol=1e-9)
