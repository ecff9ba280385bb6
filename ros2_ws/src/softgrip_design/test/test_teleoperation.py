# SPDX-License-Identifier: Apache-2.0
"""From a drawn hand to pulled lengths, and what keeps them still."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from softgrip_design.capture.detector import DetectedHand
from softgrip_design.capture.frames import VideoFrame
from softgrip_design.capture.recording import LONG_FINGERS
from softgrip_design.errors import DesignError
from softgrip_design.teleoperation.demonstration import Demonstrations, Phase
from softgrip_design.teleoperation.follower import REFERENCE_FRAMES, FollowerSettings, HandFollower
from softgrip_design.teleoperation.frame_source import MAX_DELAY_S, film_frames
from softgrip_design.teleoperation.one_euro import OneEuroFilter, OneEuroSettings
from softgrip_design.teleoperation.session import (
    MAX_ORDER_S,
    NO_HAND,
    NOT_ARMED,
    NOT_HELD,
    PRESS_LIFETIME_S,
    DeadManSwitch,
    TeleoperationFrame,
    TeleoperationSession,
)
from softgrip_design.teleoperation.tendon_table import TendonBounds, TendonTable
from softgrip_model.finger import Finger, close
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.profile import load_directory, shipped_directory

Array = NDArray[np.float64]
Landmarks = Callable[..., Array]

FRAME_S = 1.0 / 30.0
OPEN = dict.fromkeys(LONG_FINGERS, (10.0, 8.0, 6.0))
#: The index alone, 60 deg more than open.
CURLED = OPEN | {"index": (30.0, 38.0, 16.0)}
PICTURE = np.zeros((4, 4, 3), np.uint8)


@pytest.fixture(scope="module")
def table() -> TendonTable:
    profile = load_directory(shipped_directory())["power"]
    return TendonTable(Finger.from_profile(profile, "index"), assumed_friction(profile).law, TendonBounds())


class Cell:
    """Tendons that are where they are commanded to be, and a time that a test moves on."""

    def __init__(self) -> None:
        self.time_s, self.now_m, self.problem = 100.0, np.zeros(1), ""
        self.orders: list[tuple[Array, float]] = []

    def cell_time_s(self) -> float:
        return self.time_s

    def lengths_m(self) -> Array:
        return self.now_m

    def find_problem(self) -> str:
        return self.problem

    def order(self, stamp_s: float, lengths_m: Array, duration_s: float) -> None:
        assert stamp_s <= self.time_s
        self.orders.append((lengths_m, duration_s))
        self.now_m = lengths_m

    def show(self, frame: TeleoperationFrame) -> None:
        self.last = frame


class PosedHand:
    """Sees the landmarks that a test has set, at once or late."""

    name = "posed"

    def __init__(self, cell: Cell) -> None:
        self.world: Array | None = None
        self.late_s = 0.0
        self._cell = cell

    def find(self, image: NDArray[np.uint8]) -> DetectedHand | None:
        del image
        self._cell.time_s += self.late_s
        return None if self.world is None else DetectedHand(self.world, self.world[:, :2], 1.0)


class Bench:
    """A session with everything that a test may turn; the steady clock is the cell's."""

    def __init__(self, table: TendonTable, landmarks: Landmarks) -> None:
        self.landmarks = landmarks
        self.cell, self.switch, self.demonstrations = Cell(), DeadManSwitch(), Demonstrations()
        self.hand = PosedHand(self.cell)
        self.follower = HandFollower({"index": table})
        self.session = TeleoperationSession(
            self.cell, self.follower, self.hand, self.switch, self.demonstrations, self.cell.cell_time_s
        )

    def frame(self, pose: dict[str, tuple[float, ...]] | None, *, held: bool) -> TeleoperationFrame:
        self.cell.time_s += FRAME_S
        self.hand.world = None if pose is None else self.landmarks(pose)
        if held:
            self.switch.press(self.cell.time_s)
        else:
            self.switch.release()
        return self.process()

    def process(self) -> TeleoperationFrame:
        return self.session.process_frame(VideoFrame(self.cell.time_s, PICTURE))

    def show_open_hand(self) -> None:
        for _ in range(REFERENCE_FRAMES):
            self.frame(OPEN, held=False)


@pytest.fixture
def bench(table: TendonTable, hand_landmarks: Landmarks) -> Bench:
    return Bench(table, hand_landmarks)


def test_the_table_is_the_kernels_inverse() -> None:
    # forward at the table's lengths: the joints add up to what was asked for
    profile = load_directory(shipped_directory())["power"]
    law = assumed_friction(profile).law
    for slot in ("index", "thumb"):
        finger = Finger.from_profile(profile, slot)
        made = TendonTable(finger, law, TendonBounds())
        asked = np.linspace(0.1, made.max_deflection_rad, 7)
        pulled_mm = [1e3 * made.length_m(value) for value in asked]
        assert close(finger, law, pulled_mm).angle_rad[0].sum(axis=1) == pytest.approx(asked, abs=2e-3)


def test_bounds_end_the_table() -> None:
    profile = load_directory(shipped_directory())["power"]
    finger, law = Finger.from_profile(profile, "index"), assumed_friction(profile).law
    short = TendonTable(finger, law, TendonBounds(max_length_m=0.008))
    weak = TendonTable(finger, law, TendonBounds(max_tension_n=4.0))
    assert 0.0075 < short.length_m(10.0) <= 0.008
    assert close(finger, law, [1e3 * weak.length_m(10.0)]).actuator_tension_n[0, 0] <= 4.0 + 1e-6
    assert short.length_m(-1.0) == 0.0
    with pytest.raises(DesignError, match="deflection"):
        short.length_m(math.nan)
    with pytest.raises(DesignError, match="--max-tension"):
        TendonTable(finger, law, TendonBounds(max_tension_n=0.01))


def test_the_filter_is_a_first_order_low_pass_where_speed_does_not_count() -> None:
    # at a cut-off f a step is within 1 - (1 / (1 + 2 pi f dt))^k of its end after k steps of dt
    made = OneEuroFilter(OneEuroSettings(min_cutoff_hz=2.0, speed_factor=0.0))
    made.filter(0.0, 0.0)
    found = [made.filter(0.01 * k, 1.0) for k in range(1, 20)]
    share = 1.0 / (1.0 + 2.0 * math.pi * 2.0 * 0.01)
    assert found == pytest.approx([1.0 - share**k for k in range(1, 20)])


def test_the_filter_lags_less_in_motion() -> None:
    slow, quick = (OneEuroFilter(OneEuroSettings(1.0, factor)) for factor in (0.0, 5.0))
    for k in range(30):
        behind = [abs(one.filter(k * FRAME_S, 2.0 * k * FRAME_S) - 2.0 * k * FRAME_S) for one in (slow, quick)]
    assert behind[1] < behind[0] / 3.0


def test_a_finger_comes_to_the_hands_deflection(bench: Bench, table: TendonTable) -> None:
    bench.show_open_hand()
    for _ in range(40):
        frame = bench.frame(CURLED, held=True)
    assert frame.reason == ""
    assert frame.deflections_rad == pytest.approx([math.radians(60.0)], abs=0.01)
    assert bench.cell.now_m == pytest.approx([table.length_m(math.radians(60.0))], abs=1e-4)


def test_no_order_is_faster_than_allowed(bench: Bench) -> None:
    bench.show_open_hand()
    for _ in range(30):
        bench.frame(dict.fromkeys(LONG_FINGERS, (70.0, 90.0, 50.0)), held=True)
    lengths_m = np.array([0.0, *(order[0][0] for order in bench.cell.orders)])
    assert np.diff(lengths_m).max() <= FollowerSettings().max_speed_m_s * FRAME_S + 1e-9
    assert lengths_m.max() <= TendonBounds().max_length_m
    assert max(order[1] for order in bench.cell.orders) <= MAX_ORDER_S


def test_nothing_moves_before_the_open_hand_was_seen(bench: Bench) -> None:
    frames = [bench.frame(CURLED, held=True) for _ in range(REFERENCE_FRAMES - 1)]
    assert all("open hand" in frame.reason for frame in frames)
    assert bench.cell.orders == []


def test_nothing_moves_without_the_switch(bench: Bench) -> None:
    bench.show_open_hand()
    assert bench.frame(CURLED, held=False).reason == NOT_HELD
    assert bench.frame(CURLED, held=True).reason == ""
    bench.cell.time_s += PRESS_LIFETIME_S + 0.001  # no press any more
    bench.hand.world = bench.landmarks(CURLED)
    assert bench.process().reason == NOT_HELD
    assert len(bench.cell.orders) == 1
    # what is left of the last order, and of the last press
    assert PRESS_LIFETIME_S + MAX_ORDER_S < 0.2


def test_a_hand_out_of_sight_moves_nothing_and_comes_back(bench: Bench) -> None:
    bench.show_open_hand()
    bench.frame(CURLED, held=True)
    assert bench.frame(None, held=True).reason == NO_HAND
    assert len(bench.cell.orders) == 1
    assert bench.frame(CURLED, held=True).reason == ""


def test_a_hand_found_too_late_moves_nothing(bench: Bench) -> None:
    bench.show_open_hand()
    bench.hand.late_s = 0.25
    bench.cell.time_s += FRAME_S
    bench.hand.world = bench.landmarks(CURLED)
    bench.switch.press(bench.cell.time_s + 0.25)
    assert "0.25 s after its frame" in bench.process().reason
    assert bench.cell.orders == []


def test_after_a_stop_the_switch_has_to_be_let_go(bench: Bench) -> None:
    bench.show_open_hand()
    bench.frame(CURLED, held=True)
    bench.cell.problem = "emergency stop: a person"
    assert "emergency stop" in bench.frame(CURLED, held=True).reason
    bench.cell.problem = ""
    assert bench.frame(CURLED, held=True).reason == NOT_ARMED
    assert len(bench.cell.orders) == 1
    bench.frame(CURLED, held=False)
    assert bench.frame(CURLED, held=True).reason == ""


def test_a_demonstration_ends_with_a_verdict(bench: Bench) -> None:
    bench.show_open_hand()
    assert bench.demonstrations.current == (0, Phase.IDLE)
    assert bench.demonstrations.end(Phase.SUCCEEDED) is False
    bench.frame(CURLED, held=True)
    bench.demonstrations.end(Phase.SUCCEEDED)
    still = bench.frame(CURLED, held=True)  # a key that is still down begins no other one
    assert (still.episode, still.phase, still.reason) == (1, Phase.SUCCEEDED, NOT_ARMED)
    bench.frame(CURLED, held=False)
    again = bench.frame(CURLED, held=True)
    assert (again.episode, again.phase) == (2, Phase.RUNNING)
    bench.session.end()
    assert (bench.cell.last.episode, bench.cell.last.phase) == (2, Phase.ABORTED)


def test_an_unknown_tendon_is_refused(table: TendonTable) -> None:
    with pytest.raises(DesignError, match="tail"):
        HandFollower({"tail": table})


def test_a_film_leaves_out_what_is_late() -> None:
    class Film:
        origin, count = "film", 4

        def frames(self):
            for k in range(4):
                yield VideoFrame(k * FRAME_S, np.full((1, 1, 3), k, np.uint8))

    cell = Cell()
    frames = film_frames(Film(), cell.cell_time_s, lambda: True)
    assert next(frames).time_s == 100.0
    cell.time_s += 1.4 * FRAME_S + MAX_DELAY_S  # a detector that takes its time
    second = next(frames)
    assert (second.time_s, second.image[0, 0, 0]) == (pytest.approx(100.0 + 2 * FRAME_S), 2)
    assert next(frames, None) is None  # the third is not due yet, and the person has ended it
