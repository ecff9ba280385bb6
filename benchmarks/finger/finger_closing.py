# SPDX-License-Identifier: Apache-2.0
"""How fast a finger closes: the compiled kernel beside the same equations written in NumPy and solved by SciPy.

The finger is the one of section 3.4 of the thesis (optimised routing) under the fitted friction of twine on TPU. The
peer is what one writes first: a residual function of numpy arrays, scipy.optimize.root from the state before.
"""

from __future__ import annotations

import math
import os
import statistics
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from softgrip_model.finger import Finger, Kernel, Status
from softgrip_model.finger.published import OPTIMISED_ROUTING_MM, chapter_3_finger, chapter_4_finger
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.friction.published import published
from softgrip_testing.benchmark_claim import claim, no_options, spread, timed

Array = NDArray[np.float64]

INCREMENTS, FURTHEST_MM = 200, 20.0
DESIGNS, BATCH_INCREMENTS = 10_000, 20


class NumpyFinger:
    """The equilibrium of docs/finger.md for linear strips and 90 degree grooves, as residuals of numpy arrays."""

    def __init__(self, finger: Finger, law: FrictionLaw) -> None:
        self.entry, self.exit = np.array(finger.routing_mm[::2]), np.array(finger.routing_mm[1::2])
        self.stiffness = finger.strip.modulus_mpa[2] * np.array(finger.widths_mm) * np.array(finger.thickness_mm) ** 3
        self.stiffness /= 12.0 * np.array(finger.length_mm)
        s = math.sqrt(0.5)
        ahead = np.array(finger.link_mm[:-1]) - s * (self.exit[:-1] + self.entry[1:])
        slope = np.arctan2(s * (self.exit[:-1] - self.entry[1:]), ahead)
        self.slope = np.concatenate([[0.0], slope, [0.0]])
        self.straight = np.hypot(self.entry, self.exit)
        self.alpha, n, self.epsilon, self.lam = law.coefficients
        self.m, self.radius = 1.0 - n, law.radius_mm

    def log_ratio(self, bend: float, tension: float) -> float:
        """Eq 3.9 with K as printed: ln Rf."""
        x = self.alpha * self.m * (self.radius / tension) ** self.m * bend
        return float(-np.log1p(-x) / self.m + max(0.0, self.epsilon - self.lam * np.log(tension)))

    def residual(self, x: Array, pull: float) -> Array:
        """Moments and pulled length; x = joint angles and ln(tip tension)."""
        q, tension = x[:-1], float(np.exp(x[-1]))
        half = 0.5 * (np.pi / 2 - q)
        direction = -0.5 * q - np.arctan((self.exit - self.entry) / (self.exit + self.entry) / np.tan(half))
        span = np.sqrt(self.entry**2 + self.exit**2 - 2 * self.entry * self.exit * np.sin(q))
        arm = self.entry * self.exit * np.cos(q) / span
        at_entry = np.abs(self.slope[:-1] - direction)
        at_exit = np.abs(direction - self.slope[1:] + q)
        across = np.empty_like(q)
        for j in range(len(q) - 1, -1, -1):
            tension *= np.exp(self.log_ratio(at_exit[j], tension))
            across[j] = tension
            tension *= np.exp(self.log_ratio(at_entry[j], tension))
        return np.append(self.stiffness * q - across * arm, np.sum(self.straight - span) - pull)

    def closing(self, pulls: Array) -> Array:
        """Angles along the closing, (len(pulls), joints)."""
        x = np.append(np.full(len(self.entry), 0.01), math.log(0.1))
        angles = []
        for pull in pulls:
            found = root(self.residual, x, args=(pull,))
            if not found.success:
                raise RuntimeError(f"the peer broke off at {pull} mm: {found.message}")
            x = found.x
            angles.append(x[:-1])
        return np.array(angles)

    def direct(self, pull: float) -> Array:
        """Angles at one pulled length, from a guess."""
        x = np.append(np.full(len(self.entry), 0.5), math.log(3.0))
        found = root(self.residual, x, args=(pull,))
        if not found.success:
            raise RuntimeError(f"the peer broke off at {pull} mm: {found.message}")
        return np.asarray(found.x[:-1])


def main() -> int:
    """Measure and print the claims; 1 when kernel and peer disagree."""
    no_options(__doc__)
    finger, law = chapter_3_finger(OPTIMISED_ROUTING_MM), published("twine-tpu").law
    kernel, peer = Kernel([finger], law), NumpyFinger(finger, law)
    pulls = np.linspace(0.0, FURTHEST_MM, INCREMENTS + 1)[1:]
    ours = kernel.solve(pulls, threads=1).angle_rad[0]
    difference = max(
        float(np.abs(ours - peer.closing(pulls)).max()), float(np.abs(ours[-1] - peer.direct(FURTHEST_MM)).max())
    )
    if not difference < 1e-6:
        print(f"kernel and peer differ by {difference} rad: no claim", file=sys.stderr)
        return 1

    closing = timed(lambda: kernel.solve(pulls, threads=1), 300)
    peer_closing = timed(lambda: peer.closing(pulls), 5)
    claim(
        "closing 200 increments",
        1e6 * statistics.median(closing),
        "us",
        better="lower",
        goal=60.0,
        runs=len(closing),
        peer="NumPy residual, scipy.optimize.root",
        peer_value=1e6 * statistics.median(peer_closing),
        note=f"{spread(closing, 'us', 1e6)}, call from Python included; goal of the ratio 200; largest difference "
        f"{difference:.1e} rad; peer {spread(peer_closing, 'ms', 1e3)}",
    )
    many = np.full(1000, FURTHEST_MM)
    direct = [t / len(many) for t in timed(lambda: kernel.solve(many, march=False, threads=1), 200)]
    one = timed(lambda: kernel.solve([FURTHEST_MM], march=False, threads=1), 500)
    peer_direct = timed(lambda: peer.direct(FURTHEST_MM), 50)
    claim(
        "direct solve",
        1e6 * statistics.median(direct),
        "us",
        better="lower",
        goal=3.0,
        runs=len(direct),
        peer="NumPy residual, scipy.optimize.root",
        peer_value=1e6 * statistics.median(peer_direct),
        note=f"20 mm from nothing, {spread(direct, 'us', 1e6)} of 1000 in a call; a call for one from Python "
        f"{spread(one, 'us', 1e6)}",
    )
    batch_rate()
    return 0


def batch_rate() -> None:
    """Random designs within the thesis' bounds (section 4.2.3), on every core and on one."""
    rng = np.random.default_rng(1)
    base = Kernel([chapter_4_finger("power")], published("braid-tpu-chapter4").law)
    kernel = base.varied(rng.uniform(2.5, 5.0, (DESIGNS, 3)), rng.uniform(5.0, 13.0, (DESIGNS, 6)))
    pulls = np.linspace(0.0, FURTHEST_MM, BATCH_INCREMENTS + 1)[1:]
    cores = os.cpu_count() or 1
    solution = kernel.solve(pulls)
    unsolved = int(((solution.status & Status.NOT_CONVERGED) != 0).any(axis=1).sum())
    short = int(((solution.status & Status.OUT_OF_REACH) != 0).any(axis=1).sum())
    rates = [DESIGNS / seconds for seconds in timed(lambda: kernel.solve(pulls), 10)]
    alone = [DESIGNS / seconds for seconds in timed(lambda: kernel.solve(pulls, threads=1), 5)]
    claim(
        "batch designs rate",
        statistics.median(rates),
        "designs/s",
        better="higher",
        goal=None,
        runs=len(rates),
        peer="the same on one core",
        peer_value=statistics.median(alone),
        note=f"{DESIGNS} random designs x {BATCH_INCREMENTS} increments on {cores} cores, "
        f"{spread(rates, 'designs/s')}; {unsolved} designs unsolved, {short} with less than 20 mm to give",
    )


if __name__ == "__main__":
    sys.exit(main())
