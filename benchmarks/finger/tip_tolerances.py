# SPDX-License-Identifier: Apache-2.0
"""What the first closings of development fingers make of the stated tolerances, and whether that holds for others.

Each cell is one of `tip_interval`, from other seeds. Half of the fingers correct the tolerances (`finger/tolerances`)
that the tips of the other half's first closings are judged by, and the other way round: the normalised error is 1 where
deviations are what they say. The last line on stderr is what all of them together make of the tolerances: the numbers
of `softgrip_model.finger.uncertainty.PRIOR`, which rounds them.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from tip_interval import FROM_M, PULL_M, SETS, SPEED_M_PER_S, Array, Closings

from softgrip_model.finger.closing_samples import ClosingCollector, ClosingInstant
from softgrip_model.finger.learning import SAMPLING, Knowledge
from softgrip_model.finger.tolerances import calibrated
from softgrip_model.finger.uncertainty import STATED, Causes, Uncertainty
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.virtual_cell import SLOTS

SEEDS = range(20001, 20032)


@dataclasses.dataclass(frozen=True, eq=False)
class First:
    """The first closing of a finger: what it may differ in, what was seen, and where its tip truly was."""

    causes: Causes
    closing: tuple[ClosingInstant, ...]
    pulled_mm: Array
    tip_mm: Array

    def errors(self, prior: Uncertainty) -> Array:
        """Return the true tip less the predicted one, in standard deviations."""
        found = Knowledge.prior(dataclasses.replace(self.causes, prior=prior)).predict(self.pulled_mm)
        assert found is not None
        return np.asarray((self.tip_mm - found.tip_mm) / found.tip_stddev_mm)


class FirstClosing(Closings):
    """Collects what the camera sees of a closing."""

    def record(self) -> First:
        """Close once."""
        cell, collector, true = self.cell, ClosingCollector(SAMPLING), []
        ticket = cell.move(PULL_M, SPEED_M_PER_S, slots=SLOTS[:1])
        while cell.controller.result(ticket)[0] is None:
            cell.cycle()
            sample = cell.samples()[0]
            if sample.pulled_length_m > FROM_M:
                true.append([sample.pulled_length_m, *cell.tip_m()])
            if self.has_frame():
                pulled_mm, tip_mm = 1e3 * sample.pulled_length_m, 1e3 * self.seen_tip()
                (found,) = cell.session.predict([sample], SLOTS[:1])
                instant = ClosingInstant(sample.stamp, pulled_mm, tip_mm, sample.tension, found.tension)
                collector.add(instant, pulling=True, free=True)
        closing = collector.add(instant, pulling=False, free=True)
        path_mm = 1e3 * np.array(true)
        causes = cell.session.configuration.causes(SLOTS[0], STATED)
        return First(causes, closing, path_mm[:, 0], path_mm[:, 1:])


def record(seed: int, finger_set: str) -> First:
    """Return the first closing of a cell."""
    return FirstClosing(seed, finger_set).record()


def judged(fingers: list[First], prior: Uncertainty) -> Array:
    """Return the normalised errors of all tips."""
    return np.concatenate([one.errors(prior).ravel() for one in fingers])


def root_mean_square(errors: Array) -> float:
    """Return it."""
    return float(np.sqrt(np.mean(errors**2)))


def main() -> int:
    """Print the claim."""
    no_options(__doc__)
    names = [SETS[i % len(SETS)] for i in range(len(SEEDS))]
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        fingers = list(pool.map(record, SEEDS, names))
    halves = [[one for i, one in enumerate(fingers) if (i // len(SETS)) % 2 == half] for half in (0, 1)]
    errors = []
    for mine, others in (halves, halves[::-1]):
        prior = calibrated(STATED, [(one.causes, one.closing) for one in mine])
        errors.append(judged(others, prior))
        print(f"half: {prior}", file=sys.stderr)
    print(f"all: {calibrated(STATED, [(one.causes, one.closing) for one in fingers])}", file=sys.stderr)
    unseen, stated = np.concatenate(errors), judged(fingers, STATED)
    claim(
        "normalised error of first tips", root_mean_square(unseen), "1", better="lower", goal=1.0, runs=len(fingers),
        peer="stated tolerances", peer_value=root_mean_square(stated),
        note=f"tolerances from the other half; 95 % intervals hold {100.0 * np.mean(np.abs(unseen) <= 1.96):.0f} % "
        f"(stated: {100.0 * np.mean(np.abs(stated) <= 1.96):.0f} %)",
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
