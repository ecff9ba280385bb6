# SPDX-License-Identifier: Apache-2.0
"""The 21 landmarks of a hand in a picture, by MediaPipe's hand landmarker (its models come with the wheel: no network).

MediaPipe is an extra: nothing else of the suite needs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_design.capture.frames import Image
from softgrip_design.errors import DesignError

Array = NDArray[np.float64]

LANDMARKS = 21
INSTALL = "pip install --no-deps -r requirements-capture.lock"


@dataclass(frozen=True, eq=False)
class DetectedHand:
    """One hand.

    Attributes:
        world: (21, 3) [m], about the hand's own centre.
        pixel: (21, 2), x right, y down.
        score: of the handedness, 0 to 1.
    """

    world: Array
    pixel: Array
    score: float


class HandDetector(Protocol):
    """Finds the hand in one picture after the other."""

    name: str

    def find(self, image: Image) -> DetectedHand | None:
        """Return the hand of a BGR picture, None where there is none."""


class MediaPipeDetector:
    """MediaPipe Hands 0.10.21, tracking one hand through a video."""

    def __init__(self, confidence: float = 0.5) -> None:
        """Load the models.

        Raises:
            DesignError: MediaPipe is not installed.
        """
        try:
            import mediapipe  # noqa: PLC0415  an extra
            from mediapipe.python.solutions.hands import Hands  # noqa: PLC0415
        except ImportError as error:
            raise DesignError(
                f"expected MediaPipe for capturing hands, found none ({error}); install it: {INSTALL}"
            ) from error
        self.name = f"MediaPipe {mediapipe.__version__} world landmarks"
        self._hands: Any = Hands(
            static_image_mode=False,
            max_num_hands=1,
            model_complexity=1,
            min_detection_confidence=confidence,
            min_tracking_confidence=confidence,
        )

    def find(self, image: Image) -> DetectedHand | None:
        """Return the hand of a BGR picture, None where there is none."""
        found = self._hands.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        if not found.multi_hand_world_landmarks:
            return None
        world = np.array([[p.x, p.y, p.z] for p in found.multi_hand_world_landmarks[0].landmark])
        relative = np.array([[p.x, p.y] for p in found.multi_hand_landmarks[0].landmark])
        score = float(found.multi_handedness[0].classification[0].score)
        return DetectedHand(world, relative * (image.shape[1], image.shape[0]), score)

    def close(self) -> None:
        """Free the models."""
        self._hands.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
