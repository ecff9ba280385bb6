# SPDX-License-Identifier: Apache-2.0
"""Whether the camera sees the same as before. A picture at an eighth of its size tells, for a fraction of the work.

The outcome depends on the frames and their stamps alone.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: [s] without a change before frames may be left out
REST_AFTER_S: Final = 2.0
#: grey levels 0..255 by which the mean of 8 x 8 pixels has to differ: noise of 5 levels a pixel gives 0.6, a marker of
#: 100 levels above its surroundings that moves by half a pixel 6 at its edge
CHANGE_LEVELS: Final = 5


class StillWatch:
    """Decides which frames need not be measured because they show what the last measured one showed.

    Args:
        period_s: between measured frames while nothing changes [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """Measure the next frames, whatever they show."""
        self._reference: NDArray[np.uint8] | None = None
        self._measured_s = self._changed_s = math.nan

    def may_skip(self, picture: NDArray[np.uint8], stamp_s: float) -> bool:
        """Return whether a frame may be left out.

        Args:
            picture: (h, w) grey levels at an eighth of the frame's size.
            stamp_s: of capture [s].
        """
        if self._reference is None or stamp_s < self._measured_s or _differ(picture, self._reference):
            self._changed_s = stamp_s
        is_still = stamp_s - self._changed_s > REST_AFTER_S
        # stamps are whole frames apart: half a frame's rounding must not cost a frame
        if is_still and stamp_s - self._measured_s < self._period_s - 1e-3:
            return True
        self._reference, self._measured_s = picture, stamp_s
        return False


def _differ(picture: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    if picture.shape != other.shape:
        return True
    return bool((np.maximum(picture, other) - np.minimum(picture, other)).max() > CHANGE_LEVELS)
