# SPDX-License-Identifier: Apache-2.0
"""The friction models that were published, shipped as data with where each number stands."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

from softgrip_model.friction.laws import LambdaSign
from softgrip_model.friction.model_file import read_model
from softgrip_model.friction.record import FrictionModel

_DATA = Path(__file__).parent / "data"
#: The pairs of Table 3.2, whose lambda is printed negative although friction falls with tension (docs/friction.md).
TABLE_3_2 = ("twine-tpu", "twine-pla", "braid-tpu", "braid-pla")


def published_ids() -> tuple[str, ...]:
    """Return the ids of the shipped models, sorted."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.yaml")))


@cache
def published(model_id: str, lambda_sign: LambdaSign = LambdaSign.FALLING) -> FrictionModel:
    """Return one shipped model.

    Args:
        model_id: one of `published_ids`.
        lambda_sign: how the negative lambda of Table 3.2 is read (see `LambdaSign`); the other models have one reading.

    Raises:
        ModelFileError: no such model.
    """
    model = read_model(_DATA / f"{model_id}.yaml")
    if lambda_sign is LambdaSign.FALLING or model_id not in TABLE_3_2:
        return model
    alpha, n, epsilon, lam = model.law.coefficients
    law = model.law.with_coefficients((alpha, n, epsilon, -lam))
    return dataclasses.replace(model, id=f"{model_id}-lambda-printed", law=law)
