# SPDX-License-Identifier: Apache-2.0
"""The camera device: takes frames of the true finger at its own rate while somebody looks."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

import cv2

from softgrip_emulator.camera.scene import Light, Scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from softgrip_emulator.camera.exposure_sample import ExposureSample
    from softgrip_emulator.camera.stream import FrameBoard

_IDLE_LOOK_S: Final = 0.05


class Camera:
    """Exposes, compresses and pins frames to a board, in a thread of its own.

    Args:
        scene: what is rendered.
        board: where frames go.
        look: gives what the exposure just over has seen; OSError or EOFError when there is nothing left to look at.
        fps: frames a second.
        jpeg_quality: 1..100.
        random: 0..1, for dropped frames.
    """

    def __init__(
        self,
        scene: Scene,
        board: FrameBoard,
        look: Callable[[], ExposureSample],
        *,
        fps: float = 30.0,
        jpeg_quality: int = 88,
        random: Callable[[], float] | None = None,
    ) -> None:
        self.frames_taken = 0
        self._scene = scene
        self._board = board
        self._look = look
        self._period_s = 1.0 / fps
        self._quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        self._random = random or (lambda: 1.0)
        self._frozen_data: bytes | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    def start(self) -> None:
        """Take frames until `close`."""
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def take(self) -> tuple[bytes | None, float]:
        """One compressed frame, or None when the sensor lost it, and its stamp [s]."""
        look = self._look()
        faults = look.faults
        if faults.drop_share > 0.0 and self._random() < faults.drop_share:
            return None, look.stamp_s
        if not faults.frozen or self._frozen_data is None:
            image = self._scene.render(look.pose, look.before, Light(gain=faults.gain))
            _, data = cv2.imencode(".jpg", image, self._quality)
            self.frames_taken += 1
            self._frozen_data = data.tobytes()
        return self._frozen_data, look.stamp_s

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stop.is_set():
            if self._board.viewers == 0:
                self._stop.wait(_IDLE_LOOK_S)
                due_s = time.monotonic()
                continue
            try:
                data, stamp_s = self.take()
            except (OSError, EOFError):
                return
            if data is not None:
                self._board.pin(data, stamp_s)
            due_s = max(due_s + self._period_s, time.monotonic())
            # what can be done ahead is done when the frame just taken is on its way
            self._stop.wait(0.5 * (due_s - time.monotonic()))
            self._scene.prepare()
            self._stop.wait(due_s - time.monotonic())
