# SPDX-License-Identifier: Apache-2.0
"""A renderer of the calibration board with a known lens and pose, for this package's tests. No node uses it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_vision.calibrating.board import Board
from softgrip_vision.calibration import Lens
from softgrip_vision.colour import Image

Array = NDArray[np.float64]

SUPERSAMPLING = 2
MODULE_PX = 12
PAPER = 235.0
INK = 25.0
DESK = 110.0

#: Where the board's centre lies in a picture of 960 x 540 [px], its rotation vector [rad] and its distance [m].
POSES = (
    ((300, 180), (0.45, 0.0, 0.0), 0.50),
    ((660, 180), (-0.45, 0.1, 0.05), 0.50),
    ((300, 360), (0.0, 0.5, 0.0), 0.50),
    ((660, 360), (0.05, -0.5, 0.1), 0.50),
    ((480, 270), (0.35, 0.35, 0.0), 0.38),
    ((480, 270), (-0.35, -0.35, 0.2), 0.38),
    ((250, 270), (0.3, -0.4, 0.0), 0.55),
    ((700, 270), (-0.3, 0.4, -0.1), 0.55),
    ((480, 150), (0.5, 0.2, 0.0), 0.45),
    ((480, 400), (-0.5, 0.2, 0.0), 0.45),
    ((480, 270), (0.0, 0.0, 0.3), 0.32),
    ((400, 300), (0.2, 0.55, -0.2), 0.42),
)


class BoardCamera:
    """Takes pictures of a board.

    Args:
        lens: the true lens.
        board: what it looks at.
        seed: of the noise.
    """

    def __init__(self, lens: Lens, board: Board, seed: int = 0) -> None:
        self.lens, self.board = lens, board
        self._random = np.random.default_rng(seed)
        paper = np.where(board.modules(), INK, PAPER).astype(np.float32)
        self._texture = np.kron(paper, np.ones((MODULE_PX, MODULE_PX), dtype=np.float32))
        step = 1.0 / SUPERSAMPLING
        columns = np.arange(lens.width * SUPERSAMPLING) * step - 0.5 + step / 2
        rows = np.arange(lens.height * SUPERSAMPLING) * step - 0.5 + step / 2
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        straight = lens.undistort(pixels)
        rays = np.ones((len(straight), 3))
        rays[:, :2] = (straight - lens.matrix[:2, 2]) / lens.matrix[(0, 1), (0, 1)]
        self._rays = rays

    def picture(self, turn: Array, place: Array, noise: float = 1.5) -> Image:
        """Return the (h, w, 3) BGR picture.

        Args:
            turn: (3,) rotation vector, board (x right, y down, z away) to camera.
            place: (3,) [m] of the board's top left corner in the camera.
            noise: [grey levels].
        """
        rotation = np.asarray(cv2.Rodrigues(np.asarray(turn, dtype=np.float64))[0])
        normal = rotation[:, 2]
        depth = float(normal @ place) / (self._rays @ normal)
        on_board = (self._rays * depth[:, None] - place) @ rotation[:, :2]
        scale = MODULE_PX * 8 / self.board.square_m
        at = (on_board * scale - 0.5).astype(np.float32)
        shape = (self.lens.height * SUPERSAMPLING, self.lens.width * SUPERSAMPLING)
        fine = cv2.remap(
            self._texture,
            at[:, 0].reshape(shape),
            at[:, 1].reshape(shape),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=DESK,
        )
        grey = cv2.resize(fine, (self.lens.width, self.lens.height), interpolation=cv2.INTER_AREA)
        grey = cv2.GaussianBlur(grey, (0, 0), 0.6)
        grey = grey + self._random.normal(0.0, noise, grey.shape).astype(np.float32)
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)

    def centred(self, turn: Array, centre: tuple[float, float], distance: float) -> tuple[Array, Array]:
        """Return (turn, place) that put the board's centre at a pixel [px], so far away [m]."""
        rotation = np.asarray(cv2.Rodrigues(np.asarray(turn, dtype=np.float64))[0])
        ray = np.array([
            (centre[0] - self.lens.matrix[0, 2]) / self.lens.matrix[0, 0],
            (centre[1] - self.lens.matrix[1, 2]) / self.lens.matrix[1, 1],
            1.0,
        ])  # fmt: skip
        half = np.array([*self.board.size_m, 0.0]) / 2
        return np.asarray(turn, dtype=np.float64), distance * ray - rotation @ half
