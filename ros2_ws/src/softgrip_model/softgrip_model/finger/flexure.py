# SPDX-License-Identifier: Apache-2.0
"""What mode F takes from a finite-element study of flexures (docs/finger.md has the model)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FlexureStudy:
    """Four numbers without units, fitted to `reference/flexure_study.npz` by tools/docs/flexure_study.py.

    Attributes:
        strip: bending stiffness of a strip over that of a plate too wide to contract across.
        link: the same of the links.
        spread: how fast a strip's force spreads into its link, depth per length.
        attachment: how far beyond its routing point the cable acts on a link, as a share of the strip's length.
    """

    strip: float
    link: float
    spread: float
    attachment: float

    @property
    def constants(self) -> tuple[float, float, float, float]:
        """As the core takes them."""
        return self.strip, self.link, self.spread, self.attachment


FLEXURE_STUDY = FlexureStudy(strip=0.999, link=0.654, spread=1.266, attachment=0.136)
