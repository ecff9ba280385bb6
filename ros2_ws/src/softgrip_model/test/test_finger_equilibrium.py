# SPDX-License-Identifier: Apache-2.0
"""Closings (mode P): the reference's numbers, an independent solver, properties."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import root

from softgrip_model.finger import (
    FRICTIONLESS,
    Control,
    Finger,
    JointModel,
    Kernel,
    MomentLaw,
    Status,
    Strip,
    close,
    follow,
    reason,
)
from softgrip_model.finger.published import (
    OPTIMISED_ROUTING_MM,
    TANGENT_MODULUS_MPA,
    UNIFORM_ROUTING_MM,
    chapter_3_finger,
    chapter_4_finger,
)
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.friction.published import published

LAWS = {
    "none": FRICTIONLESS,
    "capstan": FrictionLaw(Law.CAPSTAN, (0.40,), 3.75),
    "heap": FrictionLaw(Law.HEAP, (0.427, 0.731), 3.75),
    "matte": published("twine-tpu").law,
}
# joint angles [deg] at 10 and 20 mm; actuator tension at 10 and 20 mm, tip tension at 20 mm [N] (reference, l = 10 mm)
CHAPTER_3 = {
    ("none", "uniform"): ((28.535,) * 3, (53.284,) * 3, (4.3645, 7.3810, 7.3810)),
    ("none", "optimised"): ((14.118, 24.254, 41.664), (27.017, 48.145, 76.195), (4.4772, 7.9935, 7.9935)),
    ("capstan", "uniform"): ((35.548, 27.422, 22.409), (77.754, 47.072, 33.637), (5.9502, 13.4868, 4.4613)),
    ("capstan", "optimised"): ((20.764, 27.132, 37.647), (54.441, 54.009, 62.638), (6.3591, 15.7668, 4.7754)),
    ("heap", "uniform"): ((35.905, 27.407, 22.043), (76.052, 48.191, 34.370), (5.9995, 12.6003, 4.5137)),
    ("heap", "optimised"): ((20.922, 27.327, 37.474), (48.998, 54.340, 64.418), (6.3983, 14.0478, 4.7872)),
    ("matte", "uniform"): ((41.204, 26.287, 17.371), (80.525, 47.613, 29.901), (7.1860, 13.4846, 3.7508)),
    ("matte", "optimised"): ((26.411, 29.824, 33.941), (53.160, 57.056, 61.188), (8.4374, 15.7290, 4.5441)),
}
SIGNED, ABSOLUTE = MomentLaw.SIGNED_TANGENT, MomentLaw.ABSOLUTE_TANGENT
CHAPTER_4 = {
    ("power", SIGNED): ((45.317, 23.505, 24.670), (81.666, 47.137, 45.759), (8.3069, 17.5367, 6.7917)),
    ("power", ABSOLUTE): ((47.820, 22.552, 23.986), (83.728, 46.710, 45.102), (7.3779, 14.4452, 5.3478)),
    ("hook", SIGNED): ((5.488, 50.919, 23.015), (12.902, 85.792, 49.214), (9.1299, 20.4539, 9.0797)),
    ("hook", ABSOLUTE): ((4.814, 53.582, 21.216), (10.894, 86.704, 49.393), (7.7935, 16.2212, 6.9304)),
    ("pinch", SIGNED): ((52.286, 2.814, 2.082), (89.216, 22.164, 16.992), (4.0770, 39.3199, 14.6524)),
    ("pinch", ABSOLUTE): ((52.573, 2.343, 1.720), (89.384, 22.484, 16.578), (3.4128, 36.0479, 12.9126)),
}


def check(finger: Finger, law: FrictionLaw, expected: tuple[tuple[float, ...], ...]) -> None:
    at_10, at_20, tensions = expected
    for march in (True, False):
        found = close(finger, law, [10.0, 20.0], march=march)
        assert (found.status & Status.FAILURE == 0).all()
        np.testing.assert_allclose(np.degrees(found.angle_rad[0]), [at_10, at_20], atol=6e-4)
        np.testing.assert_allclose([*found.actuator_tension_n[0], found.tension_n[0, 1, -1]], tensions, atol=6e-5)


@pytest.mark.parametrize(("law", "routing"), CHAPTER_3, ids=str)
def test_chapter_3_reference(law: str, routing: str) -> None:
    finger = chapter_3_finger(UNIFORM_ROUTING_MM if routing == "uniform" else OPTIMISED_ROUTING_MM)
    check(finger, LAWS[law], CHAPTER_3[law, routing])


@pytest.mark.parametrize(("grasp", "moment_law"), CHAPTER_4, ids=str)
def test_chapter_4_reference(grasp: str, moment_law: MomentLaw) -> None:
    finger = chapter_4_finger(grasp, moment_law, stop_moment_nmm=0.0)
    check(finger, published("braid-tpu-chapter4").law, CHAPTER_4[grasp, moment_law])


def test_frictionless_uniform_finger_has_a_closed_form() -> None:
    pulls = np.linspace(0.5, 30.0, 25)
    found = close(chapter_3_finger(UNIFORM_ROUTING_MM), FRICTIONLESS, pulls)
    angle = np.pi / 2 - 2 * np.arcsin(np.sin(np.pi / 4) - pulls / (6 * 8.5))
    stiffness = 21.89 * 13 * 27 / (12 * 10)
    tension = stiffness * angle / (8.5 * np.cos(np.pi / 4 - angle / 2))
    np.testing.assert_allclose(found.angle_rad[0], np.repeat(angle[:, None], 3, axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.actuator_tension_n[0], tension, rtol=1e-9)


# --- the same equilibrium, written down again from the reference's section 2 ------------------------------------------


def point_bends(finger: Finger, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Bends at the points, arms and pulled length, by placing every point in the plane."""
    r, heading, joint = finger.routing_mm, 0.0, np.zeros(2)
    points, arms, pulled = [], [], 0.0

    def frame(angle: float) -> np.ndarray:
        return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])

    for j in range(finger.joints):
        opening = finger.opening_rad[j]
        ahead, aside = math.sin(opening / 2), math.cos(opening / 2)
        before = joint + frame(heading) @ (r[2 * j] * np.array([-ahead, -aside]))
        heading += q[j]
        after = joint + frame(heading) @ (r[2 * j + 1] * np.array([ahead, -aside]))
        gap = float(np.linalg.norm(after - before))
        (ux, uy), (vx, vy) = after - before, before - joint
        arms.append(abs(ux * vy - uy * vx) / gap)
        straight = r[2 * j] ** 2 + r[2 * j + 1] ** 2 - 2 * r[2 * j] * r[2 * j + 1] * math.cos(opening)
        pulled += math.sqrt(straight) - gap
        points += [before, after]
        joint = joint + frame(heading) @ np.array([finger.link_mm[j], 0.0])
    ends = frame(heading) @ np.array([10.0, 0.0])
    line = np.array([points[0] - [10.0, 0.0], *points, points[-1] + ends])
    headings = np.unwrap([-math.atan2(d[1], d[0]) for d in np.diff(line, axis=0)])
    return np.diff(headings), np.array(arms), pulled


def residual(x: np.ndarray, finger: Finger, law: FrictionLaw, pull: float) -> np.ndarray:
    n = finger.joints
    q, tension = x[:n], math.exp(x[n])
    bends, arms, pulled = point_bends(finger, q)
    spans = [tension]
    for bend in bends[::-1]:
        size = math.sqrt(bend**2 + finger.smoothing_rad**2)
        tension *= float(law.ratio(size, tension))
        spans.append(tension)
    spans.reverse()
    a, b, c = finger.strip.modulus_mpa
    moments = []
    for j in range(n):
        k, half, w = q[j] / finger.length_mm[j], finger.thickness_mm[j] / 2, finger.widths_mm[j]
        moments.append(2 * w * (a * k**3 * half**5 / 15 + b * k * abs(k) * half**4 / 8 + c * k * half**3 / 3))
    return np.array([*(m - spans[2 * j + 1] * arms[j] for j, m in enumerate(moments)), pulled - pull])


@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_against_an_independent_solver(joints: int) -> None:
    """scipy.root on the residual above, for random designs of 1 to 6 joints."""
    rng = np.random.default_rng(joints)
    law = published("braid-tpu-chapter4").law
    for _ in range(4):
        finger = Finger(
            link_mm=tuple(rng.uniform(24, 45, joints)),
            thickness_mm=tuple(rng.uniform(2.5, 4.0, joints)),
            length_mm=tuple(rng.uniform(9, 14, joints)),
            routing_mm=tuple(rng.uniform(5, 12, 2 * joints)),
            width_mm=15.0,
            strip_width_mm=tuple(rng.uniform(10, 16, joints)),
            opening_rad=tuple(rng.uniform(1.2, 2.0, joints)),
            strip=Strip(TANGENT_MODULUS_MPA),
            stop_moment_nmm=0.0,
            joint_model=JointModel.HINGE,
        )
        pull = 3.0 * joints
        found = close(finger, law, [pull], march=False)
        assert found.status[0, 0] & Status.FAILURE == 0
        start = np.append(found.angle_rad[0, 0] * 0.9, math.log(found.tension_n[0, 0, -1]) - 0.2)
        other = root(residual, start, args=(finger, law, pull), tol=1e-12)
        assert other.success, other.message
        np.testing.assert_allclose(found.angle_rad[0, 0], other.x[:joints], atol=1e-8)
        assert found.tension_n[0, 0, -1] == pytest.approx(math.exp(other.x[joints]), rel=1e-8)


# --- properties ------------------------------------------------------------------------------------------------------


@pytest.fixture
def power() -> Kernel:
    return Kernel([chapter_4_finger("power")], published("braid-tpu-chapter4").law)


def test_controls_agree(power: Kernel) -> None:
    """Prescribing what another control found gives the same state back."""
    pulls = np.linspace(1.0, 20.0, 12)
    by_length = power.solve(pulls)
    by_tension = power.solve(by_length.actuator_tension_n, Control.TENSION, march=False)
    by_deflection = power.solve(by_length.angle_rad.sum(axis=2), Control.DEFLECTION, march=False)
    for other in (by_tension, by_deflection):
        np.testing.assert_allclose(other.angle_rad, by_length.angle_rad, atol=1e-8)
        np.testing.assert_allclose(other.pulled_mm, by_length.pulled_mm, atol=1e-7)
    np.testing.assert_allclose(by_length.pulled_mm[0], pulls, atol=1e-9)


def test_marching_finds_what_solving_from_nothing_finds(power: Kernel) -> None:
    pulls = np.linspace(0.1, 22.0, 300)
    there, unmarched = power.solve(pulls), power.solve(pulls, march=False)
    np.testing.assert_allclose(there.angle_rad, unmarched.angle_rad, atol=1e-9)
    np.testing.assert_allclose(there.tension_n, unmarched.tension_n, rtol=1e-8)
    assert there.iterations.sum() < 1.35 * len(pulls)


def test_work_done_is_energy_stored_without_friction() -> None:
    """Integral of T dL = bending energy of the linear strips."""
    finger = chapter_3_finger(OPTIMISED_ROUTING_MM)
    pulls = np.linspace(0.0, 18.0, 2001)
    found = close(finger, FRICTIONLESS, pulls)
    work = trapezoid(found.actuator_tension_n[0], pulls)
    stiffness = 21.89 * 13 * 27 / (12 * 10)
    assert work == pytest.approx(0.5 * stiffness * (found.angle_rad[0, -1] ** 2).sum(), rel=1e-6)


def test_friction_only_takes_tension_away() -> None:
    tensions = close(chapter_4_finger("hook"), published("braid-tpu-chapter4").law, np.linspace(1, 20, 20)).tension_n
    assert (np.diff(tensions, axis=2) < 0).all()
    more = close(chapter_4_finger("hook"), FrictionLaw(Law.CAPSTAN, (0.4,), 3.125), [15.0])
    less = close(chapter_4_finger("hook"), FrictionLaw(Law.CAPSTAN, (0.2,), 3.125), [15.0])
    assert more.actuator_tension_n[0, 0] > less.actuator_tension_n[0, 0]


def test_scaling_a_finger_scales_its_lengths() -> None:
    """All lengths twice as long at the same stress: angles stay, forces grow fourfold (Capstan knows no length)."""
    law = FrictionLaw(Law.CAPSTAN, (0.3,), 3.125)
    small = chapter_4_finger("pinch")
    doubled: dict[str, Any] = {
        name: tuple(2 * v for v in getattr(small, name))
        for name in ("link_mm", "thickness_mm", "length_mm", "routing_mm")
    }
    large = dataclasses.replace(small, **doubled, width_mm=30.0, stop_moment_nmm=8 * small.stop_moment_nmm)
    a, b = close(small, law, [6.0, 12.0]), close(large, law, [12.0, 24.0])
    np.testing.assert_allclose(a.angle_rad, b.angle_rad, rtol=1e-9)
    np.testing.assert_allclose(4 * a.tension_n, b.tension_n, rtol=1e-9)
    np.testing.assert_allclose(2 * a.tip_mm, b.tip_mm, atol=1e-9)


def test_tip_is_where_the_links_lead() -> None:
    found = close(chapter_4_finger("hook"), FRICTIONLESS, [12.0])
    at, heading = 0.0 + 0.0j, 0.0
    for length, angle in zip((45.0, 27.0, 23.0), found.angle_rad[0, 0], strict=True):
        heading -= angle
        at += length * np.exp(1j * heading)
    np.testing.assert_allclose(found.tip_mm[0, 0], [at.real, at.imag], atol=1e-12)
    assert found.tip_mm[0, 0, 1] < 0.0  # closing towards -y


def test_the_stop_holds_a_groove_open() -> None:
    law = published("braid-tpu-chapter4").law
    pulls = np.linspace(1.0, 40.0, 80)
    found = close(chapter_4_finger("pinch"), law, pulls)
    reached = ~found.failed[0]
    assert (found.angle_rad[0, reached] < np.pi / 2).all()
    late = pulls > 20.0
    assert (found.status[0, late & reached] & Status.STOP_ENGAGED).all()


def test_elastic_cable_needs_more_pull_for_the_same_angles() -> None:
    law = published("braid-tpu-chapter4").law
    stiff = chapter_4_finger("power")
    soft = dataclasses.replace(stiff, compliance_per_n=1 / 2000.0, lead_mm=200.0)
    a = close(stiff, law, [12.0])
    b = Kernel([soft], law).solve(a.actuator_tension_n, Control.TENSION)
    np.testing.assert_allclose(a.angle_rad, b.angle_rad, atol=1e-8)
    tensions, q = a.tension_n[0, 0], a.angle_rad[0, 0]
    s, r = math.sqrt(0.5), stiff.routing_mm
    lengths = [200.0]
    for j in range(3):
        lengths.append(math.sqrt(r[2 * j] ** 2 + r[2 * j + 1] ** 2 - 2 * r[2 * j] * r[2 * j + 1] * math.sin(q[j])))
        if j < 2:
            dx = stiff.link_mm[j] - s * (r[2 * j + 1] + r[2 * j + 2])
            lengths.append(math.hypot(dx, s * (r[2 * j + 1] - r[2 * j + 2])))
    lengths.append(stiff.link_mm[2] - s * r[5])
    assert b.pulled_mm[0, 0] - 12.0 == pytest.approx(float(np.dot(tensions, lengths)) / 2000.0, rel=1e-7)


def test_thumb_with_two_joints(power: Kernel) -> None:
    thumb = Finger(
        link_mm=(40.0, 30.0), thickness_mm=(2.55, 3.18), length_mm=(10.0, 10.0), routing_mm=(5.38, 5.74, 7.58, 7.91),
        width_mm=15.0, strip=Strip(TANGENT_MODULUS_MPA), base_mm=60.0,
        joint_model=JointModel.HINGE,
    )  # fmt: skip
    law = published("braid-tpu-chapter4").law
    alone = close(thumb, law, [5.0], march=False)
    mixed = Kernel([chapter_4_finger("power"), thumb], law).solve([5.0], march=False)
    np.testing.assert_array_equal(mixed.angle_rad[1, 0, :2], alone.angle_rad[0, 0])
    assert np.isnan(mixed.angle_rad[1, 0, 2])
    np.testing.assert_array_equal(mixed.tension_n[1, 0, :5], alone.tension_n[0, 0])


def test_threads_do_not_change_results() -> None:
    rng = np.random.default_rng(0)
    thickness, routing = rng.uniform(2.5, 5, (100, 3)), rng.uniform(5, 13, (100, 6))
    kernel = Kernel([chapter_4_finger("power")], published("braid-tpu-chapter4").law).varied(thickness, routing)
    pulls = np.linspace(1, 20, 20)
    one, two = kernel.solve(pulls, threads=1), kernel.solve(pulls, threads=2)
    assert one.angle_rad.tobytes() == two.angle_rad.tobytes()
    assert (one.status == two.status).all()


# --- failures --------------------------------------------------------------------------------------------------------


def test_every_element_fails_for_itself() -> None:
    base = chapter_4_finger("power")
    thickness = np.tile(base.thickness_mm, (5, 1))
    routing = np.tile(base.routing_mm, (5, 1))
    thickness[1, 0] = -1.0
    routing[2, 3] = np.nan
    routing[3, 1:3] = 60.0  # longer than the link they share
    found = Kernel([base], published("braid-tpu-chapter4").law).varied(thickness, routing).solve([5.0, 10.0])
    assert (found.status[1:4] == Status.BAD_DESIGN).all()
    assert np.isnan(found.angle_rad[1:4]).all()
    assert np.isnan(found.tip_mm[1:4]).all()
    assert np.isnan(found.tension_n[1:4]).all()
    np.testing.assert_array_equal(found.angle_rad[0], found.angle_rad[4])
    assert np.isfinite(found.angle_rad[[0, 4]]).all()
    assert reason(int(found.status[1, 0])) == "impossible geometry or material"


def test_targets_out_of_reach_and_nonsense(power: Kernel) -> None:
    found = power.solve([math.nan, 60.0, math.inf, -1.0, 0.0], march=False)
    expected = [Status.BAD_TARGET, Status.OUT_OF_REACH, Status.BAD_TARGET, Status.SLACK, Status.SLACK]
    assert found.status[0].tolist() == [int(status) for status in expected]
    assert np.isnan(found.angle_rad[0, :3]).all()
    assert (found.angle_rad[0, 3:] == 0.0).all()
    assert (found.tension_n[0, 3:] == 0.0).all()
    by_tension = power.solve([-1.0, 0.0], Control.TENSION)
    assert by_tension.status[0].tolist() == [int(Status.BAD_TARGET), int(Status.SLACK)]
    assert power.solve([5.0], Control.DEFLECTION).status[0, 0] == Status.OUT_OF_REACH


def test_friction_without_a_value_is_reported() -> None:
    """The printed K blows up at x = 1: alpha (1-n) (r/T)^(1-n) phi = 1."""
    wild = FrictionLaw(Law.MATTE, (3.0, 0.1, 0.1, 0.0), 3.75)
    found = close(chapter_4_finger("power"), wild, [0.05, 5.0], march=False)
    assert (found.status & (Status.FRICTION_BLOW_UP | Status.NOT_CONVERGED)).all()
    assert np.isnan(found.angle_rad).all()


def test_reversing_joints_are_flagged() -> None:
    """A joint that opens again while the cable is pulled: pull_rate against finite differences of the path."""
    finger = chapter_4_finger("power", stop_moment_nmm=1000.0)
    law = FrictionLaw(Law.CAPSTAN, (0.9,), 3.125)
    rng = np.random.default_rng(5)
    kernel = Kernel([finger], law).varied(rng.uniform(2.5, 5, (400, 3)), rng.uniform(5, 13, (400, 6)))
    found = kernel.solve(np.linspace(0.25, 20, 80))
    flagged = (found.status & Status.REVERSING) != 0
    usable = ~found.failed
    assert flagged.any()
    assert (found.pull_rate[usable & ~flagged] > -1e-6).all()
    assert (found.pull_rate[flagged].min(axis=1) < 0.0).all()


def test_ranges_are_flagged(power: Kernel) -> None:
    found = power.solve([1.0, 8.0, 20.0])
    outside = (found.status[0] & Status.TENSION_OUTSIDE) != 0
    assert outside.tolist() == [True, False, True]  # 1.0 N, 6.1 .. 3.1 N, 14.4 N; calibrated 1.96 .. 9.81 N


def test_wrap_angles_and_strains_beyond_what_was_measured_are_flagged() -> None:
    """Bends above the calibrated angle; surface strain h q / (2 l) above the largest measured; on a path as well."""
    law = dataclasses.replace(published("braid-tpu-chapter4").law, angle_range=(math.radians(10.0), 0.5))
    finger = chapter_4_finger("power", stop_moment_nmm=0.0)
    finger = dataclasses.replace(finger, strip=dataclasses.replace(finger.strip, max_strain=0.12))
    pulls = np.linspace(1.0, 18.0, 35)
    found, path = close(finger, law, pulls), follow(finger, law, pulls)
    strain = found.angle_rad[0] * np.array(finger.thickness_mm) / (2 * np.array(finger.length_mm))
    for flag, outside in (
        (Status.ANGLE_OUTSIDE, (np.abs(found.phi_rad[0]) > 0.5).any(axis=1)),
        (Status.STRAIN_OUTSIDE, (strain > 0.12).any(axis=1)),
    ):
        assert 0 < outside.sum() < len(pulls)
        np.testing.assert_array_equal((found.status[0] & flag) != 0, outside)
        np.testing.assert_array_equal((path.status & flag) != 0, outside)


def test_no_joint_turns_against_its_cable() -> None:
    """At high tension Newton from nothing also finds a branch on which a cable has passed its apex, at -100 degrees."""
    rng = np.random.default_rng(1)
    thickness, routing = rng.uniform(2.5, 5, (4000, 3))[:700], rng.uniform(5, 13, (4000, 6))[:700]
    kernel = Kernel([chapter_4_finger("power")], published("braid-tpu-chapter4").law).varied(thickness, routing)
    for march in (True, False):
        found = kernel.solve([46.57, 57.71, 80.0], Control.TENSION, march=march)
        assert (found.angle_rad[~found.failed] > 0.0).all()
        assert found.failed.mean() < 0.01
