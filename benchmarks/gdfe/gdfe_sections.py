# SPDX-License-Identifier: Apache-2.0
"""What rigid cross-sections as a second level save: keyframes of the shipped fingers, with them and without.

The chain of equilibria from rest to a pulled length of 18 mm that gdfe_simulator starts its shapes from: 2,088
hexahedra, one thread, to the node's tolerance. Without them the acceleration remembers 60 iterations instead of 20,
which is what suits it. Both in the same run, in turns.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np

from softgrip_model.gdfe import closing
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.profile import Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options, spread

RUNS = 5
TRAVEL_MM = 18.0
#: Iterations after which sections answer (never), and the window that suits it.
WITHOUT = (-1, 60)
WITH = (closing.SECTIONS_AFTER, closing.WINDOW)


def chain(profile: Profile, method: tuple[int, int]) -> tuple[float, int, np.ndarray]:
    """Return seconds, iterations and the places of all nodes [mm] of a finger's keyframes; the set-up is left out."""
    closing.SECTIONS_AFTER, closing.WINDOW = method
    settings = ClosingSettings(travel_mm=TRAVEL_MM, max_iterations=2000)
    made = ClosingPath(profile, "index", settings, body=Body(profile, "index", settings.resolution))
    _ = made.body.solver
    began = time.perf_counter()
    made.keyframes.cover(TRAVEL_MM)
    seconds = time.perf_counter() - began
    known = made.keyframes._known  # noqa: SLF001  all of them, not the last alone
    if not all(one.converged for one in known):
        raise RuntimeError(f"{profile.id}: a keyframe did not converge")
    return seconds, sum(one.iterations for one in known), np.array([one.displacement for one in known])


def main() -> int:
    """Print the claim."""
    no_options(__doc__)
    profiles = load_directory(shipped_directory()).values()
    seconds: dict[tuple[int, int], list[float]] = {WITH: [], WITHOUT: []}
    iterations = {WITH: 0, WITHOUT: 0}
    apart = 0.0
    for _ in range(RUNS):
        for method in (WITHOUT, WITH):
            found = [chain(profile, method) for profile in profiles]
            seconds[method].append(sum(one[0] for one in found))
            iterations[method] = sum(one[1] for one in found)
            if method == WITHOUT:
                alone = [one[2] for one in found]
            else:
                apart = max(float(np.abs(a - one[2]).max()) for a, one in zip(alone, found, strict=True))
    quick, plain = statistics.median(seconds[WITH]), statistics.median(seconds[WITHOUT])
    claim(
        "keyframes of three fingers",
        quick,
        "s",
        better="lower",
        goal=None,
        runs=RUNS,
        peer="the constant matrix alone",
        peer_value=plain,
        note=f"{iterations[WITH]} iterations instead of {iterations[WITHOUT]}, {spread(seconds[WITH], 's')}; "
        f"alone {spread(seconds[WITHOUT], 's')}; nodes at most {apart:.3f} mm apart",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
