# SPDX-License-Identifier: Apache-2.0
"""Mode F's constants are what the study's fingers give, and the study's mesh is CalculiX'."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from softgrip_model.finger.flexure import FLEXURE_STUDY
from softgrip_testing.calculix_flexures import FITTED_OTHER_SEEDS, FITTED_SEEDS, closings, finger_of
from softgrip_testing.scripts import load_script

FOLDER = Path(__file__).resolve().parents[4] / "tools" / "docs"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    sys.path.insert(0, str(FOLDER))
    try:
        return load_script(FOLDER / "flexure_study.py")
    finally:
        sys.path.remove(str(FOLDER))


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_fit_gives_the_constants(study: ModuleType) -> None:
    """From its own start; what is shipped is rounded to three digits."""
    np.testing.assert_allclose(FLEXURE_STUDY.constants, study.fit().constants, rtol=2.6e-3)


def test_no_finger_of_calculix_is_fitted_to(study: ModuleType) -> None:
    with np.load(study.STUDY_FILE) as fitted:
        seeds = {int(seed) for seed in fitted}
    assert seeds == {*FITTED_SEEDS, *FITTED_OTHER_SEEDS}
    assert not seeds & {one.seed for one in closings()}


@pytest.mark.parametrize("seed", [pytest.param(2003, marks=pytest.mark.long), 2007, 3005])
def test_the_mesh_closes_as_calculix_does(study: ModuleType, seed: int) -> None:
    """At the same tensions; the first and the last of them are the furthest off within the bounds and of the others."""
    (one,) = (one for one in closings() if one.seed == seed)
    pulled_mm, tip_mm = study.mesh_beside_calculix(one)
    assert pulled_mm < 0.05
    assert tip_mm < 0.0025 * one.finger.length_from_joint_mm


@pytest.mark.long
@pytest.mark.parametrize("seed", [FITTED_SEEDS[0], FITTED_OTHER_SEEDS[0]])
def test_the_studys_fingers_are_the_meshes(study: ModuleType, seed: int) -> None:
    with np.load(study.STUDY_FILE) as fitted:
        states = fitted[str(seed)]
    np.testing.assert_allclose(study.mesh_states(finger_of(seed), float(states[-1, 0])), states, rtol=1e-6)
