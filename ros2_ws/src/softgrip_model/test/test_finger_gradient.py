# SPDX-License-Identifier: Apache-2.0
"""Exact sensitivities against central differences of the solver, and against each other."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from softgrip_model.finger import Control, Finger, FingerError, JointModel, Kernel, MomentLaw, Status
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_model.friction.published import published
from softgrip_testing.finger_gradients import differences, rows, uneven_finger

finger = functools.partial(uneven_finger, JointModel.HINGE)
LAWS = {
    "matte": published("braid-tpu-chapter4").law,
    "matte exact": dataclasses.replace(published("twine-tpu").law, k_reading=KReading.EXACT),
    "matte limit": dataclasses.replace(published("twine-tpu").law, k_reading=KReading.LIMIT),
    "heap": FrictionLaw(Law.HEAP, (0.427, 0.731), 3.75),
    "capstan": FrictionLaw(Law.CAPSTAN, (0.36,), 3.75),
}


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
