# SPDX-License-Identifier: Apache-2.0
"""What a thermometer beside the fingers says, for as long as it can be believed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from softgrip_model.finger.errors import FingerError
from softgrip_time.units import to_ns

#: [degC] Readings outside are no room's: the range of a common sensor (Bosch BST-BME280-DS001, table 4).
RANGE_C: Final = (-40.0, 85.0)
#: [ns] A room changes by less than the watch looks for in this time; what is older is not known any more.
MAX_AGE_NS: Final = to_ns(600.0)


@dataclass(frozen=True)
class RoomTemperature:
    """One reading.

    Attributes:
        stamp: [ns].
        celsius: [degC].

    Raises:
        FingerError: no temperature that a room can have.
    """

    stamp: int
    celsius: float

    def __post_init__(self) -> None:
        lowest, highest = RANGE_C
        if not lowest <= self.celsius <= highest:
            raise FingerError(
                f"cell/temperature: expected {lowest:g} to {highest:g} degC, found {self.celsius:g}; "
                "look at the thermometer, and at its unit"
            )

    def at(self, stamp: int) -> float:
        """Return the temperature at a stamp [ns]; NaN where the reading is too old."""
        return self.celsius if stamp - self.stamp <= MAX_AGE_NS else math.nan
