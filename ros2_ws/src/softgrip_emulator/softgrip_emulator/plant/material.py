# SPDX-License-Identifier: Apache-2.0
"""What a fibre of printed TPU resists with: the data sheet's tension, and the compression that follows from it.

A data sheet measures tension only. Compression is taken from it by the symmetry of true stress over logarithmic strain
(Hencky's material; L. Anand, J. Appl. Mech. 46 (1979) 78, holds for moderate stretches of rubbers and polymers): a
fibre shortened to 1 - e carries what one stretched to 1/(1 - e) carries, with the signs and areas of shortening.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_model.profile import Material

    Array = NDArray[np.float64]

_COMPRESSED_TO: Final = 0.35
"""Compression is described up to here; a strip of h = l / 2 reaches it when it is bent by 80 degrees."""


@dataclass(frozen=True)
class FibreLaw:
    """Nominal stress = e (c1 + c2 e + c3 e^2) of the size e of a strain, (3,) [Pa] for each sign."""

    tension_pa: Array
    compression_pa: Array


def fibre_law(material: Material) -> FibreLaw:
    """Return the law of a data sheet whose tangent modulus is a e^2 + b e + c."""
    tension = np.array(
        [material.modulus_constant_pa, material.modulus_linear_pa / 2.0, material.modulus_quadratic_pa / 3.0]
    )
    shortened = np.linspace(0.01, _COMPRESSED_TO, 60)
    stretched = shortened / (1.0 - shortened)
    stress = _powers(stretched) @ tension * (1.0 + stretched) / (1.0 - shortened)
    # The modulus at rest is the same on both sides; the other two coefficients follow the curve.
    powers = _powers(shortened)
    rest, *_ = np.linalg.lstsq(powers[:, 1:], stress - powers[:, 0] * tension[0], rcond=None)
    return FibreLaw(tension, np.array([tension[0], *rest]))


def _powers(strain: Array) -> Array:
    """(n, 3) e, e^2, e^3."""
    return np.asarray(strain[:, None] ** np.arange(1, 4))
