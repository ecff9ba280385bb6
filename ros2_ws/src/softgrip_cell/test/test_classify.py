# SPDX-License-Identifier: Apache-2.0
"""New products: the rules must say of the 15 known ones what Table 4.1 says, though they never saw it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.classify import classify, flexion_shares, read_demonstration
from softgrip_cell.errors import CatalogueError
from softgrip_cell.products import GraspType, ProductShape


@pytest.mark.parametrize("product", read_catalogue().products.values(), ids=lambda product: product.id)
def test_dimensions_alone_give_table_4_1(product) -> None:
    found = classify(product.shape, product.size_m, product.fragility)
    assert found.grasp is product.grasp
    assert "mm" in found.reasons[0]


# Joint angles of a closing [deg] as the thesis describes them in words (4.2.1).
@pytest.mark.parametrize(
    ("closed_deg", "grasp"),
    [((60, 55, 50), GraspType.POWER), ((70, 10, 5), GraspType.PINCH), ((5, 70, 50), GraspType.HOOK)],
)
def test_a_hand_shows_the_grasp(closed_deg: tuple[float, ...], grasp: GraspType) -> None:
    frames = [[math.radians(angle) * i / 49 for angle in closed_deg] for i in range(50)]
    shares = flexion_shares(frames)
    assert sum(shares) == pytest.approx(1.0)
    ball = classify(ProductShape.BALL, (0.07, 0.07, 0.07), shares=shares)
    assert ball.grasp is grasp
    assert (ball.confidence > 0.6) == (grasp is GraspType.POWER), "agreement with the dimensions raises the confidence"
    assert any("disagree" in reason for reason in ball.reasons) == (grasp is not GraspType.POWER)


def test_what_does_not_fit_into_the_hand_is_refused() -> None:
    with pytest.raises(CatalogueError, match="the smallest side is 150 mm, the hand opens 100 mm"):
        classify(ProductShape.BALL, (0.15, 0.15, 0.15))


@pytest.mark.parametrize("size", [(0.01, 0.02, 0.03), (math.nan, 0.1, 0.1), (0.1, 0.1, 0.0), (0.1, 0.1, -0.1)])
def test_impossible_sizes_are_refused(size) -> None:
    with pytest.raises(CatalogueError, match="length >= width >= height"):
        classify(ProductShape.BALL, size)


@pytest.mark.parametrize(
    ("frames", "expected"),
    [([], "found shape"), ([[0.0, 0.0]], "found shape"), ([[0, 0, 0], [0.1, 0.1, 0.1]], "found 17"),
     ([[0, 0, 0], [1, math.nan, 1]], "finite")],
)  # fmt: skip
def test_demonstrations_that_show_nothing_are_refused(frames, expected: str) -> None:
    with pytest.raises(CatalogueError, match=expected):
        flexion_shares(frames)


def test_a_recording_is_read_with_heading_and_comment(tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    path.write_text("# power, right hand\ntime,mcp,pip,dip\n0.0,0,0,0\n0.1,1.0,0.9,0.8\n")
    assert read_demonstration(path) == [[0.0, 0.0, 0.0], [1.0, 0.9, 0.8]]
    path.write_text("0,0,0\n1,x,1\n")
    with pytest.raises(CatalogueError, match="row 2: expected numbers"):
        read_demonstration(path)
