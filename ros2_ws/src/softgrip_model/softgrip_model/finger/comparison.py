# SPDX-License-Identifier: Apache-2.0
"""One finger under every friction law, as in Fig 3.6."""

from __future__ import annotations

import math

import numpy as np

from softgrip_model.finger.design import FRICTIONLESS
from softgrip_model.friction.fit import fit
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.friction.measurements import measurements


def laws_side_by_side(law: FrictionLaw) -> dict[str, FrictionLaw]:
    """Return the law with the simpler ones that fit it best over its calibrated range, and none at all.

    The simpler laws are fitted to the nine points of the thesis' plan (three angles, three loads) on the law itself:
    they are what somebody with the same measurements and a simpler law would use.
    """
    angles = np.linspace(*_finite(law.angle_range, (math.radians(10.0), math.radians(90.0))), 3)
    tensions = np.linspace(*_finite(law.tension_range, (1.962, 9.81)), 3)
    angle, tension = (grid.ravel() for grid in np.meshgrid(angles, tensions))
    points = measurements(angle, tension, tension * law.ratio(angle, tension), source=f"nine points of {law.law}")
    found = {"no friction": FRICTIONLESS}
    for simpler in (Law.CAPSTAN, Law.HEAP, Law.MATTE):
        if simpler is law.law:
            found[str(simpler)] = law
            break
        found[str(simpler)] = fit(points, simpler, radius_mm=law.radius_mm).law
    return found


def _finite(given: tuple[float, float], otherwise: tuple[float, float]) -> tuple[float, float]:
    return given if all(map(math.isfinite, given)) else otherwise
