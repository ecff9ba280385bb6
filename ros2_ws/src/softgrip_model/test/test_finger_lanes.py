# SPDX-License-Identifier: Apache-2.0
"""Targets of a closing are solved side by side: each must come out as it does alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from softgrip_model.finger import (
    FRICTIONLESS,
    Control,
    Finger,
    JointModel,
    Kernel,
    MomentLaw,
    Solution,
    Status,
    Strip,
    _core,
)
from softgrip_model.finger.design import core_design
from softgrip_model.finger.published import TANGENT_MODULUS_MPA, chapter_4_finger
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_model.friction.published import published

BRAID = published("braid-tpu-chapter4").law
LAWS = {
    "none": FRICTIONLESS,
    "capstan": FrictionLaw(Law.CAPSTAN, (0.40,), 3.75),
    **{f"heap {k.value}": FrictionLaw(Law.HEAP, (0.427, 0.731), 3.75, k) for k in KReading},
    **{f"matte {k.value}": dataclasses.replace(published("twine-tpu").law, k_reading=k) for k in KReading},
    "surface term ends within the closing": FrictionLaw(Law.MATTE, (0.3, 0.75, 0.1, 0.06), 3.75),
    "large K at low tensions": FrictionLaw(Law.MATTE, (0.6, 0.5, 0.1, 0.01), 3.75),
}
PULLS = np.linspace(0.1, 21.0, 211)


def agree(closing: Solution, alone: Solution) -> None:
    np.testing.assert_array_equal(closing.status, alone.status)
    np.testing.assert_allclose(closing.angle_rad, alone.angle_rad, atol=1e-9)
    np.testing.assert_allclose(closing.tension_n, alone.tension_n, rtol=1e-8)
    np.testing.assert_allclose(closing.tip_mm, alone.tip_mm, atol=1e-7)
    np.testing.assert_allclose(closing.pulled_mm, alone.pulled_mm, atol=1e-9)
    np.testing.assert_allclose(closing.phi_rad, alone.phi_rad, atol=1e-9)
    np.testing.assert_allclose(closing.pull_rate, alone.pull_rate, atol=1e-4)  # not brought on by the last step


def both(finger: Finger, law: FrictionLaw, targets: object, control: Control = Control.PULLED_LENGTH) -> Solution:
    kernel = Kernel([finger], law)
    closing = kernel.solve(targets, control)  # type: ignore[arg-type]
    agree(closing, kernel.solve(targets, control, march=False))  # type: ignore[arg-type]
    return closing


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_every_law(law: FrictionLaw) -> None:
    both(chapter_4_finger("hook"), law, PULLS)


@pytest.mark.parametrize("moment_law", MomentLaw)
def test_every_moment_law(moment_law: MomentLaw) -> None:
    finger = chapter_4_finger("power")
    both(dataclasses.replace(finger, strip=Strip(TANGENT_MODULUS_MPA, moment_law)), BRAID, PULLS)


@pytest.mark.parametrize("control", Control)
def test_every_control_and_a_cable_that_gives(control: Control) -> None:
    finger = dataclasses.replace(chapter_4_finger("power"), compliance_per_n=2e-4, lead_mm=300.0)
    last = {Control.PULLED_LENGTH: 21.0, Control.TENSION: 15.0, Control.DEFLECTION: 3.0}[control]
    both(finger, BRAID, np.linspace(0.01, 1.0, 150) * last, control)


@pytest.mark.parametrize("joints", range(1, 7))
def test_every_number_of_joints(joints: int) -> None:
    rng = np.random.default_rng(joints)
    finger = Finger(
        link_mm=(30.0,) * joints, thickness_mm=tuple(rng.uniform(2.5, 5.0, joints)), length_mm=(10.0,) * joints,
        routing_mm=tuple(rng.uniform(5.0, 9.0, 2 * joints)), width_mm=15.0, strip=Strip(TANGENT_MODULUS_MPA),
        joint_model=JointModel.HINGE,
    )  # fmt: skip
    both(finger, BRAID, np.linspace(0.05, 6.0, 120) * joints)


def test_random_designs() -> None:
    rng = np.random.default_rng(3)
    kernel = Kernel([chapter_4_finger("power")], BRAID)
    kernel = kernel.varied(rng.uniform(2.5, 5.0, (200, 3)), rng.uniform(5.0, 13.0, (200, 6)))
    agree(kernel.solve(PULLS), kernel.solve(PULLS, march=False))


def test_a_closing_up_to_shut_grooves_reports_each_target() -> None:
    """The last targets that can be reached, and those beyond, come within the same lanes."""
    found = both(chapter_4_finger("power"), BRAID, np.linspace(0.1, 60.0, 600))
    shut = (found.status[0] & Status.OUT_OF_REACH) != 0
    assert shut.any()
    assert (np.diff(shut.astype(int)) >= 0).all()
    assert np.isnan(found.angle_rad[0, shut]).all()


def test_targets_that_do_not_grow() -> None:
    pulls = PULLS.copy()
    pulls[[20, 45, 46, 90, 130, 131]] = np.nan, 3.0, 3.0, 60.0, 0.0, -1.0
    both(chapter_4_finger("power"), BRAID, pulls)


def test_bends_belong_to_the_angles() -> None:
    """Both are brought to the solution by the last step, not only the angles."""
    finger = chapter_4_finger("hook")
    found, design = Kernel([finger], BRAID).solve(PULLS), core_design(finger)
    for angles, bends in zip(found.angle_rad[0], found.phi_rad[0], strict=True):
        np.testing.assert_allclose(_core.bends(design, angles.tolist()), bends, atol=1e-11)
