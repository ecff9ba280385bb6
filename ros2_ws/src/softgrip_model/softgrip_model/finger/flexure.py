# SPDX-License-Identifier: Apache-2.0
"""What mode F takes from a finite-element study of flexures (docs/finger.md has the model)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass


@dataclass(frozen=True)
class FlexureStudy:
    """Numbers without units, fitted to `reference/flexure_study.npz` by tools/docs/flexure_study.py.

    Attributes:
        strip: bending stiffness of a strip over that of a beam held across as `contraction` says.
        link: the same of the links.
        spread: how fast a strip's force spreads into its link, depth per length.
        attachment: how far beyond its routing point the cable acts on a link, as a share of the strip's length.
        root_thickness: how much more a root gives than its beam, per thickness over length of the strip.
        root_link: the same in shorter links, per length of the strip over that of half the link.
        root_lever: lever of a shear in a root, beside its beam's.
        elongation: by which the axis of a bent strip is longer, per e^2; e is the strain between its faces.
        softening: by which a bent strip is softer, per e^2.
        contraction: how much of a strip is free to contract across, per length over width.
    """

    strip: float
    link: float
    spread: float
    attachment: float
    root_thickness: float
    root_link: float
    root_lever: float
    elongation: float
    softening: float
    contraction: float

    @property
    def constants(self) -> tuple[float, ...]:
        """As the core takes them."""
        return dataclasses.astuple(self)


FLEXURE_STUDY = FlexureStudy(
    strip=1.032,
    link=0.802,
    spread=0.996,
    attachment=0.336,
    root_thickness=1.236,
    root_link=0.306,
    root_lever=0.201,
    elongation=0.0722,
    softening=0.199,
    contraction=0.583,
)
