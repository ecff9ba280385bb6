# SPDX-License-Identifier: Apache-2.0
"""A friction model from outside is computed with only when every number of it can be true."""

from __future__ import annotations

import hashlib
import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_model.friction.acceptance import accept, model_digest
from softgrip_model.friction.errors import LawError
from softgrip_model.friction.laws import LambdaSign
from softgrip_model.friction.published import published, published_ids

STDDEV = np.array([0.02, 0.03, 0.01, 0.002])


def matte(**changes: Any) -> SimpleNamespace:
    """The model of chapter 4 as a message carries it, with some fields changed."""
    fields: dict[str, Any] = {
        "id": "rig-1",
        "law": "matte",
        "k_reading": "printed",
        "coefficient_names": ["alpha", "n", "epsilon", "lambda"],
        "coefficients": [0.27049, 0.82038, 0.06483, 0.00851],
        "covariance": np.diag(STDDEV**2).ravel().tolist(),
        "cable_radius": 0.000125,
        "surface_radius": 0.003,
        "angle_range": [0.1745, 1.5708],
        "tension_range": [1.962, 9.81],
        "digest": "",
    }
    return SimpleNamespace(**(fields | changes))


def capstan(mu: float, **changes: Any) -> SimpleNamespace:
    return matte(law="capstan", coefficient_names=["mu"], coefficients=[mu], covariance=[], **changes)


def test_a_sound_model_is_accepted_with_its_numbers() -> None:
    accepted = accept(matte())
    assert accepted.law.coefficients == (0.27049, 0.82038, 0.06483, 0.00851)
    assert accepted.law.radius_mm == pytest.approx(3.125)
    assert accepted.covariance is not None
    assert np.sqrt(np.diag(accepted.covariance)) == pytest.approx(STDDEV)


@pytest.mark.parametrize("sign", LambdaSign)
@pytest.mark.parametrize("name", published_ids())
def test_every_published_model_is_accepted(name: str, sign: LambdaSign) -> None:
    model = published(name, sign)
    accept(
        matte(
            law=str(model.law.law),
            coefficient_names=list(model.law.names),
            coefficients=list(model.law.coefficients),
            covariance=[],
            cable_radius=model.cable_radius_m,
            surface_radius=model.surface_radius_m,
        )
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"law": "euler"}, "expected a law of capstan, heap, matte"),
        ({"k_reading": "guessed"}, "a reading of printed, limit, exact"),
        ({"coefficient_names": ["alpha", "n"]}, "expected coefficients alpha, n, epsilon, lambda"),
        ({"coefficient_names": ["alpha", "n", "epsilon", "epsilon"]}, "expected coefficients alpha, n, epsilon"),
        ({"coefficients": [0.27, 0.8, 0.06]}, "found 3 numbers"),
        ({"coefficients": [-0.27, 0.8, 0.06, 0.008]}, "<= alpha <= 3, found -0.27"),
        ({"coefficients": [1e300, 0.8, 0.06, 0.008]}, r"<= alpha <= 3, found 1e\+300"),
        ({"coefficients": [0.27, 1.0, 0.06, 0.008]}, "<= n <= 0.999, found 1"),
        ({"coefficients": [0.27, 0.8, math.nan, 0.008]}, "<= epsilon <= 2, found nan"),
        ({"coefficients": [0.27, 0.8, 0.06, math.inf]}, "<= lambda <= 0.5, found inf"),
        ({"cable_radius": math.nan}, "radii"),
        ({"cable_radius": -0.002}, "radii"),
        ({"surface_radius": 1.0}, "radii"),
        ({"angle_range": [1.5, 0.1]}, "angle_range: expected 0 <= low < high"),
        ({"tension_range": [1.9, math.inf]}, "tension_range: expected 0 <= low < high"),
        ({"tension_range": [math.nan, 9.0]}, "tension_range: expected 0 <= low < high"),
        ({"covariance": [1.0] * 9}, "expected 16 finite numbers or none, found 9"),
        ({"covariance": [math.nan] * 16}, "expected 16 finite numbers or none"),
        ({"covariance": np.diag([-1.0, 1.0, 1.0, 1.0]).ravel().tolist()}, "no negative variance"),
        ({"covariance": (np.eye(4) + np.eye(4, k=1)).ravel().tolist()}, "expected a symmetric matrix"),
        ({"covariance": (2.0 * np.ones((4, 4)) - np.eye(4)).ravel().tolist()}, "no negative variance"),
    ],
)
def test_numbers_that_no_cable_has_are_refused_by_name(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(LawError, match=expected) as refused:
        accept(matte(**changes))
    assert "friction model 'rig-1'" in str(refused.value)
    assert "rig/calibrate" in str(refused.value)


@pytest.mark.parametrize("mu", [0.0, -1.0, 2.1, 1e300, math.nan, math.inf])
def test_a_capstan_law_has_a_friction_between_nothing_and_rubber_on_rubber(mu: float) -> None:
    accept(capstan(0.3))
    accept(capstan(2.0))
    with pytest.raises(LawError, match="mu"):
        accept(capstan(mu))


def test_the_order_of_the_coefficients_in_the_message_does_not_matter() -> None:
    order = [2, 0, 3, 1]
    covariance = np.diag(STDDEV**2) + 1e-6
    sound = matte(covariance=covariance.ravel().tolist())
    shuffled = matte(
        coefficient_names=[sound.coefficient_names[i] for i in order],
        coefficients=[sound.coefficients[i] for i in order],
        covariance=covariance[np.ix_(order, order)].ravel().tolist(),
    )
    assert accept(shuffled).digest == accept(sound).digest
    assert accept(shuffled).law == accept(sound).law


def test_the_digest_is_the_sha_256_of_the_numbers() -> None:
    text = json.dumps(
        {
            "angle_range": [(0.1745).hex(), (1.5708).hex()],
            "coefficients": [(0.3).hex()],
            "covariance": [],
            "k_reading": "printed",
            "law": "capstan",
            "radii": [(0.000125).hex(), (0.003).hex()],
            "tension_range": [(1.962).hex(), (9.81).hex()],
        }
    )
    assert accept(capstan(0.3)).digest == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize("field", ["coefficients", "covariance", "angle_range", "tension_range"])
def test_one_number_that_changes_by_one_bit_is_another_digest(field: str) -> None:
    changed = list(getattr(matte(), field))
    changed[0] = math.nextafter(changed[0], math.inf)
    assert accept(matte(**{field: changed})).digest != accept(matte()).digest


def test_the_id_is_no_part_of_the_digest_and_the_split_of_the_radius_is() -> None:
    assert accept(matte(id="another")).digest == accept(matte()).digest
    assert accept(matte(cable_radius=0.000225, surface_radius=0.0029)).digest != accept(matte()).digest


def test_a_digest_of_other_numbers_is_refused() -> None:
    accept(matte(digest=accept(matte()).digest))
    with pytest.raises(LawError, match="expected the digest of its numbers"):
        accept(matte(digest=accept(capstan(0.3)).digest))


def test_a_published_model_and_its_message_have_the_same_digest() -> None:
    model = published("braid-tpu")
    digest = model_digest(model.law, model.covariance, model.cable_radius_m, model.surface_radius_m)
    message = matte(
        coefficients=list(model.law.coefficients),
        covariance=[],
        angle_range=list(model.law.angle_range),
        tension_range=list(model.law.tension_range),
    )
    assert accept(message).digest == digest


@given(st.lists(st.floats(), min_size=4, max_size=4), st.lists(st.floats(), max_size=16))
def test_whatever_numbers_come_they_are_accepted_finite_or_refused(
    coefficients: list[float], covariance: list[float]
) -> None:
    try:
        accepted = accept(matte(coefficients=coefficients, covariance=covariance))
    except LawError:
        return
    assert all(map(math.isfinite, accepted.law.coefficients))
    assert accepted.covariance is None or np.isfinite(accepted.covariance).all()
