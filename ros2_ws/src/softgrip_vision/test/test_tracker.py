# SPDX-License-Identifier: Apache-2.0
"""The whole of vision without ROS: rendered closings with known truth, occlusion, bad frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from softgrip_model.profile import shipped_directory
from softgrip_testing.synthetic_images import Conditions, Occluder, SyntheticScene, make_calibration
from softgrip_vision.calibration import CameraCalibration, PlaneMap
from softgrip_vision.chain import ChainGeometry
from softgrip_vision.errors import CalibrationError, FrameError, LayoutError
from softgrip_vision.finger import FingerTracker
from softgrip_vision.layout import ChainLayout, FingerSetup, parse_region, read_chains
from softgrip_vision.options import TrackerOptions
from softgrip_vision.readings import FingerReading
from softgrip_vision.search import find_chain
from softgrip_vision.spots import Spot
from softgrip_vision.tracker import Tracker

CHAIN = ChainLayout((0.045, 0.027, 0.023))
FPS = 30.0


def follow(
    tracker: Tracker,
    scene: SyntheticScene,
    poses: Sequence[np.ndarray],
    hide: dict[int, set[int]] | None = None,
    conditions: Conditions | None = None,
) -> list[FingerReading]:
    """Track frames of one finger; ``hide``: frame number to hidden markers."""
    out = []
    for frame, pose in enumerate(poses):
        centres = scene.centres("index", pose)
        things = [Occluder(*centres[m], 26.0) for m in (hide or {}).get(frame, set())]
        picture = scene.render({"index": pose}, conditions or Conditions(noise=2.0), things)
        out += tracker.measure(picture.image, 100.0 + frame / FPS)
    return out


def closing(frames: int) -> list[np.ndarray]:
    return [np.array([0.9, 0.7, 0.5]) * k / frames for k in range(frames)]


def test_angles_and_tip_of_a_closing(tracker: Tracker, scene: SyntheticScene) -> None:
    poses = closing(15)
    for reading, truth in zip(follow(tracker, scene, poses), poses, strict=True):
        assert reading.pose is not None
        assert reading.pose.angles == pytest.approx(truth, abs=math.radians(0.3))
        assert reading.pose.tip == pytest.approx(scene.tip("index", truth), abs=2e-4)
        assert [m.name for m in reading.markers] == ["base", "joint_0", "joint_1", "joint_2", "tip"]


def test_centres_are_sub_pixel_and_their_deviation_is_honest(tracker: Tracker, scene: SyntheticScene) -> None:
    poses = closing(12)
    ratios = []
    for reading, truth in zip(follow(tracker, scene, poses), poses, strict=True):
        for marker, centre in zip(reading.markers, scene.centres("index", truth), strict=True):
            assert math.dist(marker.pixel, centre) < 0.15
            ratios += ((marker.pixel - centre) / marker.stddev_px).tolist()
    assert 0.1 < np.std(ratios) < 1.5


def test_a_hidden_marker_is_said_to_be_hidden_and_keeps_its_name(tracker: Tracker, scene: SyntheticScene) -> None:
    poses = closing(24)
    hide = {frame: {2} for frame in range(8, 18)}
    readings = follow(tracker, scene, poses, hide)
    for frame, reading in enumerate(readings):
        marker = reading.markers[2]
        if frame in hide:
            assert marker.occluded
            assert marker.confidence == 0.0
        elif frame < 8 or frame > 20:
            assert not marker.occluded
            assert math.dist(marker.pixel, scene.centres("index", poses[frame])[2]) < 0.3


def test_without_the_tip_nothing_is_said_about_the_pose(tracker: Tracker, scene: SyntheticScene) -> None:
    readings = follow(tracker, scene, closing(16), {frame: {4} for frame in range(6, 12)})
    assert [frame for frame in range(6, 12) if readings[frame].pose is not None] in ([], [6])
    assert "tip" in readings[10].problem
    assert readings[15].pose is not None


def test_what_comes_back_has_to_be_on_the_finger(calibration: CameraCalibration) -> None:
    """Green discs of a marker's size and colour lie around: none is taken for the hidden tip."""
    scene = SyntheticScene(calibration, {"index": CHAIN}, decoys=60, seed=5)
    tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
    poses = [np.array([0.3, 0.3, 0.3])] * 6 + closing(30)[10:]
    readings = follow(tracker, scene, poses, {frame: {4} for frame in range(4, 26)})
    assert readings[3].pose is not None
    assert all(readings[frame].markers[4].occluded for frame in range(4, 26))


def test_a_marker_that_was_out_of_sight_is_believed_at_the_second_sight(
    tracker: Tracker, scene: SyntheticScene
) -> None:
    """Its place is not known well any more: one flash in one frame is no marker."""
    there, elsewhere = np.array([0.3, 0.3, 0.3]), np.array([0.3, 0.3, 0.36])
    hide = {frame: {4} for frame in (*range(4, 12), 13, 14, 15)}
    readings = follow(tracker, scene, [there] * 12 + [elsewhere] * 7, hide)
    unseen = [frame for frame, reading in enumerate(readings) if reading.markers[4].occluded]
    assert unseen == [*range(4, 12), 12, 13, 14, 15, 16]
    assert readings[-1].pose is not None
    assert readings[-1].pose.angles == pytest.approx(elsewhere, abs=math.radians(0.5))


def test_two_frames_of_the_same_film_give_the_same_numbers(
    calibration: CameraCalibration, scene: SyntheticScene
) -> None:
    images = [scene.render({"index": pose}, Conditions(noise=2.0)).image for pose in closing(6)]
    results = []
    for _ in range(2):
        tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
        results.append([tracker.measure(image, 5.0 + k / FPS)[0] for k, image in enumerate(images)])
    for first, second in zip(*results, strict=True):
        assert first.pose is not None
        assert second.pose is not None
        assert np.array_equal(first.pose.angles, second.pose.angles)
        assert [m.confidence for m in first.markers] == [m.confidence for m in second.markers]


@pytest.mark.parametrize("offset", [(0.0, 20.0), (-18.0, -12.0)])
def test_markers_on_the_edge_of_the_body(calibration: CameraCalibration, offset: tuple[float, float]) -> None:
    """As on the printed fingers: at the apex of a groove, half before the body and half before the bench."""
    scene = SyntheticScene(calibration, {"index": CHAIN}, body_offset_px=offset)
    tracker = Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")
    poses = closing(20)
    for reading, truth in zip(follow(tracker, scene, poses, {8: {3}, 9: {3}}), poses, strict=True):
        if not any(marker.occluded for marker in reading.markers):
            assert reading.pose is not None
            assert reading.pose.angles == pytest.approx(truth, abs=math.radians(0.4))
    assert reading.pose is not None, reading.problem


def test_a_stop_after_fast_motion_is_followed(tracker: Tracker, scene: SyntheticScene) -> None:
    """Blur makes markers larger; when it ends they are not taken for covered ones."""
    pose = np.full(3, 0.3)
    for frame in range(30):
        blurred = Conditions(noise=1.0, motion_px=9.0 if 5 <= frame < 20 else 0.0)
        (reading,) = tracker.measure(scene.render({"index": pose}, blurred).image, 1.0 + frame / FPS)
        assert reading.pose is not None, (frame, reading.problem)


def test_fingers_by_colour() -> None:
    """The same plane, green and blue markers: each finger sees its own only."""
    calibration = make_calibration(("index",))
    scene = SyntheticScene(calibration, {"index": CHAIN})
    green = scene.render({"index": np.full(3, 0.3)}).image
    blue = np.ascontiguousarray(green[:, :, [1, 0, 2]])  # green becomes blue
    finder = Tracker((FingerSetup("index", hue_deg=240.0),), {"power": {"index": CHAIN}}, calibration, "power")
    assert finder.measure(green, 1.0)[0].pose is None
    reading = finder.measure(blue, 1.0 + 1 / FPS)[0]
    assert reading.pose is not None
    assert reading.pose.angles == pytest.approx(np.full(3, 0.3), abs=0.01)


def test_a_spot_goes_to_the_finger_with_the_better_claim(calibration: CameraCalibration, scene: SyntheticScene) -> None:
    """Where another finger expects a marker of its own, the spot is not taken; a marker's diameter away it is."""
    pose = np.full(3, 0.3)
    image = scene.render({"index": pose}, Conditions(noise=2.0)).image
    tip = scene.centres("index", pose)[-1]
    for rival, hidden in ((tip, True), (tip + 30.0, False)):
        finger = FingerTracker(FingerSetup("index"), "power", CHAIN, calibration)
        finger.advance(1.0)
        assert finger.measure(image, 1.0, []).pose is not None
        finger.advance(1.0 + 1 / FPS)
        assert finger.measure(image, 1.0 + 1 / FPS, [tuple(rival)]).markers[-1].occluded is hidden


@pytest.mark.parametrize(("last", "found"), [(1.6, True), (-0.3, True), (-0.6, False), (2.0, False)])
def test_a_chain_that_bends_as_no_finger_does_is_none(
    calibration: CameraCalibration, scene: SyntheticScene, last: float, *, found: bool
) -> None:
    """Distances alone do not make a finger: its joints turn between -20 and 100 deg."""
    places = scene.centres("index", np.array([0.3, 0.3, last]))
    spots = [Spot(float(u), float(v), 0.03, 380.0, 1.0, 1.0, 100.0, 0.0, 1.0) for u, v in places]
    plane = calibration.plane("index")
    chain = find_chain(spots, PlaneMap(calibration.lens, plane), ChainGeometry(CHAIN, plane.base_marker_m))
    assert (chain is not None) is found


def test_several_fingers_side_by_side() -> None:
    fingers = ("index", "middle", "thumb")
    calibration = make_calibration(fingers, scale=2800.0)
    scene = SyntheticScene(calibration, dict.fromkeys(fingers, CHAIN))
    tracker = Tracker(
        tuple(FingerSetup(f) for f in fingers), {"power": dict.fromkeys(fingers, CHAIN)}, calibration, "power"
    )
    truth = {"index": np.full(3, 0.1), "middle": np.full(3, 0.2), "thumb": np.full(3, 0.3)}
    image = scene.render(truth).image
    for reading in tracker.measure(image, 1.0):
        assert reading.pose is not None, reading.problem
        assert reading.pose.angles == pytest.approx(truth[reading.finger], abs=0.01)


def test_another_profile_is_followed_after_a_swap(calibration: CameraCalibration) -> None:
    longer = ChainLayout((0.035, 0.035, 0.035))
    chains = {"power": {"index": CHAIN}, "even": {"index": longer}}
    tracker = Tracker((FingerSetup("index"),), chains, calibration, "power")
    scene = SyntheticScene(calibration, {"index": longer})
    image = scene.render({"index": np.full(3, 0.2)}).image
    assert tracker.measure(image, 1.0)[0].pose is None
    before = tracker.configuration
    tracker.mount("index", "even")
    assert tracker.configuration != before
    reading = tracker.measure(image, 2.0)[0]
    assert reading.pose is not None
    assert reading.profile == "even"


def test_a_finger_with_an_unknown_profile_is_not_measured(tracker: Tracker, scene: SyntheticScene) -> None:
    image = scene.render({"index": np.full(3, 0.2)}).image
    assert tracker.measure(image, 1.0)[0].pose is not None
    with pytest.raises(LayoutError, match="expected a profile of \\['power'\\], found 'unheard of'"):
        tracker.mount("index", "unheard of")
    (reading,) = tracker.measure(image, 1.03)
    assert reading.pose is None
    assert "found 'unheard of'" in reading.problem
    tracker.mount("index", "power")
    assert tracker.measure(image, 1.06)[0].pose is not None


def test_a_profile_without_the_finger_is_named(calibration: CameraCalibration) -> None:
    with pytest.raises(LayoutError, match="profile 'power' has no finger 'index'"):
        Tracker((FingerSetup("index"),), {"power": {"thumb": CHAIN}}, calibration, "power")


def test_options_change_live(tracker: Tracker, scene: SyntheticScene) -> None:
    pose = np.full(3, 0.2)
    assert follow(tracker, scene, [pose])[0].pose is not None
    tracker.set_options(TrackerOptions(largest_angle_stddev=1e-6))
    (reading,) = tracker.measure(scene.render({"index": pose}).image, 101.0)
    assert reading.pose is None
    assert "known to" in reading.problem


def test_a_missing_marker_is_silence_not_a_guess(tracker: Tracker, scene: SyntheticScene) -> None:
    (reading, *_) = follow(tracker, scene, [np.full(3, 0.3)], {0: {3}})
    assert reading.pose is None
    assert "expected a chain of 5 markers" in reading.problem
    assert all(math.isnan(marker.pixel[0]) for marker in reading.markers)


@pytest.mark.parametrize("colour", [(0, 0, 0), (128, 128, 128), (255, 255, 255), (60, 190, 50)])
def test_pictures_without_a_finger_are_silent(tracker: Tracker, colour: tuple[int, int, int]) -> None:
    image = np.full((720, 1280, 3), colour, np.uint8)
    (reading,) = tracker.measure(image, 1.0)
    assert reading.pose is None
    assert reading.problem


def test_the_finger_vanishes_and_comes_back(tracker: Tracker, scene: SyntheticScene) -> None:
    pose = np.full(3, 0.3)
    present = scene.render({"index": pose}).image
    absent = np.full_like(present, 90)
    stamps = np.arange(60) / FPS
    said = [tracker.measure(absent if 5 <= k < 45 else present, 10.0 + stamp)[0] for k, stamp in enumerate(stamps)]
    assert all(said[k].pose is not None for k in range(5))
    assert all(said[k].pose is None for k in range(6, 45))
    assert "searching" in " ".join(reading.problem for reading in said) or "expected a chain" in said[44].problem
    assert said[48].pose is not None


def test_wrong_frames_are_named(tracker: Tracker, scene: SyntheticScene) -> None:
    image = scene.render({"index": np.full(3, 0.3)}).image
    with pytest.raises(FrameError, match="8-bit colour image"):
        tracker.measure(image[:, :, 0], 1.0)
    with pytest.raises(FrameError, match="8-bit colour image"):
        tracker.measure(image.astype(np.float32), 1.0)
    with pytest.raises(CalibrationError, match="expected images of 1280x720, found 640x360"):
        tracker.measure(np.ascontiguousarray(image[::2, ::2]), 1.0)
    tracker.measure(image, 1.0)
    with pytest.raises(FrameError, match="in order of capture"):
        tracker.measure(image, 0.99)


def test_a_frame_of_another_size_in_between_changes_nothing(tracker: Tracker, scene: SyntheticScene) -> None:
    image = scene.render({"index": np.full(3, 0.3)}).image
    assert tracker.measure(image, 1.0)[0].pose is not None
    with pytest.raises(CalibrationError, match="found 640x360"):
        tracker.measure(np.ascontiguousarray(image[::2, ::2]), 1.03)
    reading = tracker.measure(image, 1.06)[0]
    assert reading.pose is not None
    assert reading.pose.angles == pytest.approx(np.full(3, 0.3), abs=math.radians(0.3))


def test_time_that_starts_again_starts_the_tracker_again(tracker: Tracker, scene: SyntheticScene) -> None:
    image = scene.render({"index": np.full(3, 0.3)}).image
    tracker.measure(image, 1000.0)
    assert tracker.measure(image, 1.0)[0].pose is not None


def test_chains_are_those_of_the_profiles(tmp_path: Path) -> None:
    chains = read_chains(None)
    assert chains["power"]["index"].link_lengths_m == (0.045, 0.027, 0.023)  # Fig 4.1 of the thesis
    assert chains["pinch"]["thumb"].joints == 2
    with pytest.raises(LayoutError, match="expected a folder with profiles"):
        read_chains(tmp_path)
    shipped = (shipped_directory() / "power.yaml").read_text()
    (tmp_path / "power.yaml").write_text(shipped.replace("schema: 1", "schema: 2"))
    with pytest.raises(LayoutError, match="reads schema 1, found 2"):
        read_chains(tmp_path)


def test_layouts_that_make_no_sense() -> None:
    with pytest.raises(LayoutError, match="link lengths"):
        ChainLayout((0.045, -0.1))
    with pytest.raises(LayoutError, match="whole pixels"):
        parse_region("1 2 3")
    with pytest.raises(LayoutError, match="hue"):
        FingerSetup("index", hue_deg=400.0)
    assert parse_region("") is None
    assert parse_region("0 10 20 30") == (0, 10, 20, 30)
