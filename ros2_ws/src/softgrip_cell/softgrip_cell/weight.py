# SPDX-License-Identifier: Apache-2.0
"""What friction alone carries between fingers that press as a recipe asks: what may be called held before it hangs."""

from __future__ import annotations

from typing import Final

from softgrip_cell.products import Product, ProductSurface

GRAVITY_M_PER_S2: Final = 9.81

#: The arm accelerates: the product weighs this much more than at rest.
SHAKE: Final = 1.15

#: Friction of printed TPU on a surface [1], low values of rough classes.
FRICTION: Final = {
    ProductSurface.SMOOTH: 0.5,
    ProductSurface.DIMPLED: 0.6,
    ProductSurface.RUGGED: 0.7,
    ProductSurface.FILM: 0.3,
    ProductSurface.FROST: 0.15,
}

#: Contact force per contact tension [1]. By virtual work it is dL/ds: a fingertip goes four to five times the pulled
#: length (profiles of the three sets); friction in the finger keeps a fifth of the rest.
FORCE_PER_CONTACT_TENSION: Final = 0.8 / 4.5

#: Fingers that press.
FINGERS: Final = 3


def carried_kg(product: Product, finger_set: str) -> float:
    """Return the mass that friction carries when every finger presses as the recipe asks [kg]."""
    pressing_n = FINGERS * product.recipe_for(finger_set).hold_contact_tension_n * FORCE_PER_CONTACT_TENSION
    return FRICTION[product.surface] * pressing_n / (SHAKE * GRAVITY_M_PER_S2)
