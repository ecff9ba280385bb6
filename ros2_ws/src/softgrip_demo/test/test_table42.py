# SPDX-License-Identifier: Apache-2.0
"""Agreement with Table 4.2, by rules that are written down; expected values are the thesis' own table."""

from __future__ import annotations

from pathlib import Path

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_demo.table42 import THESIS_RATE_PERCENT, CrossCheck, Tried, agrees, load, mark_of, page_view


@pytest.mark.parametrize(
    ("mark", "agreeing"),
    [("success", {"GRIPPED"}), ("partial", {"GRIPPED", "SLIPPED"}), ("failure", {"SLIPPED", "EMPTY"})],
)
def test_a_single_grasp_agrees_by_its_outcome(mark: str, agreeing: set[str]) -> None:
    outcomes = {"GRIPPED", "SLIPPED", "EMPTY", "TENDON_FAULT", "ABORTED"}
    assert {outcome for outcome in outcomes if agrees(outcome, mark)} == agreeing


@pytest.mark.parametrize(
    ("gripped", "mark"), [(8, "success"), (6, "success"), (5, "partial"), (2, "partial"), (1, "failure")]
)
def test_eight_grasps_earn_a_mark_by_their_share(gripped: int, mark: str) -> None:
    assert mark_of(["GRIPPED"] * gripped + ["SLIPPED"] * (8 - gripped)) == mark


def test_the_tables_own_marks_give_its_last_row(tmp_path: Path) -> None:
    """80 %, 87 % and 20 % are 12, 13 and 3 of 15: the thesis counts full successes only."""
    verdicts = {"success": ("GRIPPED",) * 2, "partial": ("GRIPPED", "SLIPPED"), "failure": ("EMPTY", "SLIPPED")}
    tried = tuple(
        Tried(product.id, finger_set, str(mark), verdicts[str(mark)])
        for product in read_catalogue().products.values()
        for finger_set, mark in product.marks.items()
    )
    check = CrossCheck("told", tried)
    assert {name: round(rate) for name, rate in check.rates_percent().items()} == THESIS_RATE_PERCENT
    assert all(item.agrees for item in tried)
    assert check.confusion()["failure"] == {"GRIPPED": 0, "SLIPPED": 14, "EMPTY": 14, "other": 0}
    check.save(tmp_path / "told.json")
    assert load(tmp_path / "told.json") == check
    view = page_view(check)
    assert view is not None
    assert view["agreeing"] == view["total"] == 45


def test_what_was_never_measured_is_not_shown(tmp_path: Path) -> None:
    assert page_view(load(tmp_path / "missing.json")) is None
