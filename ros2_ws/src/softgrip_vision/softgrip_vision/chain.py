# SPDX-License-Identifier: Apache-2.0
"""Where a finger's markers can be: a planar chain, filtered from frame to frame.

State (3 + 2n,): [x, y, heading] of the mount in the finger's base frame [m, m, rad], n joint angles [rad], n joint
speeds [rad/s]. Marker i = 0 is the base marker, 1 .. n the joints, n + 1 the tip. Angles grow as the finger closes,
which turns its links clockwise (towards -y).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softgrip_vision.layout import ChainLayout

Array = NDArray[np.float64]

#: One standard deviation of where the mount may really be before markers were seen: [m, m, rad].
MOUNT_STDDEV = (2e-3, 2e-3, math.radians(2.0))
#: Random walk of the mount [m/sqrt(s), m/sqrt(s), rad/sqrt(s)]: it is screwed down.
MOUNT_DRIFT = (2e-5, 2e-5, math.radians(0.02))
#: [rad/s] one standard deviation of a joint's speed, and [s] how long it keeps a speed (Singer's model, first order).
SPEED_STDDEV = 5.0
SPEED_TIME = 0.15
#: [rad] A joint bent backwards further than this is not: fingers rest straight.
NEARLY_STRAIGHT = math.radians(3.0)
#: Stop refining a measurement's linearisation below this step [rad], or after so many steps.
RELINEARISE_STEP = 1e-3
RELINEARISE_LIMIT = 4


@dataclass(frozen=True)
class ChainGeometry:
    """A chain with the base marker's place.

    Attributes:
        layout: links.
        base_marker_m: [m] distance of the base marker behind the first joint.
    """

    layout: ChainLayout
    base_marker_m: float

    def markers(self, state: Array) -> Array:
        """Return (n + 2, 2) marker positions [m]."""
        n = self.layout.joints
        x, y, heading, *angles = state[: 3 + n].tolist()
        points = [(x - self.base_marker_m * math.cos(heading), y - self.base_marker_m * math.sin(heading)), (x, y)]
        for length, angle in zip(self.layout.link_lengths_m, angles, strict=True):
            heading -= angle
            x += length * math.cos(heading)
            y += length * math.sin(heading)
            points.append((x, y))
        return np.array(points)

    def jacobian(self, points: Array, marker: int, size: int) -> Array:
        """Return (2, size) derivative of one marker's position by the state, at the (n + 2, 2) positions."""
        places = points.tolist()
        x, y = places[marker]
        # A turn of the mount swings the marker around the first joint, counter-clockwise; a joint's the other way.
        arms = [(x - joint_x, y - joint_y) for joint_x, joint_y in places[1 : max(2, marker)]]
        joints = arms[: max(0, marker - 1)]
        rest = [0.0] * (size - 3 - len(joints))
        return np.array(
            [
                [1.0, 0.0, -arms[0][1], *(arm_y for _, arm_y in joints), *rest],
                [0.0, 1.0, arms[0][0], *(-arm_x for arm_x, _ in joints), *rest],
            ]
        )

    def angles(self, points: Array) -> Array:
        """Return (n,) joint angles [rad] of (n + 2, 2) marker positions (the closed form of the inverse)."""
        steps = np.diff(points, axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        return np.asarray((-np.diff(headings) + math.pi) % (2 * math.pi) - math.pi)


@dataclass
class ChainFilter:
    """Extended Kalman filter over one chain; predictions gate the markers, hidden markers follow from the others.

    The speed model is wide (a joint may stop or start within SPEED_TIME), so that with all markers seen the angles are
    those of this frame, without lag.
    """

    geometry: ChainGeometry
    state: Array = field(init=False)
    covariance: Array = field(init=False)

    def __post_init__(self) -> None:
        n = self.geometry.layout.joints
        self.state = np.zeros(3 + 2 * n)
        deviation = np.concatenate([MOUNT_STDDEV, np.full(n, 1.0), np.full(n, SPEED_STDDEV)])
        self.covariance = np.diag(deviation**2)
        self._last: tuple[int, Array, Array, Array] | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.geometry.layout.joints

    def place(self, points: Array) -> None:
        """Start from (n + 2, 2) marker positions [m] found by a search; call :meth:`update` with each afterwards."""
        self._set_angles(self.geometry.angles(points))

    def _set_angles(self, angles: Array) -> None:
        """Put other joint angles (n,) [rad] into a new state: the old array is what was worked with."""
        self.state = np.concatenate([self.state[:3], angles, self.state[3 + self.joints :]])

    def predict(self, seconds: float) -> None:
        """Advance by a time [s] > 0."""
        n = self.joints
        decay = math.exp(-seconds / SPEED_TIME)
        reach = SPEED_TIME * (1.0 - decay)
        self.state = _advanced(self.state, n, reach, decay)
        half_advanced = _advanced(self.covariance, n, reach, decay)
        self.covariance = _advanced(half_advanced.T, n, reach, decay)
        self._add_process_noise(seconds, decay)

    def _add_process_noise(self, seconds: float, decay: float) -> None:
        """Add the exact discrete noise of an Ornstein-Uhlenbeck speed and its integral, and the mount's drift."""
        n, tau = self.joints, SPEED_TIME
        spectral = 2.0 * SPEED_STDDEV**2 / tau
        angle = spectral * tau**2 * (seconds - 2 * tau * (1 - decay) + tau / 2 * (1 - decay**2))
        cross = spectral * tau**2 / 2 * (1 - decay) ** 2
        speed = spectral * tau / 2 * (1 - decay**2)
        every = np.arange(3 + 2 * n)
        joints, speeds = every[3 : 3 + n], every[3 + n :]
        drift = [stddev**2 * seconds for stddev in MOUNT_DRIFT]
        self.covariance[every, every] += [*drift, *[angle] * n, *[speed] * n]
        self.covariance[joints, speeds] += cross
        self.covariance[speeds, joints] += cross

    def expect(self, marker: int) -> tuple[Array, Array]:
        """Return (2,) the position [m] of a marker as expected and (2, 2) its covariance [m^2]."""
        points, jacobian = self._linearised(marker, self.state)
        return points[marker], jacobian @ self.covariance @ jacobian.T

    def _linearised(self, marker: int, state: Array) -> tuple[Array, Array]:
        """Return (n + 2, 2) marker positions [m] and the (2, 3 + 2 n) derivative of one of them.

        The last answer is kept: what is expected of a marker is the first thing that its update asks for.
        """
        if self._last is None or self._last[0] != marker or self._last[1] is not state:
            points = self.geometry.markers(state)
            self._last = marker, state, points, self.geometry.jacobian(points, marker, len(state))
        return self._last[2:]

    def update(self, marker: int, position: Array, covariance: Array) -> None:
        """Take in a marker's (2,) position [m] with its (2, 2) covariance [m^2] (iterated EKF)."""
        prior, prior_covariance = self.state, self.covariance
        state = prior
        for _ in range(RELINEARISE_LIMIT):
            points, jacobian = self._linearised(marker, state)
            spread = prior_covariance @ jacobian.T
            gain = spread @ inverse2(jacobian @ spread + covariance)
            innovation = position - points[marker] - jacobian @ (prior - state)
            refined = prior + gain @ innovation
            step = float(np.abs(refined - state)[: 3 + self.joints].max())
            state = refined
            if step < RELINEARISE_STEP:
                break
        self.state = state
        updated = prior_covariance - gain @ jacobian @ prior_covariance
        self.covariance = (updated + updated.T) / 2

    def settle_hidden(self, hidden: Sequence[bool]) -> Array:
        """Put hidden joints on the side that fingers bend to; return (n,) [rad] what stays unknown beside the filter.

        A single hidden joint may lie on either side of the line between its neighbours, and a linearised filter does
        not know that. A finger does not open past straight, so a joint found bent backwards is mirrored; one that is
        nearly straight stays unknown by its own angle. Two hidden neighbours leave a freedom that only time filters
        away: unknown.

        Args:
            hidden: (n + 2,) which markers are not seen.
        """
        unknown = np.zeros(self.joints)
        for marker in range(2, self.joints + 1):
            if not hidden[marker]:
                continue
            around = slice(marker - 2, marker + 1)
            if hidden[marker + 1] or hidden[marker - 1]:
                unknown[around] = math.pi
                continue
            angle = 3 + marker - 1
            if self.state[angle] < -NEARLY_STRAIGHT:
                points = self.geometry.markers(self.state)
                chord = points[marker + 1] - points[marker - 1]
                offset = points[marker] - points[marker - 1]
                points[marker] = points[marker - 1] + 2 * chord * float(offset @ chord) / float(chord @ chord) - offset
                self._set_angles(self.geometry.angles(points))
            if self.state[angle] < NEARLY_STRAIGHT:
                unknown[around] = np.maximum(unknown[around], abs(self.state[angle]))
        return unknown

    def angles(self) -> tuple[Array, Array]:
        """Return (n,) joint angles [rad] and (n,) their standard deviations [rad]."""
        angle = slice(3, 3 + self.joints)
        return self.state[angle].copy(), np.sqrt(np.diag(self.covariance)[angle])

    def tip(self) -> tuple[Array, Array]:
        """Return (2,) the tip [m] in the finger's own base frame (at the mount), (2,) its standard deviations [m]."""
        state = self.state.copy()
        state[:3] = 0.0
        points = self.geometry.markers(state)
        jacobian = self.geometry.jacobian(points, len(points) - 1, len(state))
        jacobian[:, :3] = 0.0
        return points[-1], np.sqrt(np.diag(jacobian @ self.covariance @ jacobian.T))


def _advanced(rows: Array, joints: int, reach: float, decay: float) -> Array:
    """Return the rows of a state or covariance after a time: angles moved on by their speeds, speeds decayed."""
    later = rows.copy()
    later[3 : 3 + joints] += reach * rows[3 + joints :]
    later[3 + joints :] *= decay
    return later


def inverse2(matrix: Array) -> Array:
    """Return the inverse of a (2, 2) matrix (closed form: a tenth of numpy's time at this size)."""
    (a, b), (c, d) = matrix.tolist()
    scale = 1.0 / (a * d - b * c)
    return np.array([[d * scale, -b * scale], [-c * scale, a * scale]])


def mahalanobis2(miss: Array, covariance: Array) -> float:
    """Return the squared Mahalanobis distance of a (2,) deviation under a (2, 2) covariance."""
    (a, b), (c, d) = covariance.tolist()
    x, y = miss.tolist()
    return float((d * x * x - (b + c) * x * y + a * y * y) / (a * d - b * c))


def largest_eigenvalue(matrix: Array) -> float:
    """Return the larger eigenvalue of a symmetric (2, 2) matrix."""
    (a, b), (_, d) = matrix.tolist()
    return float((a + d) / 2 + math.hypot((a - d) / 2, b))
