# SPDX-License-Identifier: Apache-2.0
"""Groove geometry, cable bends and bending moments: the reference's numbers, closed forms, finite differences."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from softgrip_model.finger import Finger, FingerError, MomentLaw, Strip
from softgrip_model.finger.parts import bends, groove, strip_moment
from softgrip_model.finger.published import OPTIMISED_ROUTING_MM, TANGENT_MODULUS_MPA, chapter_3_finger


@pytest.mark.parametrize(
    ("entry", "leave", "angle_deg", "span", "arm"),
    [(8.5, 8.5, 0, 12.0208, 6.0104), (8.5, 8.5, 45, 6.5056, 7.8530), (5.23, 4, 30, 4.7363, 3.8252),
     (12, 10.96, 60, 6.0268, 10.9113)],
)  # fmt: skip
def test_groove_reference(entry: float, leave: float, angle_deg: float, span: float, arm: float) -> None:
    found = groove(entry, leave, math.radians(angle_deg))
    assert found.span_mm == pytest.approx(span, abs=6e-5)
    assert found.arm_mm == pytest.approx(arm, abs=6e-5)


@pytest.mark.parametrize("opening", [math.radians(70), math.pi / 2, math.radians(120)])
@pytest.mark.parametrize(("entry", "leave"), [(5.0, 5.0), (4.0, 12.0), (12.0, 5.0)])
def test_groove_is_the_triangle_drawn(opening: float, entry: float, leave: float) -> None:
    """Span and direction against points placed in the plane; slopes against central differences."""
    half, angle = opening / 2, 0.6
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    before = entry * np.array([-math.sin(half), -math.cos(half)])
    after = turn @ (leave * np.array([math.sin(half), -math.cos(half)]))
    span = after - before
    found = groove(entry, leave, angle, opening)
    assert found.span_mm == pytest.approx(np.hypot(*span), rel=1e-13)
    assert found.direction_rad == pytest.approx(math.atan2(span[1], span[0]), abs=1e-13)
    step = 1e-6
    low, high = groove(entry, leave, angle - step, opening), groove(entry, leave, angle + step, opening)
    assert -found.arm_mm == pytest.approx((high.span_mm - low.span_mm) / (2 * step), abs=1e-8)
    assert found.arm_slope == pytest.approx((high.arm_mm - low.arm_mm) / (2 * step), abs=1e-8)
    assert found.direction_slope == pytest.approx((high.direction_rad - low.direction_rad) / (2 * step), abs=1e-8)


def test_bends_reference() -> None:
    finger = chapter_3_finger(OPTIMISED_ROUTING_MM)
    straight = [-7.5906, 12.2544, -4.0281, 8.2266, -11.4558, 2.5935]
    closed = [2.0029, 32.6609, 6.2440, 17.9544, -6.9522, 8.0899]
    np.testing.assert_allclose(np.degrees(bends(finger, [0, 0, 0])), straight, atol=6e-5)
    np.testing.assert_allclose(np.degrees(bends(finger, np.radians([30, 20, 10]))), np.array(closed), atol=6e-5)


def test_bends_add_up_to_the_joint_angles() -> None:
    """The cable leaves parallel to the last link: it has turned as far as the finger."""
    finger = chapter_3_finger((6.0, 9.0, 4.5, 12.0, 10.0, 5.0))
    angles = [0.3, 0.9, 0.55]
    assert bends(finger, angles).sum() == pytest.approx(sum(angles), abs=1e-13)
    with pytest.raises(FingerError, match="found 2 for 3 joints"):
        bends(finger, [0.1, 0.2])


# h, l [mm], q [deg] -> linear, Eq 4.3 as a tangent, |strain| tangent, neutral axis, Eq 4.3 as a secant [N mm];
# w = 15 mm (reference table)
MOMENTS = {
    (3, 5, 60): (154.7, 170.1, 95.7, 132.6, 200.8),
    (3, 10, 60): (77.4, 79.3, 60.7, 74.1, 83.1),
    (3, 5, 90): (232.1, 283.9, 116.6, 178.1, 387.6),
    (5, 10, 60): (358.2, 382.9, 239.4, 320.2, 432.2),
}


def strip_finger(thickness: float, length: float, law: MomentLaw) -> Finger:
    return Finger(
        link_mm=(35.0,), thickness_mm=(thickness,), length_mm=(length,), routing_mm=(8.0, 8.0), width_mm=15.0,
        strip=Strip(TANGENT_MODULUS_MPA, law),
    )  # fmt: skip


@pytest.mark.parametrize("case", MOMENTS, ids=str)
@pytest.mark.parametrize("law", MomentLaw)
def test_moment_reference(case: tuple[int, int, int], law: MomentLaw) -> None:
    thickness, length, angle = case
    expected = MOMENTS[case][list(MomentLaw).index(law)]
    moment, _, _ = strip_moment(strip_finger(thickness, length, law), 0, math.radians(angle))
    # the table's last digit; its neutral-axis column was found with the axis on a grid
    assert moment == pytest.approx(expected, abs=0.11 if law is MomentLaw.NEUTRAL_AXIS else 0.051)


def stress(strain: float, *, absolute: bool) -> float:
    a, b, c = TANGENT_MODULUS_MPA
    size = abs(strain) if absolute else strain
    return a * strain**3 / 3 + b * size * strain / 2 + c * strain


@pytest.mark.parametrize("angle", [0.15, 0.7, 1.3])
def test_moments_are_integrals_of_stress(angle: float) -> None:
    thickness, length, width = 3.4, 9.0, 15.0
    half, curvature = thickness / 2, angle / length

    def moment(shift: float, *, absolute: bool) -> float:
        value, _ = quad(lambda y: width * stress(curvature * y - shift, absolute=absolute) * y, -half, half)
        return float(value)

    def axial(shift: float) -> float:
        return float(quad(lambda y: stress(curvature * y - shift, absolute=False), -half, half)[0])

    absolute, _, _ = strip_moment(strip_finger(thickness, length, MomentLaw.ABSOLUTE_TANGENT), 0, angle)
    assert absolute == pytest.approx(moment(0.0, absolute=True), rel=1e-9)
    neutral, _, _ = strip_moment(strip_finger(thickness, length, MomentLaw.NEUTRAL_AXIS), 0, angle)
    assert neutral == pytest.approx(moment(brentq(axial, -0.5, 0.5, xtol=1e-15), absolute=False), rel=1e-9)


def test_the_signed_secant_is_equation_4_2() -> None:
    """K q with K = w / l times the integral of E(e) y^2 dy, e = k y."""
    thickness, length, width, angle = 3.4, 9.0, 15.0, 0.7
    a, b, c = TANGENT_MODULUS_MPA
    curvature = angle / length
    integral, _ = quad(
        lambda y: (a * (curvature * y) ** 2 + b * curvature * y + c) * y**2, -thickness / 2, thickness / 2
    )
    moment, _, _ = strip_moment(strip_finger(thickness, length, MomentLaw.SIGNED_SECANT), 0, angle)
    assert moment == pytest.approx(width / length * integral * angle, rel=1e-12)


@pytest.mark.parametrize("law", MomentLaw)
@pytest.mark.parametrize("angle", [-0.8, 0.05, 1.2])
def test_moment_slopes_and_symmetry(law: MomentLaw, angle: float) -> None:
    finger = strip_finger(3.1, 9.0, law)
    value, slope, thickness_slope = strip_moment(finger, 0, angle)
    step = 1e-5
    numeric = (strip_moment(finger, 0, angle + step)[0] - strip_moment(finger, 0, angle - step)[0]) / (2 * step)
    assert slope == pytest.approx(numeric, rel=1e-7)
    thick, thin = (dataclasses.replace(finger, thickness_mm=(3.1 + s,)) for s in (step, -step))
    numeric = (strip_moment(thick, 0, angle)[0] - strip_moment(thin, 0, angle)[0]) / (2 * step)
    assert thickness_slope == pytest.approx(numeric, rel=1e-7)
    assert strip_moment(finger, 0, -angle)[0] == pytest.approx(-value, rel=1e-13)


def test_impossible_fingers_say_what_is_wrong() -> None:
    good = chapter_3_finger((8.5,) * 6)
    changes: list[tuple[dict[str, Any], str]] = [
        ({"thickness_mm": (3.0, -1.0, 3.0)}, r"thickness_mm\[1\]: expected > 0, found -1.0"),
        ({"length_mm": (10.0, 10.0)}, "length_mm: expected 3 values, found 2"),
        ({"routing_mm": (8.5,) * 5}, "routing_mm: expected 6 values, found 5"),
        ({"routing_mm": (8.5, 30.0, 30.0, 8.5, 8.5, 8.5)}, r"link_mm\[0\]: 35.0 is shorter than"),
        ({"width_mm": math.nan}, r"widths_mm\[0\]: expected > 0, found nan"),
        ({"opening_rad": (3.5,) * 3}, r"opening_rad\[0\]: expected between the stop's margin and pi"),
        ({"thickness_mm": ()}, "expected 1 to 6 joints, found 0"),
    ]
    for change, message in changes:
        with pytest.raises(FingerError, match=message):
            dataclasses.replace(good, **change)
