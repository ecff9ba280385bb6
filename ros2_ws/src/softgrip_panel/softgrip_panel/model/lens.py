# SPDX-License-Identifier: Apache-2.0
"""The lens by views of the printed board, taken one by one from the live camera."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Final

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say
from softgrip_vision.calibrating import MAX_VIEWS, Board, BoardView, LensFit, calibrate_lens, covered_cells, is_new_view
from softgrip_vision.encoded_image import decode
from softgrip_vision.errors import FrameError, VisionError

#: The board that `calibrate_camera target` draws: squares across and down, side [mm].
COLUMNS, ROWS, SQUARE_MM = 11, 7, 24.0
#: Side of the plane's board.
PLANE_COLUMNS, PLANE_ROWS, PLANE_SQUARE_MM = 9, 6, 16.0
_FOLDER_MODE: Final = 0o700


class LensViews:
    """Views of one board and what they say of the lens; pictures are kept in a folder for the commands.

    Args:
        folder: for the pictures, made when the first is taken; None = kept nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.board = Board(COLUMNS, ROWS, SQUARE_MM * 1e-3)
        self.views: tuple[BoardView, ...] = ()
        self.fit: LensFit | None = None
        self.problem = ""

    def start(self, columns: int, rows: int, square_mm: float) -> None:
        """Forget all views, and look for another board.

        Raises:
            PanelError: no such board can be.
        """
        try:
            self.board = Board(columns, rows, square_mm * 1e-3)
        except VisionError as error:
            raise PanelError(str(error)) from error
        self.views, self.fit, self.problem = (), None, ""
        if self.folder is not None and self.folder.is_dir():
            shutil.rmtree(self.folder, ignore_errors=True)

    def add_view(self, jpeg: bytes) -> BoardView:
        """Take a view; tenths of a second of work, so not in the web's own thread.

        Raises:
            PanelError: no board in it, nothing new in it, another size, or enough of them.
        """
        if len(self.views) >= MAX_VIEWS:
            raise PanelError(say("error.views_full", limit=MAX_VIEWS, found=len(self.views)))
        try:
            image = decode(jpeg)
        except FrameError as error:
            raise PanelError(say("error.picture", error=error)) from error
        view = self.board.find(image, f"view {len(self.views) + 1}")
        if view is None:
            raise PanelError(say("error.board", columns=self.board.columns, rows=self.board.rows))
        if self.views and view.size != self.views[0].size:
            raise PanelError(say("error.picture_size", expected=self.views[0].size, found=view.size))
        if not is_new_view(view, self.views):
            raise PanelError(say("error.board_same_place"))
        self._keep(jpeg, len(self.views) + 1)
        self.views, self.fit, self.problem = (*self.views, view), None, ""
        return view

    def find_lens(self) -> None:
        """Fit; `fit` has the lens, or `problem` says which views to add."""
        try:
            self.fit, self.problem = calibrate_lens(self.views), ""
        except VisionError as error:
            self.fit, self.problem = None, str(error)

    def covered(self) -> tuple[tuple[bool, ...], ...]:
        """Return which cells of the picture have shown a corner, row by row."""
        return tuple(tuple(bool(one) for one in row) for row in covered_cells(self.views))

    def commands(self, calibration_file: str, finger: str) -> tuple[str, ...]:
        """Return the commands that do the same with the kept pictures, and the plane's with pictures of its board."""
        pictures = str(self.folder) if self.folder is not None else "PICTURES"
        file = calibration_file or "camera.yaml"
        board = f"--columns {self.board.columns} --rows {self.board.rows} --square-mm {self.board.square_m * 1e3:g}"
        plane = f"--columns {PLANE_COLUMNS} --rows {PLANE_ROWS} --square-mm {PLANE_SQUARE_MM:g}"
        calibrate = "ros2 run softgrip_vision calibrate_camera"
        return (
            f"{calibrate} target {board} --out board.pdf",
            f"{calibrate} lens {pictures} {board} --out {file}",
            f"{calibrate} target --plane {plane} --out plane.pdf",
            f"{calibrate} plane {pictures} {plane} --calibration {file} --finger {finger}",
        )

    def _keep(self, jpeg: bytes, number: int) -> None:
        if self.folder is None:
            return
        try:
            self.folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
            (self.folder / f"view_{number:02d}.jpg").write_bytes(jpeg)
        except OSError as error:
            raise PanelError(say("error.view_not_kept", folder=self.folder, error=error)) from error
