# SPDX-License-Identifier: Apache-2.0
"""Exact sensitivities against central differences of the solver, and against each other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from softgrip_model.finger import Control, Finger, FingerError, JointModel, Kernel, MomentLaw, Solution, Status, Strip
from softgrip_model.finger.published import TANGENT_MODULUS_MPA, chapter_4_finger
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_model.friction.published import published

LAWS = {
    "matte": published("braid-tpu-chapter4").law,
    "matte exact": dataclasses.replace(published("twine-tpu").law, k_reading=KReading.EXACT),
    "matte limit": dataclasses.replace(published("twine-tpu").law, k_reading=KReading.LIMIT),
    "heap": FrictionLaw(Law.HEAP, (0.427, 0.731), 3.75),
    "capstan": FrictionLaw(Law.CAPSTAN, (0.36,), 3.75),
}


def finger(*, joints: int = 3, elastic: bool = False, moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT) -> Finger:
    """A design off the kinks of |phi| and of the friction's clamp."""
    return Finger(
        link_mm=(45.0, 27.0, 30.0, 28.0)[:joints],
        thickness_mm=(2.7, 3.1, 3.4, 3.0)[:joints],
        length_mm=(10.0, 9.5, 11.0, 10.0)[:joints],
        routing_mm=(6.1, 7.3, 8.2, 9.4, 10.5, 11.6, 8.0, 9.0)[: 2 * joints],
        width_mm=15.0,
        strip=Strip(TANGENT_MODULUS_MPA, moment_law),
        opening_rad=(1.7, 1.4, 1.6, 1.5)[:joints],
        compliance_per_n=5e-4 if elastic else 0.0,
        lead_mm=120.0,
        base_mm=20.0,
        joint_model=JointModel.HINGE,
    )


def rows(solution: Solution) -> np.ndarray:
    """What the gradient's rows are derivatives of, (n + 5,)."""
    return np.concatenate(
        [
            solution.angle_rad[0, 0],
            solution.tip_mm[0, 0],
            [solution.tension_n[0, 0, 0], solution.tension_n[0, 0, -1], solution.pulled_mm[0, 0]],
        ]
    )


def differences(build: object, at: np.ndarray, step: float) -> np.ndarray:
    """Fourth-order central differences of `build(x)` (a function to rows) in every component of `at`."""
    columns = []
    for i in range(len(at)):
        shift = np.zeros(len(at))
        shift[i] = step
        f = [build(at + k * shift) for k in (-2, -1, 1, 2)]  # type: ignore[operator]
        columns.append((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * step))
    return np.stack(columns, axis=1)


TARGETS = {Control.PULLED_LENGTH: 13.0, Control.TENSION: 8.0, Control.DEFLECTION: 1.9}


def assert_close(exact: np.ndarray, numeric: np.ndarray) -> None:
    scale = np.abs(numeric).max(axis=1, keepdims=True) + 1e-3
    np.testing.assert_allclose(exact / scale, numeric / scale, atol=1e-6)


@pytest.mark.parametrize("elastic", [False, True], ids=["stiff", "elastic"])
@pytest.mark.parametrize("control", Control)
@pytest.mark.parametrize("name", LAWS)
def test_gradient_against_differences(name: str, control: Control, *, elastic: bool) -> None:
    design, law, target = finger(elastic=elastic), LAWS[name], TARGETS[control]

    def solved(f: Finger, law: FrictionLaw, target: float) -> np.ndarray:
        return rows(Kernel([f], law).solve([target], control, march=False))

    exact = Kernel([design], law).solve([target], control, march=False, gradient=True).gradient
    assert exact is not None
    h, r, c = (np.array(v) for v in (design.thickness_mm, design.routing_mm, law.coefficients))
    assert_close(exact.thickness[0, 0], differences(lambda x: solved(design.with_design(x, r), law, target), h, 1e-3))
    assert_close(exact.routing[0, 0], differences(lambda x: solved(design.with_design(h, x), law, target), r, 1e-3))
    assert_close(exact.friction[0, 0], differences(lambda x: solved(design, law.with_coefficients(x), target), c, 1e-4))
    assert_close(
        exact.target[0, 0][:, None], differences(lambda x: solved(design, law, x[0]), np.array([target]), 1e-3)
    )

    def stiffer(x: np.ndarray) -> np.ndarray:
        a, b, e = design.strip.modulus_mpa
        strip = dataclasses.replace(design.strip, modulus_mpa=(a * x[0], b * x[0], e * x[0]))
        return solved(dataclasses.replace(design, strip=strip), law, target)

    assert_close(exact.stiffness[0, 0][:, None], differences(stiffer, np.ones(1), 1e-4))


@pytest.mark.parametrize("moment_law", MomentLaw)
@pytest.mark.parametrize("joints", [1, 2, 4])
def test_gradient_for_other_joints_and_moments(joints: int, moment_law: MomentLaw) -> None:
    design, law = finger(joints=joints, moment_law=moment_law), LAWS["matte"]
    target = 4.0 * joints
    exact = Kernel([design], law).solve([target], march=False, gradient=True).gradient
    assert exact is not None
    h, r = np.array(design.thickness_mm), np.array(design.routing_mm)

    def solved(h: np.ndarray, r: np.ndarray) -> np.ndarray:
        return rows(Kernel([design.with_design(h, r)], law).solve([target], march=False))

    assert_close(exact.thickness[0, 0], differences(lambda x: solved(x, r), h, 1e-3))
    assert_close(exact.routing[0, 0], differences(lambda x: solved(h, x), r, 1e-3))


def test_gradient_inside_the_stop() -> None:
    design, law = chapter_4_finger("pinch"), LAWS["matte"]
    found = Kernel([design], law).solve([20.0], march=False, gradient=True)
    assert found.status[0, 0] & Status.STOP_ENGAGED
    h, r = np.array(design.thickness_mm), np.array(design.routing_mm)
    numeric = differences(lambda x: rows(Kernel([design.with_design(h, x)], law).solve([20.0], march=False)), r, 2e-4)
    assert found.gradient is not None
    assert_close(found.gradient.routing[0, 0], numeric)


def test_what_is_prescribed_does_not_move() -> None:
    for control, row in ((Control.PULLED_LENGTH, -1), (Control.TENSION, -3)):
        found = Kernel([finger()], LAWS["matte"]).solve([TARGETS[control]], control, gradient=True)
        assert found.gradient is not None
        expected = np.zeros(found.gradient.values.shape[-1])
        expected[0] = 1.0
        np.testing.assert_allclose(found.gradient.values[0, 0, row], expected, atol=1e-9)


def test_failed_elements_have_no_gradient() -> None:
    found = Kernel([finger()], LAWS["matte"]).solve([10.0, 90.0, 0.0], gradient=True)
    assert found.gradient is not None
    assert np.isfinite(found.gradient.values[0, 0]).all()
    assert np.isnan(found.gradient.values[0, 1:]).all()


def test_gradients_of_a_mixed_batch_sit_in_their_columns() -> None:
    law = LAWS["matte"]
    fingers = [finger(joints=3), finger(joints=2)]
    mixed = Kernel(fingers, law).solve([6.0], march=False, gradient=True).gradient
    alone = Kernel(fingers[1:], law).solve([6.0], march=False, gradient=True).gradient
    assert mixed is not None
    assert alone is not None
    np.testing.assert_array_equal(mixed.routing[1, 0, :2, :4], alone.routing[0, 0, :2])
    np.testing.assert_array_equal(mixed.thickness[1, 0, 3:, :2], alone.thickness[0, 0, 2:])
    np.testing.assert_array_equal(mixed.friction[1, 0, :2], alone.friction[0, 0, :2])
    assert np.isnan(mixed.routing[1, 0, :, 4:]).all()


def test_laws_of_different_kinds_have_no_common_gradient() -> None:
    kernel = Kernel([finger(), finger()], [LAWS["matte"], LAWS["heap"]])
    with pytest.raises(FingerError, match="friction laws of one kind"):
        kernel.solve([5.0], gradient=True)
