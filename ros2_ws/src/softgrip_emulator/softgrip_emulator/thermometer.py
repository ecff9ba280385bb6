# SPDX-License-Identifier: Apache-2.0
"""The thermometer on the cell's table: right to a degree, as a BME280 is.

Facts: Bosch BST-BME280-DS001, table 4: absolute accuracy +-1.0 degC from 0 to 65 degC, resolution 0.01 degC, noise
0.005 degC. Assumptions: the accuracy is two standard deviations of one offset a sensor; a reading every five seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

#: [K] standard deviation of a sensor's own offset, and of a reading.
OFFSET_STDDEV_K: Final = 0.5
_NOISE_K, _RESOLUTION_K = 0.005, 0.01
#: [s] between readings.
PERIOD_S: Final = 5.0


class Thermometer:
    """Reads the room's temperature with an offset of its own.

    Args:
        room_c: gives the true temperature [degC].
        seed: of its offset and its noise.
    """

    def __init__(self, room_c: Callable[[], float], seed: int) -> None:
        self._room_c = room_c
        self._rng = np.random.default_rng([seed, 0x5448])
        self._offset_k = OFFSET_STDDEV_K * self._rng.standard_normal()

    def read_c(self) -> float:
        """Return one reading [degC]."""
        read = self._room_c() + self._offset_k + _NOISE_K * self._rng.standard_normal()
        return float(_RESOLUTION_K * round(read / _RESOLUTION_K))
