# SPDX-License-Identifier: Apache-2.0
"""The camera device: takes a frame of the true finger at each exposure that it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2

from softgrip_emulator.camera.scene import Light

if TYPE_CHECKING:
    from collections.abc import Callable

    from softgrip_emulator.camera.exposure_sample import ExposureSample
    from softgrip_emulator.camera.scene import Scene
    from softgrip_emulator.camera.stream import FrameBoard


class Camera:
    """Exposes, compresses and pins frames to a board.

    Args:
        scene: what is rendered.
        board: where frames go.
        jpeg_quality: 1..100.
        random: 0..1, for dropped frames.
    """

    def __init__(
        self,
        scene: Scene,
        board: FrameBoard,
        *,
        jpeg_quality: int = 88,
        random: Callable[[], float] | None = None,
    ) -> None:
        self.frames_taken = 0
        self._scene = scene
        self._board = board
        self._quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        self._random = random or (lambda: 1.0)
        self._frozen_data: bytes | None = None

    def render_frame(self, sample: ExposureSample) -> bytes | None:
        """Return one compressed frame, None when the sensor lost it."""
        faults = sample.faults
        if faults.drop_share > 0.0 and self._random() < faults.drop_share:
            return None
        if not faults.frozen or self._frozen_data is None:
            image = self._scene.render(
                sample.pose, sample.before, Light(faults.gain, blur_px=faults.blur_px), faults.missing_marker
            )
            _, data = cv2.imencode(".jpg", image, self._quality)
            self.frames_taken += 1
            self._frozen_data = data.tobytes()
        return self._frozen_data

    def expose(self, sample: ExposureSample) -> bool:
        """Take a frame and pin it; return whether there was one to pin."""
        data = self.render_frame(sample)
        if data is not None:
            self._board.pin(data, sample.stamp_s)
        return data is not None

    def prepare(self) -> None:
        """Do what can be done before the next exposure."""
        self._scene.prepare()
