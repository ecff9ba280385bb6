# SPDX-License-Identifier: Apache-2.0
"""The board as a page to print, at true scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from softgrip_vision.calibrating.board import MODULES_PER_SQUARE, Board
from softgrip_vision.errors import CalibrationError

#: [m] width and height, landscape.
PAGES = {"A4": (0.297, 0.210), "A3": (0.420, 0.297), "letter": (0.2794, 0.2159)}
MARGIN_M = 0.010
#: [m] left of the board for the cross that marks the first joint, and below it for the scale bar.
CROSS_ROOM_M = 0.030
BAR_ROOM_M = 0.014
BAR_M = 0.100
INCH_M = 0.0254


def cross_origin(board: Board) -> tuple[float, float]:
    """Return where the printed cross lies in board coordinates [m]: left of the board, at half its height."""
    return -0.010, board.size_m[1] / 2


def draw_target(board: Board, page: str = "A4", *, base_marker_m: float | None = None) -> Figure:
    """Return the page.

    Args:
        board: to be printed.
        page: of PAGES.
        base_marker_m: [m] distance of the base marker behind the first joint: draws the cross of a finger's plane and
            a ring for the base marker, where it fits; None = board alone.

    Raises:
        CalibrationError: when the board does not fit the page.
    """
    if page not in PAGES:
        raise CalibrationError(f"expected a page of {', '.join(PAGES)}, found '{page}'")
    width, height = PAGES[page]
    room = CROSS_ROOM_M if base_marker_m is not None else 0.0
    need = (board.size_m[0] + room + 2 * MARGIN_M, board.size_m[1] + BAR_ROOM_M + 2 * MARGIN_M)
    if need[0] > width + 1e-9 or need[1] > height + 1e-9:
        raise CalibrationError(
            f"expected a board that fits {page} ({width * 1e3:.0f} x {height * 1e3:.0f} mm), found that it needs "
            f"{need[0] * 1e3:.0f} x {need[1] * 1e3:.0f} mm; take fewer or smaller squares"
        )
    figure = Figure(figsize=(width / INCH_M, height / INCH_M))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, width), ylim=(height, 0.0))
    axes.set_axis_off()
    left, top = MARGIN_M + room, MARGIN_M
    _paint_modules(axes, board, left, top)
    if base_marker_m is not None:
        _paint_cross(axes, board, left, top, base_marker_m)
    _paint_bar(axes, board, left, top + board.size_m[1] + 0.006)
    return figure


def write_target(figure: Figure, path: Path) -> None:
    """Write the page as PDF."""
    with path.open("wb") as stream:
        FigureCanvasPdf(figure).print_pdf(stream)


def _paint_modules(axes: Any, board: Board, left: float, top: float) -> None:
    """Paint each row's runs of black modules as one rectangle, so that no hairline can show between modules."""
    module = board.square_m / MODULES_PER_SQUARE
    for row, modules in enumerate(board.modules()):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], modules.astype(int), [0]])))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            place = (left + start * module, top + row * module)
            axes.add_patch(Rectangle(place, (end - start) * module, module, facecolor="black", linewidth=0))


def _paint_cross(axes: Any, board: Board, left: float, top: float, base_marker_m: float) -> None:
    x, y = cross_origin(board)
    x, y = left + x, top + y
    axes.plot([x - 0.006, x + 0.006], [y, y], color="black", linewidth=0.5)
    axes.plot([x, x], [y - 0.006, y + 0.006], color="black", linewidth=0.5)
    axes.text(x, y - 0.007, "joint 0", fontsize=6, ha="center", va="bottom")
    axes.text(x + 0.0055, y + 0.002, "x", fontsize=6, ha="left", va="top")
    if x - base_marker_m > 0.004:
        axes.add_patch(Circle((x - base_marker_m, y), 0.0025, fill=False, linewidth=0.5))


def _paint_bar(axes: Any, board: Board, left: float, y: float) -> None:
    end = left + min(BAR_M, board.size_m[0])
    axes.plot([left, end], [y, y], color="black", linewidth=0.6)
    for x in (left, end):
        axes.plot([x, x], [y - 0.002, y + 0.002], color="black", linewidth=0.6)
    kind = "ChArUco 4x4_1000" if board.charuco else "chessboard"
    squares = f"{board.columns} x {board.rows} squares of {board.square_m * 1e3:g} mm"
    text = f"print at 100 %: this line is {(end - left) * 1e3:.1f} mm long.   {kind}, {squares}"
    axes.text(left, y + 0.003, text, fontsize=7, va="top")
