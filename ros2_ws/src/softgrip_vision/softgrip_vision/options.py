# SPDX-License-Identifier: Apache-2.0
"""What a user may set of the tracker."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TrackerOptions:
    """Of all fingers.

    Attributes:
        threshold_share: 0..1 of the markers' height in the signal at which a pixel counts as marker.
        placement_stddev_m: [m] how exactly the markers sit where the layout says.
        largest_angle_stddev: [rad] a pose less certain than that is not given out.
        reacquire_timeout_s: markers may be hidden so long before the finger is searched for again.
    """

    threshold_share: float = 0.4
    placement_stddev_m: float = 5e-5
    largest_angle_stddev: float = math.radians(2.0)
    reacquire_timeout_s: float = 0.7
