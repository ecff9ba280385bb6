# SPDX-License-Identifier: Apache-2.0
"""A hand over time: landmarks frame by frame, steadied into joint angles and the measures that tell grasps apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter

from softgrip_design.capture.detector import LANDMARKS, HandDetector
from softgrip_design.capture.frames import Source
from softgrip_design.errors import DesignError
from softgrip_design.landmarks import CHAINS, joint_angles

Array = NDArray[np.float64]

LONG_FINGERS = ("index", "middle", "ring", "little")
WRIST, MIDDLE_KNUCKLE = 0, 9


@dataclass(frozen=True, eq=False)
class Recording:
    """What the detector saw.

    Attributes:
        times: (frames,) [s].
        world: (frames, 21, 3) [m], NaN where no hand was found.
        pixel: (frames, 21, 2), NaN where no hand was found.
        origin: of the frames and of the landmarks.
    """

    times: Array
    world: Array
    pixel: Array
    origin: Mapping[str, str]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where a hand was found, (frames,)."""
        return np.asarray(np.isfinite(self.world).all(axis=(1, 2)))


@dataclass(frozen=True)
class Smoothing:
    """How landmarks become angles.

    Attributes:
        bridged_s: gaps up to this long are filled in a straight line; longer ones stay gaps.
        window_s: of the smoothing polynomial (Savitzky-Golay).
        order: of the polynomial: a cubic keeps the onset of a quick grasp.
        median: frames of the median before it, against single wrong landmarks.
    """

    bridged_s: float = 0.15
    window_s: float = 0.25
    order: int = 3
    median: int = 3


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """A recording as angles at a steady rate.

    Attributes:
        times: (samples,) [s].
        angles: finger -> (samples, joints) [rad], NaN in gaps.
        gap: (samples, 4), thumb tip to the tips of LONG_FINGERS in palm lengths (wrist to middle knuckle).
    """

    times: Array
    angles: Mapping[str, Array]
    gap: Array

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where there are angles, (samples,)."""
        return np.asarray(np.isfinite(self.gap).all(axis=1))


def record(source: Source, detector: HandDetector, advance: Callable[[int], None] = lambda _: None) -> Recording:
    """Find the hand in every frame.

    Args:
        source: of the frames.
        detector: of the hand.
        advance: called with the number of frames done.

    Raises:
        DesignError: a source that cannot be read, or without a hand.
    """
    times, world, pixel = [], [], []
    for frame in source.frames():
        hand = detector.find(frame.image)
        times.append(frame.time_s)
        world.append(np.full((LANDMARKS, 3), np.nan) if hand is None else hand.world)
        pixel.append(np.full((LANDMARKS, 2), np.nan) if hand is None else hand.pixel)
        advance(len(times))
    recording = Recording(
        np.array(times), np.array(world), np.array(pixel), {"source": source.origin, "method": detector.name}
    )
    if recording.seen.sum() < 2:
        raise DesignError(
            f"{source.origin}: expected a hand, found one in {recording.seen.sum()} of {len(times)} frames; show one "
            "whole hand, well lit, the palm or the thumb's side towards the camera"
        )
    return recording


def steady(recording: Recording, smoothing: Smoothing | None = None) -> RecordedMotion:
    """Bridge short gaps, bring the frames to a steady rate, and smooth every joint angle."""
    chosen = smoothing or Smoothing()
    seen = np.flatnonzero(recording.seen)
    period = float(np.median(np.diff(recording.times)))
    times = np.arange(recording.times[seen[0]], recording.times[seen[-1]] + period / 2, period)
    flat = recording.world[seen].reshape(len(seen), -1)
    world = np.stack([np.interp(times, recording.times[seen], column) for column in flat.T], axis=1)
    landmarks = world.reshape(len(times), LANDMARKS, 3)
    after = np.searchsorted(recording.times[seen], times, side="left").clip(1, len(seen) - 1)
    gap_s = recording.times[seen][after] - recording.times[seen][after - 1]
    exact = np.isclose(recording.times[seen][after], times) | np.isclose(recording.times[seen][after - 1], times)
    landmarks[(gap_s > max(chosen.bridged_s, 1.5 * period)) & ~exact] = np.nan
    angles = {finger: _smoothed(joint_angles(landmarks, finger), period, chosen) for finger in CHAINS}
    palm = np.linalg.norm(landmarks[:, MIDDLE_KNUCKLE] - landmarks[:, WRIST], axis=1)
    thumb_tip = landmarks[:, CHAINS["thumb"][-1]]
    tips = np.stack([landmarks[:, CHAINS[finger][-1]] for finger in LONG_FINGERS], axis=1)
    gap = np.linalg.norm(tips - thumb_tip[:, None], axis=2) / palm[:, None]
    return RecordedMotion(times, angles, _smoothed(gap, period, chosen))


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the half-open index ranges where flags are set."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _smoothed(values: Array, period: float, smoothing: Smoothing) -> Array:
    """Smooth each stretch between gaps by itself, (samples, columns)."""
    result = np.full_like(values, np.nan)
    requested = max(smoothing.order + 2, round(smoothing.window_s / period)) // 2 * 2 + 1
    for start, end in runs(np.asarray(np.isfinite(values).all(axis=1))):
        piece = median_filter(values[start:end], size=(smoothing.median, 1), mode="nearest")
        window = min(requested, (end - start - 1) // 2 * 2 + 1)
        if window > smoothing.order:
            piece = savgol_filter(piece, window, smoothing.order, axis=0, mode="interp")
        result[start:end] = piece
    return result
