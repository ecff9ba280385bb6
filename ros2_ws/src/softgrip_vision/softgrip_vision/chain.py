# SPDX-License-Identifier: Apache-2.0
"""Where a finger's markers can be: a planar chain, filtered from frame to frame.

State (3 + 2n,): [x, y, heading] of the mount in the finger's base frame [m, m, rad], n joint angles [rad], n joint
speeds [rad/s]. Marker i = 0 is the base marker, 1 .. n the joints, n + 1 the tip. Angles grow as the finger closes,
which turns its links clockwise (towards -y).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softgrip_vision import _core
from softgrip_vision.layout import ChainLayout

Array = NDArray[np.float64]

#: Random walk of the mount [m/sqrt(s), m/sqrt(s), rad/sqrt(s)].
MOUNT_DRIFT = _core.MOUNT_DRIFT
#: [rad/s] one standard deviation of a joint's speed, and [s] how long it keeps a speed (Singer's model, first order).
SPEED_STDDEV, SPEED_TIME = _core.SPEED_STDDEV, _core.SPEED_TIME


#: A place (x, y).
Place = tuple[float, float]


class Spread(NamedTuple):
    """A symmetric (2, 2) matrix: the covariance of a place."""

    xx: float
    xy: float
    yy: float

    @property
    def largest(self) -> float:
        """The larger eigenvalue."""
        return (self.xx + self.yy) / 2 + math.hypot((self.xx - self.yy) / 2, self.xy)

    def distance2(self, x: float, y: float) -> float:
        """Return the squared Mahalanobis distance of a deviation (x, y)."""
        return (self.yy * x * x - 2.0 * self.xy * x * y + self.xx * y * y) / (self.xx * self.yy - self.xy * self.xy)


@dataclass(frozen=True)
class ChainGeometry:
    """A chain with the base marker's place.

    Attributes:
        layout: links.
        base_marker_m: [m] distance of the base marker behind the first joint.
    """

    layout: ChainLayout
    base_marker_m: float

    @cached_property
    def core(self) -> _core.Chain:
        """The compiled chain."""
        return _core.Chain(self.layout.link_lengths_m, self.base_marker_m)

    def markers(self, state: Array) -> Array:
        """Return (n + 2, 2) marker positions [m]; of a state (3 + 2n,), its first 3 + n entries count."""
        return self.core.markers(state)

    def jacobian(self, points: Array, marker: int) -> Array:
        """Return (2, 3 + 2n) derivative of one marker's position by the state, at the (n + 2, 2) positions."""
        return self.core.jacobian(points, marker)

    def angles(self, points: Array) -> Array:
        """Return (n,) joint angles [rad] of (n + 2, 2) marker positions (the closed form of the inverse)."""
        return self.core.angles(points)


class ChainFilter:
    """Extended Kalman filter over one chain; predictions gate the markers, hidden markers follow from the others.

    The speed model is wide (a joint may stop or start within SPEED_TIME), so that with all markers seen the angles are
    those of this frame, without lag. Methods raise ValueError for a marker or an array that the chain does not have.
    """

    def __init__(self, geometry: ChainGeometry) -> None:
        self.geometry = geometry
        self._core = _core.ChainFilter(geometry.core)

    @property
    def state(self) -> Array:
        """(3 + 2n,) see above; assign another one to change it."""
        return _fixed(self._core.state)

    @state.setter
    def state(self, state: Array) -> None:
        self._core.state = state

    @property
    def covariance(self) -> Array:
        """(3 + 2n, 3 + 2n) of the state; assign another one to change it."""
        return _fixed(self._core.covariance)

    @covariance.setter
    def covariance(self, covariance: Array) -> None:
        self._core.covariance = covariance

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.geometry.layout.joints

    def place(self, points: Array) -> None:
        """Start from (n + 2, 2) marker positions [m] found by a search; call :meth:`update` with each afterwards."""
        self._core.place(points)

    def predict(self, seconds: float) -> None:
        """Advance by a time [s] > 0."""
        self._core.predict(seconds)

    def expect(self, marker: int) -> tuple[Place, Spread]:
        """Return the place [m] of a marker as expected and its covariance [m^2]."""
        place, spread = self._core.expect(marker)
        return place, Spread(*spread)

    def heading(self, link: int) -> float:
        """Return where a link points as expected [rad]; 0 is the mount, 1 .. n the links."""
        return self._core.heading(link)

    def update(self, marker: int, place: Place, spread: Spread) -> None:
        """Take in where a marker was seen [m] with its covariance [m^2] (iterated EKF)."""
        self._core.update(marker, place, spread)

    def settle_hidden(self, hidden: Sequence[bool]) -> Array:
        """Put hidden joints on the side that fingers bend to; return (n,) [rad] what stays unknown beside the filter.

        A single hidden joint may lie on either side of the line between its neighbours, and a linearised filter does
        not know that. A finger does not open past straight, so a joint found bent backwards is mirrored; one that is
        nearly straight stays unknown by its own angle. Two hidden neighbours leave a freedom that only time filters
        away: unknown.

        Args:
            hidden: (n + 2,) which markers are not seen.
        """
        return self._core.settle_hidden(hidden)

    def angles(self) -> tuple[Array, Array]:
        """Return (n,) joint angles [rad] and (n,) their standard deviations [rad]."""
        return self._core.state[3 : 3 + self.joints], self._core.angles_stddev()

    def tip(self) -> tuple[Array, Array]:
        """Return (2,) the tip [m] in the finger's own base frame (at the mount), (2,) its standard deviations [m]."""
        return self._core.tip()


def _fixed(values: Array) -> Array:
    """Return an array that cannot be written to: it is a copy, and what is written into it would be lost."""
    values.flags.writeable = False
    return values
