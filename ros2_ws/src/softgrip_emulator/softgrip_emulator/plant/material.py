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

POISSON: Final = 0.45
"""Of printed TPU: nearly incompressible, less what its pores take (softgrip_model assumes 0.3)."""
_DATA_SHEET_AFTER_S: Final = 10.0
"""A tensile test at some per cent of strain takes about so long."""
_ACTIVATION_J_PER_MOL: Final = 15.5e3
_GAS_J_PER_MOL_K: Final = 8.314
_DATA_SHEET_C: Final = 23.0
_SOFTENING_PER_K: Final = 0.01
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


@dataclass(frozen=True)
class Relaxation:
    """Stress relaxation of a batch as Prony's series.

    Attributes:
        share: (4,) of the stress at once. time_s: (4,).
        at_once: stress at once over that of the data sheet.
    """

    share: Array
    time_s: Array
    at_once: float


def relaxation(rng: np.random.Generator) -> Relaxation:
    """Draw how a batch relaxes: as time to the power -m from 0.1 s to some minutes, one term for each decade.

    TPU creeps as a power of time with m = 0.054 to 0.056 when it is dry and cool, more when it is moist or warm
    (C. Pichler, S. Oberparleiter, R. Lackner, Polymers 15 (2023) 3770, table of appendix B).
    """
    exponent = rng.uniform(0.05, 0.075)
    time_s = np.array([0.3, 3.0, 30.0, 300.0])
    # What each decade takes of what the one before has left.
    left = 10.0 ** (-exponent * np.arange(5))
    share = left[:-1] - left[1:]
    at_data_sheet = 1.0 - float(share @ (1.0 - np.exp(-_DATA_SHEET_AFTER_S / time_s)))
    return Relaxation(share, time_s, 1.0 / at_data_sheet)


def in_room(temperature_c: float) -> tuple[float, float]:
    """Return how stiff printed TPU is at a temperature, and how fast it relaxes, against 23 degC [1].

    Relaxation is shifted by Arrhenius' law with the 15.5 kJ/mol that Pichler et al. (2023) found for the rearrangement
    of hydrogen bonds; the modulus falls by 1 % a kelvin (assumption, of the order of data sheets' curves of soft TPU
    about room temperature).
    """
    inverse_k = 1.0 / (273.15 + _DATA_SHEET_C) - 1.0 / (273.15 + temperature_c)
    pace = np.exp(_ACTIVATION_J_PER_MOL / _GAS_J_PER_MOL_K * inverse_k)
    return float(np.exp(-_SOFTENING_PER_K * (temperature_c - _DATA_SHEET_C))), float(pace)


def _powers(strain: Array) -> Array:
    """(n, 3) e, e^2, e^3."""
    return np.asarray(strain[:, None] ** np.arange(1, 4))
