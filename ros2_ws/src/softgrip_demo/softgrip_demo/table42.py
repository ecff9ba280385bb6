# SPDX-License-Identifier: Apache-2.0
"""Every product with every finger set beside thesis Table 4.2: rules of agreement, confusion, success rates.

The table does not say how often each grasp was tried, only success, partial success or failure. Its last row (80 %,
87 %, 20 %) counts full successes alone. Two rules follow from that:

* A single grasp agrees with "success" when it is GRIPPED, with "failure" when it is SLIPPED or EMPTY, and with
  "partial" when the product was taken at all (GRIPPED or SLIPPED: "initially grasped, sustained holding difficult",
  4.3.3). TENDON_FAULT and ABORTED agree with nothing.
* Repeated grasps agree when the mark of their GRIPPED share is the table's: success from 75 %, failure below 25 %.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

SHIPPED: Final = Path(__file__).parent / "data" / "table42.json"

MARKS: Final = ("success", "partial", "failure")
OUTCOMES: Final = ("GRIPPED", "SLIPPED", "EMPTY", "other")

#: Last row of Table 4.2 [%].
THESIS_RATE_PERCENT: Final = {"power": 80, "pinch": 87, "hook": 20}

_AGREES: Final = {
    "success": {"GRIPPED"},
    "partial": {"GRIPPED", "SLIPPED"},
    "failure": {"SLIPPED", "EMPTY"},
}
_SUCCESS_FROM: Final = 0.75
_FAILURE_BELOW: Final = 0.25


def agrees(outcome: str, mark: str) -> bool:
    """Return whether the outcome of one grasp agrees with a mark of the table."""
    return outcome in _AGREES.get(mark, set())


def mark_of(outcomes: Sequence[str]) -> str:
    """Return the mark that repeated grasps earn by the share of GRIPPED."""
    share = outcomes.count("GRIPPED") / len(outcomes)
    if share >= _SUCCESS_FROM:
        return "success"
    return "failure" if share < _FAILURE_BELOW else "partial"


@dataclass(frozen=True)
class Tried:
    """One product with one finger set, tried some times."""

    product: str
    finger_set: str
    mark: str
    outcomes: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """The trials earn the table's mark."""
        return mark_of(self.outcomes) == self.mark


@dataclass(frozen=True)
class CrossCheck:
    """Table 4.2 measured; `how` says where and with which seeds."""

    how: str
    tried: tuple[Tried, ...]

    def confusion(self) -> dict[str, dict[str, int]]:
        """Return counts of single outcomes by the table's mark."""
        counts = {mark: Counter[str]() for mark in MARKS}
        for item in self.tried:
            counts[item.mark].update(outcome if outcome in OUTCOMES else "other" for outcome in item.outcomes)
        return {mark: {outcome: counts[mark][outcome] for outcome in OUTCOMES} for mark in MARKS}

    def rates_percent(self) -> dict[str, float]:
        """Return the share of products that each finger set earns "success" with [%], as the table's last row."""
        sets = dict.fromkeys(item.finger_set for item in self.tried)
        rates = {}
        for finger_set in sets:
            of_it = [mark_of(item.outcomes) for item in self.tried if item.finger_set == finger_set]
            rates[finger_set] = 100.0 * of_it.count("success") / len(of_it)
        return rates

    def save(self, path: Path) -> None:
        """Write as JSON, one line a product and set."""
        rows = [
            json.dumps({"product": t.product, "set": t.finger_set, "mark": t.mark, "outcomes": t.outcomes})
            for t in self.tried
        ]
        path.write_text(f'{{"how": {json.dumps(self.how)}, "tried": [\n' + ",\n".join(rows) + "\n]}\n")


def load(path: Path = SHIPPED) -> CrossCheck | None:
    """Read what `save` wrote; None when it was never measured."""
    if not path.exists():
        return None
    raw = json.loads(path.read_text())
    tried = tuple(Tried(r["product"], r["set"], r["mark"], tuple(r["outcomes"])) for r in raw["tried"])
    return CrossCheck(str(raw["how"]), tried)


def page_view(check: CrossCheck | None) -> Mapping[str, object] | None:
    """Return what the report shows of it, None when there is nothing."""
    if check is None:
        return None
    products = dict.fromkeys(item.product for item in check.tried)
    sets = list(dict.fromkeys(item.finger_set for item in check.tried))
    found = {(item.product, item.finger_set): item for item in check.tried}
    return {
        "how": check.how,
        "sets": sets,
        "rows": [(product, [found[product, finger_set] for finger_set in sets]) for product in products],
        "outcomes": OUTCOMES,
        "confusion": check.confusion(),
        "agreeing": sum(item.agrees for item in check.tried),
        "total": len(check.tried),
        "rates": {name: (rate, THESIS_RATE_PERCENT.get(name)) for name, rate in check.rates_percent().items()},
    }
