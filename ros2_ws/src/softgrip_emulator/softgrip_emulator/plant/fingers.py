# SPDX-License-Identifier: Apache-2.0
"""All mounted fingers stepped together: joints, tendon, friction with memory.

Arrays are (finger F, joint J, ...), SI units.

Motion is overdamped (a finger of soft TPU weighs ten grams), so joints follow first-order equations; they are stepped
linearly implicit because tendon, groove stops and contacts are stiff. Friction at each routing contact carries a
bristle state s in -1..1: T(after) = T(before) exp(-s mu phi). It turns round over a short cable travel (Dahl), which
gives hysteresis; a coefficient that falls with speed gives stick-slip.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.plant.truth import FingerTruth

    Array = NDArray[np.float64]

_STOP_STIFFNESS_NM_PER_RAD: Final = 3.0
_STOP_BEFORE_CLOSED_RAD: Final = 0.05
"""The flanks of a groove meet this much before it is geometrically closed (print flash)."""
_TENSION_REFERENCE_N: Final = 5.0
_TENSION_FLOOR_N: Final = 0.05
_PADDING_STIFFNESS: Final = 1.0e3
_BITE_ANGLE_RAD: Final = 0.05


class FingerBank:
    """State and geometry of the mounted fingers; a slot without a finger has a tendon that pulls on nothing."""

    def __init__(self, fingers: Sequence[FingerTruth | None]) -> None:
        self.fingers = list(fingers)
        count = len(self.fingers)
        joints = max([f.joints for f in self.fingers if f is not None], default=1)
        self.joints = joints

        def per_joint(name: str, fill: float) -> Array:
            return _padded([None if f is None else getattr(f, name) for f in self.fingers], joints, fill)

        def per_contact(name: str) -> Array:
            return _padded([None if f is None else getattr(f, name) for f in self.fingers], 2 * joints, 0.0)

        def scalar(name: str, fill: float) -> Array:
            return np.array([fill if f is None else getattr(f, name) for f in self.fingers])

        self.present = np.array([f is not None for f in self.fingers])
        self.real_joint = np.array([[f is not None and j < f.joints for j in range(joints)] for f in self.fingers])
        self.link_m = per_joint("link_lengths_m", 0.0)
        self.body_height_m = scalar("body_height_m", 0.012)
        opening = per_joint("opening_rad", np.pi / 2)
        self._half = opening / 2.0
        self._opening = opening
        self._ra = per_joint("entry_radius_m", 1e-3)
        self._rb = per_joint("exit_radius_m", 1e-3)
        self._entry_along = self._ra * np.sin(self._half)
        self._entry_inward = self._ra * np.cos(self._half)
        self._radii_squared = self._ra**2 + self._rb**2
        self._radii_product = self._ra * self._rb
        self._beta = self._link_slopes()
        moments = np.zeros((3, count, joints))
        moments[0] = _PADDING_STIFFNESS
        for index, finger in enumerate(self.fingers):
            if finger is not None:
                moments[:, index, : finger.joints] = finger.moment_coefficients
        self._m1, self._m2, self._m3 = moments
        self._damping = self._m1 * scalar("damping_s", 0.03)[:, None]
        self._creep_share = scalar("creep_share", 0.0)[:, None]
        self._creep_rate = 1.0 / scalar("creep_time_s", 1.0)[:, None]
        self._mu = per_contact("friction_coefficient")
        self._bite = per_contact("friction_bite")
        self._mu_exponent = scalar("friction_tension_exponent", 0.0)[:, None]
        self._stribeck = scalar("friction_stribeck_share", 0.0)[:, None]
        self._stribeck_speed = scalar("friction_stribeck_speed_m_s", 1e-3)[:, None]
        self._presliding = scalar("presliding_m", 1e-4)[:, None]
        self._ea = scalar("cable_stiffness_n", 9e3)
        self._lead = scalar("lead_length_m", 0.1)
        self.slack_m = scalar("slack_m", 0.0)
        self.broken = np.zeros(count, bool)
        self._stop = opening - _STOP_BEFORE_CLOSED_RAD
        self._c0 = self._free_span(np.zeros((count, joints)))[0]
        self._link_span = self._link_spans()
        self._eye = np.eye(joints)
        self.friction_scale = 1.0
        self._start_straight()

    def _start_straight(self) -> None:
        """Straight fingers, loose tendons."""
        count, joints = self.link_m.shape
        self.q = np.zeros((count, joints))
        self.joint_speed = np.zeros((count, joints))
        self._relaxed = np.zeros((count, joints))
        self._bristle = np.zeros((count, 2 * joints))
        self._slid_from = self._distal_cable(np.zeros((count, 2 * joints)), self._c0)
        self._span = self._free_span(self.q)
        self._speed = np.zeros((count, 2 * joints))
        self.tension_n = np.zeros(count)
        self.span_tension_n = np.zeros((count, 2 * joints))
        """Tension after each routing contact, spool to tip [N]."""

    def adopt(self, before: FingerBank, keep: Sequence[int]) -> None:
        """Take over the state of fingers that stay mounted."""
        joints = min(self.joints, before.joints)
        for index in keep:
            for mine, theirs, width in (
                (self.q, before.q, joints),
                (self._relaxed, before._relaxed, joints),
                (self._bristle, before._bristle, 2 * joints),
                (self._slid_from, before._slid_from, 2 * joints),
                (self.span_tension_n, before.span_tension_n, 2 * joints),
            ):
                mine[index, :width] = theirs[index, :width]
            self.tension_n[index] = before.tension_n[index]
        self._span = self._free_span(self.q)

    # -- geometry --------------------------------------------------------------------------------------------------

    def _link_slopes(self) -> Array:
        """Slope of the cable on each link, (F, J+1): parallel to the link before the first and after the last joint."""
        cos_h, sin_h = np.cos(self._half), np.sin(self._half)
        rise = self._rb[:, :-1] * cos_h[:, :-1] - self._ra[:, 1:] * cos_h[:, 1:]
        run = self.link_m[:, :-1] - self._rb[:, :-1] * sin_h[:, :-1] - self._ra[:, 1:] * sin_h[:, 1:]
        inner = np.where(run > 0.0, np.arctan2(rise, np.maximum(run, 1e-6)), 0.0)
        edge = np.zeros((len(self.link_m), 1))
        return np.asarray(np.hstack([edge, inner, edge]))

    def _link_spans(self) -> Array:
        """Cable length on the link behind each joint [m], (F, J)."""
        ends = self._rb * np.sin(self._half)
        starts = np.hstack([(self._ra * np.sin(self._half))[:, 1:], np.zeros((len(self.link_m), 1))])
        return np.asarray(np.maximum(self.link_m - ends - starts, 0.0))

    def _free_span(self, q: Array) -> tuple[Array, Array]:
        """Cable length in each groove and its lever arm about the joint [m]."""
        gap = self._opening - q
        c = np.sqrt(np.maximum(self._radii_squared - 2.0 * self._radii_product * np.cos(gap), 1e-10))
        return c, self._radii_product * np.sin(gap) / c

    def _wrap_angles(self, q: Array) -> Array:
        """Bend of the cable at each routing contact [rad], (F, 2J)."""
        # Exit point turned by -q about the joint, minus entry point.
        turned = self._half - q
        dx = self._rb * np.sin(turned) + self._entry_along
        dy = self._entry_inward - self._rb * np.cos(turned)
        slope = np.arctan2(dy, dx)
        wrap = np.empty((len(q), 2 * self.joints))
        wrap[:, 0::2] = np.abs(self._beta[:, :-1] - slope)
        wrap[:, 1::2] = np.abs(slope - self._beta[:, 1:] + q)
        return wrap

    def _distal_cable(self, span_tension: Array, c: Array) -> Array:
        """Unstretched cable beyond each contact [m], (F, 2J): less of it means cable came out past the contact."""
        path = np.empty_like(span_tension)
        path[:, 0::2] = c
        path[:, 1::2] = self._link_span
        unstretched = path * (1.0 - span_tension / self._ea[:, None])
        return np.asarray(np.cumsum(unstretched[:, ::-1], axis=1)[:, ::-1])

    def pulled_length_m(self) -> Array:
        """How much cable the present joint angles take in [m], (F,)."""
        return np.asarray((self._c0 - self._span[0]).sum(axis=1))

    # -- motion ----------------------------------------------------------------------------------------------------

    def step(self, wound_m: Array, dt_s: float, load: tuple[Array, Array] | None = None) -> None:
        """Advance by one step.

        Args:
            wound_m: cable wound on each spool since mounting [m], (F,).
            dt_s: step [s].
            load: torque that products put on the joints [N m], (F, J), closing positive, and its stiffness against
                closing [N m/rad], (F, J, J).
        """
        q = self.q
        c, arm = self._span
        drop = self._bristle * self._friction(q)
        ratio = np.exp(-np.cumsum(drop, axis=1))
        joint_ratio, link_ratio = ratio[:, 0::2], ratio[:, 1::2]
        compliance = (self._lead + (joint_ratio * c).sum(1) + (link_ratio * self._link_span).sum(1)) / self._ea
        excess = wound_m - (self._c0 - c).sum(axis=1) - self.slack_m
        tension = np.where(self.broken | ~self.present, 0.0, np.maximum(excess, 0.0) / compliance)

        size = np.abs(q)
        elastic = q * (self._m1 + self._m2 * size + self._m3 * q * q)
        stiffness = self._m1 + 2.0 * self._m2 * size + 3.0 * self._m3 * q * q
        over = q - self._stop
        closed = over > 0.0
        torque = (
            tension[:, None] * joint_ratio * arm
            - elastic
            + self._relaxed
            - np.where(closed, _STOP_STIFFNESS_NM_PER_RAD * over, 0.0)
        )
        diagonal = self._damping / dt_s + np.maximum(stiffness, 0.2 * self._m1)
        diagonal = diagonal + np.where(closed, _STOP_STIFFNESS_NM_PER_RAD, 0.0)
        pull = np.where(tension > 0.0, 1.0 / compliance, 0.0)
        matrix = (joint_ratio * arm * pull[:, None])[:, :, None] * arm[:, None, :]
        if load is not None:
            torque = torque + load[0]
            matrix = matrix + load[1]
        matrix = matrix + diagonal[:, :, None] * self._eye
        change = np.linalg.solve(matrix, torque[:, :, None])[:, :, 0]
        change = np.clip(change, -0.05, 0.05)
        self.q = q + change
        self.joint_speed = change / dt_s
        self._relaxed += (self._creep_share * elastic - self._relaxed) * (self._creep_rate * dt_s)
        # The tension at the end of the step: what the joints gave way has left the cable.
        tension = np.maximum(tension - pull * (arm * change).sum(axis=1), 0.0)
        self.tension_n = tension
        self.span_tension_n = tension[:, None] * ratio
        self._span = self._free_span(self.q)
        self._slide(dt_s)

    def _friction(self, q: Array) -> Array:
        """ln(T before / T after) at each contact when fully sliding, (F, 2J)."""
        level = np.maximum(self.span_tension_n, _TENSION_FLOOR_N) / _TENSION_REFERENCE_N
        mu = self._mu * level**-self._mu_exponent
        mu = mu * (1.0 + self._stribeck * np.exp(-np.abs(self._speed) / self._stribeck_speed))
        wrap = self._wrap_angles(q)
        ratio_log = mu * wrap + self._bite * (1.0 - np.exp(-wrap / _BITE_ANGLE_RAD))
        return np.asarray(self.friction_scale * ratio_log)

    def _slide(self, dt_s: float) -> None:
        """Turn the bristles by what the cable has travelled over each contact."""
        beyond = self._distal_cable(self.span_tension_n, self._span[0])
        travel = self._slid_from - beyond
        self._slid_from = beyond
        # The bristle heads for the sign of the motion and gets there within a few presliding lengths.
        keep = np.exp(-np.abs(travel) / self._presliding)
        self._bristle = np.sign(travel) * (1.0 - keep) + self._bristle * keep
        self._speed += 0.1 * (travel / dt_s - self._speed)

    # -- where the links are ---------------------------------------------------------------------------------------

    def chain(self, q: Array | None = None) -> tuple[Array, Array]:
        """Joints and tip in each finger's base frame [m], (F, J+1, 2), and direction angles of the links [rad], (F, J).

        Args:
            q: joint angles (F, J) [rad]; the present ones when not given.
        """
        heading = np.cumsum(self.q if q is None else q, axis=1)
        steps = self.link_m[:, :, None] * np.stack([np.cos(heading), -np.sin(heading)], axis=2)
        points = np.zeros((len(heading), self.joints + 1, 2))
        np.cumsum(steps, axis=1, out=points[:, 1:])
        return points, heading


def _padded(rows: Sequence[Array | None], width: int, fill: float) -> Array:
    out = np.full((len(rows), width), fill)
    for index, row in enumerate(rows):
        if row is not None:
            out[index, : len(row)] = row
    return out
