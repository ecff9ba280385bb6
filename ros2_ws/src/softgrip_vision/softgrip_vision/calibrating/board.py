# SPDX-License-Identifier: Apache-2.0
"""The printed board: ChArUco or plain chessboard, and finding it in an image.

Board coordinates: origin at the pattern's top left corner, x right, y down [m].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.colour import Image
from softgrip_vision.errors import CalibrationError

Array = NDArray[np.float64]

#: A ChArUco square is 8 modules wide; its marker is 4 bits and a border of 1 on each side, so 6: all edges on one grid.
MODULES_PER_SQUARE = 8
MODULES_PER_MARKER = 6
#: Fewer corners say too little about a view.
MIN_CORNERS = 8


@dataclass(frozen=True)
class BoardView:
    """The board as seen in one image.

    Attributes:
        name: of the image, for messages.
        points: (k, 2) [m] corners on the board.
        pixels: (k, 2) [px] the same corners in the image.
        size: (width, height) [px] of the image.
    """

    name: str
    points: Array
    pixels: Array
    size: tuple[int, int]


def has_charuco() -> bool:
    """Whether this OpenCV finds ChArUco boards: 4.7 and later do; Ubuntu 24.04 has 4.6."""
    return hasattr(getattr(cv2, "aruco", None), "CharucoDetector")


@dataclass(frozen=True)
class Board:
    """A board.

    Attributes:
        columns, rows: number of squares.
        square_m: [m] side of a square, as measured on the print.
        charuco: with markers in its white squares (may be partly out of view), the default where this OpenCV finds
            them; else a chessboard.
    """

    columns: int
    rows: int
    square_m: float
    charuco: bool = field(default_factory=has_charuco)

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 40 and 3 <= self.rows <= 40 and 0.001 <= self.square_m <= 0.5):
            raise CalibrationError(
                "expected a board of 3 .. 40 squares each way, of 1 .. 500 mm, found "
                f"{self.columns}x{self.rows} of {self.square_m * 1e3:g} mm"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height [m]."""
        return self.columns * self.square_m, self.rows * self.square_m

    @cached_property
    def _pattern(self) -> Any:
        if not has_charuco():
            raise CalibrationError(
                f"expected OpenCV 4.7 or later for a ChArUco board, found {cv2.__version__}; use a chessboard "
                "(calibrate_camera --chessboard), or pip's opencv-python-headless"
            )
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
        marker = self.square_m * MODULES_PER_MARKER / MODULES_PER_SQUARE
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, marker, dictionary)

    @cached_property
    def _detector(self) -> Any:
        pattern = self._pattern
        return cv2.aruco.CharucoDetector(pattern)

    def modules(self) -> NDArray[np.bool_]:
        """Return (rows * 8, columns * 8) black modules of the pattern."""
        if self.charuco:
            size = (self.columns * MODULES_PER_SQUARE, self.rows * MODULES_PER_SQUARE)
            return np.asarray(self._pattern.generateImage(size, marginSize=0)) < 128
        row, column = np.indices((self.rows, self.columns))
        return np.kron((row + column) % 2 == 0, np.ones((MODULES_PER_SQUARE,) * 2, dtype=bool))

    def find(self, image: Image, name: str = "image") -> BoardView | None:
        """Return the board as seen in an (h, w, 3) BGR image; None when it is not, or too little of it."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        points, pixels = self._find_charuco(grey) if self.charuco else self._find_chessboard(grey)
        if len(pixels) < MIN_CORNERS:
            return None
        return BoardView(name, points, pixels, (image.shape[1], image.shape[0]))

    def _find_charuco(self, grey: NDArray[np.uint8]) -> tuple[Array, Array]:
        corners, identities, _, _ = self._detector.detectBoard(grey)
        if identities is None:
            return np.empty((0, 2)), np.empty((0, 2))
        known = np.asarray(self._pattern.getChessboardCorners(), dtype=np.float64)[identities.ravel(), :2]
        return known, _refine(grey, np.asarray(corners, dtype=np.float32), known, self.square_m)

    def _find_chessboard(self, grey: NDArray[np.uint8]) -> tuple[Array, Array]:
        inner = (self.columns - 1, self.rows - 1)
        found, corners = cv2.findChessboardCornersSB(grey, inner, cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return np.empty((0, 2)), np.empty((0, 2))
        column, row = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        known = np.column_stack([column.ravel(), row.ravel()]) * self.square_m
        return known, np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _refine(grey: NDArray[np.uint8], corners: NDArray[np.float32], known: Array, square_m: float) -> Array:
    """Return (k, 2) corners [px] refined on the image.

    OpenCV's ChArUco detector (4.6 to 4.11 at least) gives corners that lie half a pixel right of and below where its
    own cornerSubPix and the chessboard finder put them, and the latter are right (test_calibrating.py).
    """
    if len(corners) < MIN_CORNERS:
        return np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    spread = np.ptp(corners.reshape(-1, 2), axis=0).max() / np.ptp(known, axis=0).max()
    module_px = float(spread) * square_m / MODULES_PER_SQUARE
    half = int(np.clip(0.8 * module_px, 2, 7))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    start = np.ascontiguousarray(corners.reshape(-1, 1, 2) - np.float32(0.5))
    refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)
