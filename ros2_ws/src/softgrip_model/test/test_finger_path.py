# SPDX-License-Identifier: Apache-2.0
"""Paths: closing and opening with Coulomb's cone, objects in the way."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

from softgrip_model.finger import (
    FRICTIONLESS,
    Control,
    Cylinder,
    Finger,
    FingerError,
    JointLimit,
    Kernel,
    Path,
    PathSettings,
    Plane,
    Status,
    close,
    follow,
    sphere,
)
from softgrip_model.finger.parts import bends, groove, strip_moment
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.friction.published import published

LAW = published("braid-tpu-chapter4").law
UP_AND_DOWN = [*np.arange(0.5, 16.1, 0.5), *np.arange(15.5, 0.4, -0.5), *np.arange(1.0, 18.1, 0.5)]


@pytest.fixture
def elastic() -> Finger:
    """The power finger with a cable of 2 kN axial stiffness."""
    return dataclasses.replace(chapter_4_finger("power"), compliance_per_n=1 / 2000.0, lead_mm=150.0)


def cone(finger: Finger, law: FrictionLaw, path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ln(T_i / T_{i+1}) at each bend, and the most that friction holds when pulled and when let back."""
    ratio = np.log(path.tension_n[:, :-1] / path.tension_n[:, 1:])
    bend = np.array([bends(finger, angles) for angles in path.angle_rad])
    size = np.sqrt(bend**2 + finger.smoothing_rad**2)
    pulled = law.evaluate(size, path.tension_n[:, 1:]).log_ratio
    back = law.evaluate(size, path.tension_n[:, :-1]).log_ratio
    return ratio, pulled, back


def assert_moments_balance(finger: Finger, path: Path, contact_moment: np.ndarray | float = 0.0) -> None:
    moment = np.array([[strip_moment(finger, j, q)[0] for j, q in enumerate(angles)] for angles in path.angle_rad])
    arms = np.array(
        [
            [groove(finger.routing_mm[2 * j], finger.routing_mm[2 * j + 1], q).arm_mm for j, q in enumerate(angles)]
            for angles in path.angle_rad
        ]
    )
    free = (path.angle_rad < np.pi / 2 - finger.stop_margin_rad).all(axis=1)
    assert free.any()
    residual = moment - path.tension_n[:, 1::2] * arms - contact_moment
    np.testing.assert_allclose(residual[free], 0.0, atol=1e-6)


def test_pulling_is_the_kernels_closing(elastic: Finger) -> None:
    pulls = np.arange(0.5, 18.1, 0.5)
    path, closing = follow(elastic, LAW, pulls), close(elastic, LAW, pulls)
    np.testing.assert_allclose(path.angle_rad, closing.angle_rad[0], atol=1e-8)
    np.testing.assert_allclose(path.tension_n, closing.tension_n[0], rtol=1e-7)
    assert (path.slide == 1).all()


@pytest.mark.parametrize("compliance", [0.0, 5e-4])
@pytest.mark.parametrize("grasp", ["power", "hook", "pinch"])
def test_coulombs_law_holds_along_the_path(grasp: str, compliance: float) -> None:
    """Complementarity at every bend and moment balance at every joint, from the returned numbers alone."""
    finger = dataclasses.replace(chapter_4_finger(grasp), compliance_per_n=compliance, lead_mm=50.0)
    path = follow(finger, LAW, UP_AND_DOWN, settings=PathSettings(largest_pull_step_mm=0.5))
    assert not path.failed.any()
    ratio, pulled, back = cone(finger, LAW, path)
    slip = np.diff(path.slip_mm, axis=0)
    slide = path.slide[1:]
    assert (ratio <= pulled + 1e-8).all()
    assert (ratio >= -back - 1e-8).all()
    assert (slip[slide == 1] >= -1e-9).all()
    assert (slip[slide == -1] <= 1e-9).all()
    np.testing.assert_allclose(slip[slide == 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(ratio[1:][slide == 1], pulled[1:][slide == 1], atol=1e-7)
    np.testing.assert_allclose(ratio[1:][slide == -1], -back[1:][slide == -1], atol=1e-7)
    assert (path.slide == 0).any()  # some bends stick after a reversal
    assert (path.slide == -1).any()
    assert_moments_balance(finger, path)


def test_no_friction_no_loop(elastic: Finger) -> None:
    path = follow(elastic, FRICTIONLESS, UP_AND_DOWN)
    tension = dict[float, list[float]]()
    for pull, value in zip(UP_AND_DOWN, path.tension_n[:, 0], strict=True):
        tension.setdefault(float(pull), []).append(float(value))
    assert all(max(values) - min(values) < 1e-7 for values in tension.values())


def test_the_loop_costs_the_work_that_friction_takes(elastic: Finger) -> None:
    """Area of the force-length loop = sum over bends of (difference of tensions) x slip; both by the trapezoid."""
    step = 0.05
    up = np.arange(step, 14.0 + step / 2, step)
    targets = np.concatenate([up, up[::-1][1:], up[1:]])
    path = follow(elastic, LAW, targets, settings=PathSettings(largest_pull_step_mm=step))
    seven = int(np.argmin(np.abs(up - 7.0)))  # from 7 mm up, down to 0.05 and back to 7 mm
    cycle = slice(seven, 2 * (len(up) - 1) + seven + 1)
    pulled, tension, slip = path.pulled_mm[cycle], path.tension_n[cycle], path.slip_mm[cycle]
    assert pulled[0] == pytest.approx(pulled[-1])
    work = float(trapezoid(tension[:, 0], pulled))
    taken = sum(float(trapezoid(tension[:, i] - tension[:, i + 1], slip[:, i])) for i in range(slip.shape[1]))
    assert work > 0.0
    assert work == pytest.approx(taken, rel=2e-3)  # steps of 0.05 mm cut the corners at the reversals


def test_pulling_again_returns_to_the_first_curve(elastic: Finger) -> None:
    path = follow(elastic, LAW, [4.0, 10.0, 3.0, 10.0, 12.0])
    fresh = follow(elastic, LAW, [4.0, 10.0, 12.0])
    np.testing.assert_allclose(path.angle_rad[[3, 4]], fresh.angle_rad[[1, 2]], atol=2e-3)
    assert path.tension_n[2, 0] < close(elastic, LAW, [3.0]).tension_n[0, 0, 0]


def test_the_joint_at_the_actuator_opens_first() -> None:
    path = follow(chapter_4_finger("power"), LAW, [12.0, 11.5])
    opened = path.angle_rad[1] - path.angle_rad[0]
    assert opened[0] < -0.05
    np.testing.assert_allclose(opened[1:], 0.0, atol=1e-6)
    assert path.slide[1].tolist()[0] == -1
    assert path.tension_n[1, 0] < path.tension_n[1, 1] < path.tension_n[0, 1]


def test_holding_band_of_the_tension() -> None:
    """Letting the tension down moves nothing until friction's cone has been crossed."""
    finger = chapter_4_finger("power")
    path = follow(finger, LAW, [10.0, 9.0, 7.5, 3.0], Control.TENSION)
    np.testing.assert_allclose(path.angle_rad[1:3], path.angle_rad[[0, 0]], atol=1e-5)
    assert (path.slide[1] == 0).all()
    assert path.angle_rad[3, 0] < path.angle_rad[0, 0] - 0.5
    np.testing.assert_allclose(path.tension_n[:, 0], [10.0, 9.0, 7.5, 3.0], rtol=1e-9)


def test_ranges_are_flagged_along_the_path() -> None:
    path = follow(chapter_4_finger("power"), LAW, [1.0, 8.0, 20.0])
    assert [bool(status & Status.TENSION_OUTSIDE) for status in path.status] == [True, False, True]


def test_slack_forgets() -> None:
    finger = chapter_4_finger("hook")
    path = follow(finger, LAW, [12.0, 6.0, 0.0, 6.0])
    assert path.status[2] == Status.SLACK
    assert (path.angle_rad[2] == 0.0).all()
    np.testing.assert_allclose(path.angle_rad[3], close(finger, LAW, [6.0]).angle_rad[0, 0], atol=1e-4)


def test_joint_limit_carries_what_the_cable_gives_beyond() -> None:
    finger = chapter_4_finger("power")
    limit = math.radians(30.0)
    path = follow(finger, LAW, np.arange(2.0, 18.1, 2.0), contacts=[JointLimit(0, limit)])
    touching = path.contact_force[:, 0] > 0
    assert touching.tolist() == (np.arange(2.0, 18.1, 2.0) > 6.0).tolist()
    np.testing.assert_allclose(path.angle_rad[touching, 0], limit, atol=1e-9)
    assert (path.gap[~touching, 0] > 0).all()
    moment = np.zeros_like(path.angle_rad)
    moment[:, 0] = -path.contact_force[:, 0]
    assert_moments_balance(finger, path, moment)


CONTACTS: dict[str, Cylinder | Plane] = {
    "cylinder": Cylinder((55.0, -50.0), 20.0),
    "sphere": sphere((55.0, -50.0, 12.0), math.hypot(20.0, 12.0)),
    "plane": Plane((0.0, 1.0), -50.0),
    "slanted plane on a link": Plane((math.sqrt(0.5), math.sqrt(0.5)), 20.0, link=1, along_mm=20.0),
}


@pytest.mark.parametrize("name", CONTACTS)
def test_contact_forces_balance(name: str) -> None:
    """No overlap, no pull, and the moments of the contact force by statics at each joint."""
    finger, contact = chapter_4_finger("power"), CONTACTS[name]
    path = follow(finger, LAW, np.arange(1.0, 16.1, 0.5), contacts=[contact])
    assert not path.failed.any()
    force, gap = path.contact_force[:, 0], path.gap[:, 0]
    assert (force >= 0.0).all()
    assert (gap >= -1e-9).all()
    np.testing.assert_allclose(force * gap, 0.0, atol=1e-7)
    assert (force > 0.1).any()
    assert (gap > 0.1).any()
    link = 2 if contact.link is None else contact.link
    along = finger.link_mm[link] if contact.along_mm is None else contact.along_mm
    moments = np.zeros_like(path.angle_rad)
    for k, angles in enumerate(path.angle_rad):
        joints, at, heading = [], np.zeros(2), 0.0
        for j in range(link + 1):
            joints.append(at)
            heading -= angles[j]
            length = along if j == link else finger.link_mm[j]
            at = at + length * np.array([math.cos(heading), math.sin(heading)])
        if isinstance(contact, Plane):
            normal = np.array(contact.normal)
            expected_gap = float(normal @ at) - contact.offset_mm
        else:
            away = at - np.array(contact.centre_mm)
            normal = away / np.linalg.norm(away)
            expected_gap = float(np.linalg.norm(away)) - contact.radius_mm
        assert gap[k] == pytest.approx(expected_gap, abs=1e-9)
        for j, joint in enumerate(joints):
            (dx, dy), (nx, ny) = at - joint, force[k] * normal
            moments[k, j] = -(dx * ny - dy * nx)  # about z, clockwise closes
    assert_moments_balance(finger, path, moments)


def test_objects_come_off_again() -> None:
    finger = chapter_4_finger("power")
    object_ = Cylinder((55.0, -50.0), 20.0)
    path = follow(finger, LAW, [14.0, 10.0, 6.0, 3.0], contacts=[object_])
    assert path.contact_force[0, 0] > 0.0
    assert path.contact_force[-1, 0] == pytest.approx(0.0, abs=1e-9)
    assert path.gap[-1, 0] > 1.0


def test_a_tip_snaps_past_an_object_where_its_equilibria_end() -> None:
    """Before the jump the contact force grows without bound in its slope; after it every law holds again."""
    finger = chapter_4_finger("power")
    closing = close(finger, LAW, [8.0, 8.5]).tip_mm[0]
    ahead = (closing[1] - closing[0]) / np.linalg.norm(closing[1] - closing[0])
    c, s = math.cos(0.7), -math.sin(0.7)
    centre = closing[0] + 6.0 * np.array([[c, -s], [s, c]]) @ ahead
    pulls = np.arange(1.0, 16.1, 0.5)
    path = follow(finger, LAW, pulls, contacts=[Cylinder((float(centre[0]), float(centre[1])), 6.0)])
    assert not path.failed.any()
    (jump,) = np.flatnonzero(path.status & Status.SNAPPED)
    assert path.contact_force[jump - 1, 0] > 0.1
    steps = np.linalg.norm(np.diff(path.tip_mm, axis=0), axis=1)
    assert steps[jump - 1] > 2.0 * np.median(steps)
    gaps = np.linalg.norm(path.tip_mm - centre, axis=1) - 6.0
    assert gaps.min() > -1e-9
    np.testing.assert_allclose(path.gap[:, 0], gaps, atol=1e-9)
    assert path.contact_force[-1, 0] == 0.0
    ratio, pulled, back = cone(finger, LAW, path)
    assert (ratio <= pulled + 1e-7).all()
    assert (ratio >= -back - 1e-7).all()


def test_random_designs_go_up_and_down() -> None:
    rng = np.random.default_rng(11)
    targets = [*np.arange(1.0, 16.0, 1.0), *np.arange(14.0, 0.5, -1.0), 3.0, 5.0, 4.0]
    for _ in range(25):
        design = chapter_4_finger("power").with_design(rng.uniform(2.5, 5, 3), rng.uniform(5, 13, 6))
        design = dataclasses.replace(design, compliance_per_n=float(rng.choice([0.0, 5e-4])))
        path = follow(design, LAW, targets)
        assert not path.failed.any()
        np.testing.assert_allclose(path.pulled_mm, targets, atol=1e-9)


def test_a_reversing_joint_is_solved_right() -> None:
    """Where the kernel flags a reversal, the path keeps Coulomb's law at the bend that runs back."""
    law = FrictionLaw(Law.CAPSTAN, (0.9,), 3.125)
    rng = np.random.default_rng(5)
    thickness, routing = rng.uniform(2.5, 5, (400, 3)), rng.uniform(5, 13, (400, 6))
    base = dataclasses.replace(chapter_4_finger("power"), compliance_per_n=1e-4, lead_mm=20.0)
    pulls = np.arange(0.25, 20.1, 0.25)
    found = Kernel([base], law).varied(thickness, routing).solve(pulls)
    worst = np.argwhere((found.status & Status.REVERSING) != 0)
    design = base.with_design(thickness[worst[0, 0]], routing[worst[0, 0]])
    path = follow(design, law, pulls)
    assert not path.failed.any()
    ratio, pulled, back = cone(design, law, path)
    assert (ratio <= pulled + 1e-8).all()
    assert (ratio >= -back - 1e-8).all()
    assert (path.slide <= 0).any()


def test_bad_requests_say_what_was_expected() -> None:
    finger = chapter_4_finger("power")
    with pytest.raises(FingerError, match="pulled length or tension"):
        follow(finger, LAW, [1.0], Control.DEFLECTION)
    with pytest.raises(FingerError, match=r"expected a joint 0..2, found 3"):
        follow(finger, LAW, [1.0], contacts=[JointLimit(3, 1.0)])
    with pytest.raises(FingerError, match="normal of length 1"):
        follow(finger, LAW, [1.0], contacts=[Plane((1.0, 1.0), 0.0)])
    with pytest.raises(FingerError, match="reaches the finger's plane"):
        sphere((0.0, 0.0, 30.0), 20.0)
    with pytest.raises(FingerError, match="at most 8"):
        follow(finger, LAW, [1.0], contacts=[JointLimit(0, 1.0)] * 9)
    assert follow(finger, LAW, [7.0, math.nan, 8.0]).status.tolist() == [0, int(Status.BAD_TARGET), 0]
