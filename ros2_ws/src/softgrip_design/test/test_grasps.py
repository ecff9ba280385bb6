# SPDX-License-Identifier: Apache-2.0
"""Grasps of a hand that is drawn, so that every angle in it is known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from softgrip_design.capture.grasps import DetectedGrasp, Kind, find_grasps
from softgrip_design.capture.recording import LONG_FINGERS, Recording, steady
from softgrip_design.errors import DesignError
from softgrip_design.target import target

Array = NDArray[np.float64]
RATE = 30.0
OPEN = dict.fromkeys(LONG_FINGERS, (10.0, 8.0, 6.0))
POSES: dict[str, dict[str, tuple[float, float, float]]] = {
    "power": dict.fromkeys(LONG_FINGERS, (70.0, 90.0, 50.0)),
    "hook": dict.fromkeys(LONG_FINGERS, (15.0, 95.0, 60.0)),
    "pinch": OPEN | {"index": (45.0, 30.0, 15.0)},
    "none": OPEN | {"index": (70.0, 80.0, 40.0)},
}
STILL, CLOSING = 20, 15


def recording(landmarks: Callable[..., Array], name: str, noise_m: float = 0.0) -> Recording:
    """Open for 20 frames, closing over 15, closed for 20, opening over 15, open for 20."""
    ramp = (1 - np.cos(np.linspace(0, np.pi, CLOSING))) / 2
    course = np.concatenate([np.zeros(STILL), ramp, np.ones(STILL), ramp[::-1], np.zeros(STILL)])
    open_thumb = landmarks(OPEN)
    closed_thumb = landmarks(POSES[name], "index" if name == "pinch" else None)
    frames = []
    for share in course:
        pose = {
            finger: tuple((1 - share) * a + share * b for a, b in zip(OPEN[finger], POSES[name][finger], strict=True))
            for finger in LONG_FINGERS
        }
        frame = landmarks(pose)
        frame[1:5] = (1 - share) * open_thumb[1:5] + share * closed_thumb[1:5]
        frames.append(frame)
    world = np.array(frames) + np.random.default_rng(1).normal(0.0, noise_m, (len(frames), 21, 3))
    return Recording(np.arange(len(frames)) / RATE, world, world[:, :, :2], {"source": "drawn", "method": "drawn"})


def only(landmarks: Callable[..., Array], name: str, noise_m: float = 0.0) -> DetectedGrasp:
    seen = recording(landmarks, name, noise_m)
    (grasp,) = find_grasps(steady(seen), seen.origin)
    return grasp


@pytest.mark.parametrize("noise_m", [0.0, 0.0007])
@pytest.mark.parametrize("name", list(POSES))
def test_kinds_and_times_are_found(name: str, noise_m: float, hand_landmarks: Callable[..., Array]) -> None:
    grasp = only(hand_landmarks, name, noise_m)
    assert grasp.kind is Kind(name)
    begin, end = STILL / RATE, (STILL + CLOSING) / RATE
    assert grasp.start_s == pytest.approx(begin, abs=0.12)
    assert grasp.end_s == pytest.approx(end, abs=0.12)
    flexed = sum(POSES[name]["index"]) - sum(OPEN["index"])
    assert math.degrees(grasp.flexion_rad["index"]) == pytest.approx(flexed, abs=0.1 * flexed)


@pytest.mark.parametrize(("gap", "found"), [(0.36, [Kind.PINCH]), (0.48, [])])
def test_a_thumb_that_comes_near_pinches_from_a_distance_on(
    gap: float, found: list[Kind], hand_landmarks: Callable[..., Array]
) -> None:
    """docs/design.md: within 0.42 palm lengths of the thumb's tip."""
    seen = recording(hand_landmarks, "pinch")
    thumb, finger = seen.world[:, 4], seen.world[:, 8]
    away = thumb - finger
    away *= gap * 0.090 / np.linalg.norm(away[STILL + CLOSING])
    seen.world[:, 4] = finger + away
    assert [grasp.kind for grasp in find_grasps(steady(seen), seen.origin)] == found


def test_the_numbers_behind_the_kind(hand_landmarks: Callable[..., Array]) -> None:
    power, hook, pinch = (only(hand_landmarks, name) for name in ("power", "hook", "pinch"))
    assert power.curled == hook.curled == LONG_FINGERS
    assert power.proximal_share == pytest.approx(60.0 / 186.0, abs=0.02)
    assert hook.proximal_share == pytest.approx(5.0 / 146.0, abs=0.02)
    assert pinch.touching[0] == "index"
    # a motion ends with a twentieth of the way left, here of a palm length
    assert pinch.touching[1] == pytest.approx(0.015 / 0.090, abs=0.05)
    assert pinch.curled == ()
    assert "palm lengths" in pinch.why
    assert "% of their flexion" in power.why


def test_a_motion_is_a_target_with_the_drawn_shares(hand_landmarks: Callable[..., Array]) -> None:
    followed = target(only(hand_landmarks, "power").trajectory, "index", 10)
    shares = followed.angle_rad[-1] / followed.deflection_rad[-1]
    assert shares == pytest.approx(np.array([60.0, 82.0, 44.0]) / 186.0, abs=0.01)


def test_short_gaps_are_bridged_and_long_ones_end_the_search(hand_landmarks: Callable[..., Array]) -> None:
    whole = recording(hand_landmarks, "power")
    assert len(find_grasps(steady(_without(whole, 26, 28)), whole.origin)) == 1
    hidden = steady(_without(whole, 15, 36))
    assert np.flatnonzero(~hidden.known).tolist() == list(range(15, 36))
    assert find_grasps(hidden, whole.origin) == []


def test_a_single_wrong_frame_changes_little(hand_landmarks: Callable[..., Array]) -> None:
    whole = recording(hand_landmarks, "power")
    wrong = whole.world.copy()
    wrong[27] = wrong[27][::-1]
    spoilt = Recording(whole.times, wrong, whole.pixel, whole.origin)
    difference = steady(spoilt).angles["index"] - steady(whole).angles["index"]
    assert np.degrees(np.abs(difference)).max() < 12.0


def test_a_hand_that_is_closed_from_the_start_is_no_motion(hand_landmarks: Callable[..., Array]) -> None:
    whole = recording(hand_landmarks, "power")
    late = Recording(whole.times[40:], whole.world[40:], whole.pixel[40:], whole.origin)
    assert find_grasps(steady(late), whole.origin) == []


def test_an_unsteady_camera_gives_a_steady_motion(hand_landmarks: Callable[..., Array]) -> None:
    whole = recording(hand_landmarks, "pinch")
    kept = np.random.default_rng(2).random(len(whole.times)) > 0.2
    kept[[0, -1]] = True
    thinned = Recording(whole.times[kept], whole.world[kept], whole.pixel[kept], whole.origin)
    motion = steady(thinned)
    assert np.ptp(np.diff(motion.times)) < 1e-9
    (grasp,) = find_grasps(motion, whole.origin)
    assert grasp.kind is Kind.PINCH


def test_targets_need_a_finger_that_moves(hand_landmarks: Callable[..., Array]) -> None:
    with pytest.raises(DesignError, match="ring: expected a deflection of 15 deg"):
        target(only(hand_landmarks, "pinch").trajectory, "ring")


def _without(whole: Recording, start: int, end: int) -> Recording:
    world = whole.world.copy()
    world[start:end] = np.nan
    return Recording(whole.times, world, whole.pixel, whole.origin)
