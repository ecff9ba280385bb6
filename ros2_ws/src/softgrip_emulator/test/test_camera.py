# SPDX-License-Identifier: Apache-2.0
"""The picture shows the true finger where the calibration says, the stream carries it with its time of capture."""

import math
import os
import subprocess
import sys
import threading
import time
import urllib.request
from itertools import count, pairwise

import cv2
import numpy as np
import pytest
import yaml

from softgrip_emulator.camera.camera import Camera
from softgrip_emulator.camera.camera_process import CameraProcess
from softgrip_emulator.camera.exposure_sample import CameraFaults, CameraSettings, ExposureSample, Pose
from softgrip_emulator.camera.optics import calibrated, draw_optics, write_calibration
from softgrip_emulator.camera.scene import Light, Scene
from softgrip_emulator.camera.stream import FrameBoard, StreamServer

LINKS_M = (0.045, 0.027, 0.023)


def pose_of(angles_deg):
    heading = np.cumsum(np.radians(angles_deg))
    steps = np.array(LINKS_M)[:, None] * np.stack([np.cos(heading), -np.sin(heading)], axis=1)
    return Pose(np.vstack([[[0.0, 0.0]], np.cumsum(steps, axis=0)]), heading)


def green_centres(image):
    """Centres of green blobs, weighted by greenness: an independent, plain detector."""
    blue, green, red = (image[..., i].astype(float) for i in range(3))
    weight = np.clip(green - np.maximum(blue, red) - 25.0, 0.0, None)
    count, labels = cv2.connectedComponents((weight > 0).astype(np.uint8))
    centres = []
    for label in range(1, count):
        v, u = np.nonzero(labels == label)
        if len(u) > 60:
            share = weight[v, u] / weight[v, u].sum()
            centres.append([(share * u).sum(), (share * v).sum()])
    return np.array(centres)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (1280, 720)])
@pytest.mark.parametrize("angles_deg", [(0, 0, 0), (30, 20, 15), (80, 45, 45), (10, 80, 40)])
def test_every_marker_is_where_the_optics_say(width, height, angles_deg):
    optics = draw_optics(width, height, seed=3)
    scene = Scene(optics, seed=3)
    pose = pose_of(angles_deg)
    found = green_centres(scene.render(pose))
    for true in optics.to_pixels(scene.markers_m(pose)):
        assert np.linalg.norm(found - true, axis=1).min() < 0.35
    assert len(found) == 5


def test_distortion_is_opencvs():
    optics = draw_optics(640, 480, seed=4)
    points = np.array([[0.0, 0.0], [0.09, -0.01], [0.02, -0.09]])
    mapped = points @ optics.homography[:, :2].T + optics.homography[:, 2]
    rays = np.column_stack([(mapped[:, :2] / mapped[:, 2:] - optics.matrix[:2, 2]) / optics.matrix[0, 0], np.ones(3)])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), optics.matrix, optics.distortion)
    assert optics.to_pixels(points) == pytest.approx(expected.reshape(-1, 2), abs=1e-6)


def test_the_calibration_is_good_but_not_perfect(tmp_path):
    true = draw_optics(640, 480, seed=5)
    path = tmp_path / "camera_calibration.yaml"
    write_calibration(path, calibrated(true, seed=5), "index", 5)
    document = yaml.safe_load(path.read_text())
    matrix = np.array(document["camera_matrix"]["data"]).reshape(3, 3)
    distortion = np.array(document["distortion_coefficients"]["data"])
    (plane,) = document["softgrip"]["planes"]
    homography = np.array(plane["homography"]["data"]).reshape(3, 3)
    points = np.array([[0.0, 0.0], [0.05, -0.03], [0.09, -0.01], [-0.02, -0.06]])
    seen = cv2.undistortPoints(true.to_pixels(points).reshape(-1, 1, 2), matrix, distortion, P=matrix).reshape(-1, 2)
    back = np.column_stack([seen, np.ones(4)]) @ np.linalg.inv(homography).T
    error_mm = 1e3 * np.linalg.norm(back[:, :2] / back[:, 2:] - points, axis=1)
    assert 0.005 < error_mm.max() < 1.0
    assert (plane["finger"], plane["base_marker_m"], plane["marker_diameter_m"]) == ("index", 0.020, 0.005)


def test_motion_blurs_and_exposure_changes_the_light():
    scene = Scene(draw_optics(640, 480, seed=1), seed=1)
    still = scene.render(pose_of((30, 20, 15)), pose_of((30, 20, 15)), Light(noise=0.0))
    moving = scene.render(pose_of((30, 20, 15)), pose_of((20, 12, 8)), Light(noise=0.0))
    assert cv2.Laplacian(moving, cv2.CV_64F).var() < 0.9 * cv2.Laplacian(still, cv2.CV_64F).var()
    dark = scene.render(pose_of((30, 20, 15)), light=Light(gain=0.1))
    bright = scene.render(pose_of((30, 20, 15)), light=Light(gain=3.0))
    assert dark.mean() < 0.2 * still.mean()
    assert (bright == 255).mean() > 0.05


def test_noise_differs_from_frame_to_frame_and_an_empty_slot_shows_no_finger():
    scene = Scene(draw_optics(640, 480, seed=1), seed=1)
    empty = Pose(np.zeros((0, 2)), np.zeros(0))
    first, second = scene.render(empty), scene.render(empty)
    assert 1.0 < np.std(first.astype(float) - second) < 6.0
    # the base marker is on the palm
    assert len(green_centres(first)) == 1


def test_another_level_of_noise_is_the_same_noise_louder():
    scene = Scene(draw_optics(320, 240, seed=1), seed=1)
    loud, usual = ([tile.astype(float) for tile in scene._draw_noise(scene._again(), level)] for level in (8.0, 2.0))
    assert np.abs(loud[-1] / 4.0 - usual[-1]).max() <= 0.63  # both are rounded
    assert all((tile == kept).all() for tile, kept in zip(usual, scene._noise_tiles, strict=True))
    scene.render(Pose(np.zeros((0, 2)), np.zeros(0)), light=Light(noise=8.0))
    assert all((tile == kept).all() for tile, kept in zip(loud, scene._noise_tiles, strict=True))


@pytest.fixture
def stream(tmp_path):
    """A camera whose cell asks for 60 frames a second while the stream has viewers."""
    board, faults = FrameBoard(), CameraFaults()
    camera = Camera(Scene(draw_optics(320, 240, seed=1), seed=1), board)
    server = StreamServer(board)
    server.start(tmp_path / "camera.url")
    ended = threading.Event()

    def expose():
        angle = 0.0
        while not ended.wait(1.0 / 60.0):
            if board.viewers:
                angle += 0.5
                camera.expose(ExposureSample(pose_of((angle, 0, 0)), pose_of((angle, 0, 0)), time.time(), faults))

    exposing = threading.Thread(target=expose, daemon=True)
    exposing.start()
    yield camera, (tmp_path / "camera.url").read_text().strip(), faults
    ended.set()
    exposing.join()
    server.close()


def parts(url, count):
    """Independent reading of multipart/x-mixed-replace: (stamp, jpeg) pairs."""
    with urllib.request.urlopen(url, timeout=5) as response:
        boundary = response.headers.get_param("boundary").encode()
        for _ in range(count):
            assert response.readline().strip() == b"--" + boundary
            headers = {}
            while line := response.readline().strip():
                name, _, value = line.decode().partition(": ")
                headers[name] = value
            yield float(headers["X-Timestamp"]), response.read(int(headers["Content-Length"]))
            response.readline()


def test_the_stream_has_frames_with_rising_stamps(stream):
    _, url, _ = stream
    before_s = time.time()
    rows = list(parts(url, 5))
    stamps = [stamp for stamp, _ in rows]
    assert before_s - 0.1 <= stamps[0] <= stamps[-1] <= time.time()
    assert all(b > a for a, b in pairwise(stamps))
    image = cv2.imdecode(np.frombuffer(rows[0][1], np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (240, 320, 3)


def test_a_frozen_camera_repeats_its_frame(stream):
    _, url, faults = stream
    faults.frozen = True
    frozen = [data for _, data in parts(url, 3)]
    assert frozen[0] == frozen[1] == frozen[2]


def test_a_dark_camera_and_one_that_loses_frames():
    pose, faults = pose_of((10, 0, 0)), CameraFaults(gain=0.05)
    scene = Scene(draw_optics(320, 240, seed=1), seed=1)
    camera = Camera(scene, FrameBoard(), random=np.random.default_rng(1).random)
    sample = ExposureSample(pose, pose, 0.0, faults)
    assert cv2.imdecode(np.frombuffer(camera.render_frame(sample), np.uint8), cv2.IMREAD_COLOR).mean() < 12
    faults.gain = 1.0
    faults.drop_share = 0.5
    lost = sum(camera.render_frame(sample) is None for _ in range(60))
    assert 15 < lost < 45


def test_a_scene_that_has_shown_much_shows_a_pose_as_a_fresh_one_does():
    optics = draw_optics(640, 480, seed=3)
    used = Scene(optics, seed=3)
    dark = Light(noise=0.0)
    for k in range(12):
        used.render(pose_of((7 * k, 3 * k, 2 * k)), pose_of((6 * k, 3 * k, k)), dark)
    used.render(Pose(np.zeros((0, 2)), np.zeros(0)), light=dark)
    for now, before in (((30, 20, 15), (30, 20, 15)), ((60, 10, 5), (52, 8, 5)), ((60.001, 10, 5), (60.001, 10, 5))):
        fresh = Scene(optics, seed=3).render(pose_of(now), pose_of(before), dark)
        assert np.array_equal(used.render(pose_of(now), pose_of(before), dark), fresh)


def test_a_marker_stays_glued_where_it_is_as_its_link_turns():
    scene = Scene(draw_optics(640, 480, seed=3), seed=3)
    straight, bent = pose_of((0, 0, 0)), pose_of((40, 30, 20))
    before, after = (scene.markers_m(pose)[2:] - pose.joints_m[1:] for pose in (straight, bent))
    turns = np.exp(-1j * bent.headings_rad)  # closing is clockwise
    assert np.abs(before).max() > 5e-5
    assert after @ [1, 1j] == pytest.approx((before @ [1, 1j]) * turns, abs=1e-12)


def test_links_are_deep_on_the_closing_side_and_grooved_at_their_joints():
    scene = Scene(draw_optics(640, 480, seed=3), seed=3)
    pose, dark = pose_of((50, 30, 20)), Light(noise=0.0)
    bare = scene.render(Pose(np.zeros((0, 2)), np.zeros(0)), light=dark).astype(int)
    seen = scene.render(pose, light=dark).astype(int)

    def covered(along, inward):
        heading = pose.headings_rad[0]
        ahead = np.array([math.cos(heading), -math.sin(heading)])
        place = along * ahead + inward * np.array([ahead[1], -ahead[0]])
        u, v = np.rint(scene.optics.to_pixels(place[None])[0]).astype(int)
        return np.abs(seen[v, u] - bare[v, u]).max() > 40

    middle, depth = 0.5 * LINKS_M[0], pose.body_height_m
    assert covered(middle, 0.9 * depth)
    assert covered(middle, -0.002)
    assert not covered(middle, -0.006)
    assert not covered(middle, depth + 0.002)
    for end in (0.004, LINKS_M[0] - 0.004):
        assert not covered(end, 0.008)  # beyond 45 degrees from the joint


def test_what_was_prepared_changes_no_picture():
    optics, pose, before = draw_optics(640, 480, seed=3), pose_of((60, 10, 5)), pose_of((52, 8, 5))
    ahead, late = Scene(optics, seed=3), Scene(optics, seed=3)
    for light in (Light(), Light(gain=0.5), Light(), Light(noise=0.0), Light()):
        ahead.prepare()
        ahead.prepare()
        assert np.array_equal(ahead.render(pose, before, light), late.render(pose, before, light)), light
    ahead.prepare()
    assert np.std(ahead.render(pose, light=Light(noise=8.0)).astype(float) - late.render(pose, light=Light())) > 6.0


def test_a_smear_is_the_mean_of_the_instants_it_is_made_of():
    optics, dark = draw_optics(640, 480, seed=3), Light(noise=0.0)
    first, last = pose_of((52, 8, 5)), pose_of((60, 10, 5))
    middle = Pose(0.5 * (first.joints_m + last.joints_m), 0.5 * (first.headings_rad + last.headings_rad))
    smeared = Scene(optics, seed=3).render(last, first, dark).astype(float)
    mean = np.mean([Scene(optics, seed=3).render(pose, light=dark) for pose in (first, middle, last)], axis=0)
    assert np.abs(smeared - mean).max() <= 1.5  # rounded before and after the lens
    assert np.abs(smeared - Scene(optics, seed=3).render(last, light=dark)).max() > 40


def test_a_product_is_seen_behind_the_finger_and_hides_no_marker():
    scene = Scene(draw_optics(640, 480, seed=1), seed=1)
    pose, dark = pose_of((50, 30, 20)), Light(noise=0.0)
    turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ball = np.array([0.015, -0.05]) + 0.02 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    with_ball = Pose(pose.joints_m, pose.headings_rad, pose.body_height_m, ball)
    without, seen = scene.render(pose, light=dark), scene.render(with_ball, light=dark)
    u, v = scene.optics.to_pixels(np.array([[0.012, -0.052]]))[0].astype(int)
    assert np.abs(seen[v, u].astype(int) - without[v, u]).max() > 40
    assert green_centres(seen) == pytest.approx(green_centres(without), abs=0.1)
    assert np.array_equal(scene.render(pose, light=dark), without)


@pytest.fixture
def camera_process(tmp_path):
    """Open a camera's process that is asked for frames as a cell asks: the next one when the last is reported."""
    opened = []

    def open_process(**settings):
        pose, stamps, reports = pose_of((10, 0, 0)), count(1), []

        def on_report(report):
            reports.append(report)
            if report.viewers and not process.is_exposing:
                process.expose(ExposureSample(pose, pose, float(next(stamps)), process.faults))

        process = CameraProcess(CameraSettings(320, 240, **settings), 1, "index", on_report)
        process.open(tmp_path / "camera.url", tmp_path / "calibration.yaml")
        opened.append(process)
        return process, (tmp_path / "camera.url").read_text().strip(), reports

    yield open_process
    for process in opened:
        process.close()


def test_the_camera_process_serves_what_it_is_shown_and_ends_with_the_cell(camera_process, tmp_path, until):
    process, url, reports = camera_process()
    rows = list(parts(url, 3))
    assert [stamp for stamp, _ in rows] == sorted({stamp for stamp, _ in rows})
    assert cv2.imdecode(np.frombuffer(rows[0][1], np.uint8), cv2.IMREAD_COLOR).shape == (240, 320, 3)
    write_calibration(tmp_path / "expected.yaml", calibrated(draw_optics(320, 240, seed=1), 1), "index", 1)
    assert (tmp_path / "calibration.yaml").read_bytes() == (tmp_path / "expected.yaml").read_bytes()
    assert until(lambda: reports[-1].viewers == 0)
    assert process.running
    child = process._process
    process.close()
    assert child.returncode == 0
    assert not process.running


def test_a_frame_that_the_sensor_loses_is_reported_as_not_shown(camera_process, until):
    process, url, reports = camera_process()
    list(parts(url, 1))
    process.faults.drop_share = 1.0
    with urllib.request.urlopen(url, timeout=5):
        assert until(lambda: any(report.is_rendered and not report.is_shown for report in reports))
    assert any(report.is_shown for report in reports)


@pytest.mark.parametrize("requested", [0, 12])
def test_the_camera_process_has_the_priority_it_is_given_where_it_may(camera_process, requested):
    trial = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    allowed = subprocess.run([sys.executable, "-c", trial], capture_output=True, check=False).returncode == 0
    process, url, _ = camera_process(realtime_priority=requested)
    number = process._process.pid
    assert os.sched_getscheduler(number) == (os.SCHED_FIFO if requested and allowed else os.SCHED_OTHER)
    assert os.sched_getparam(number).sched_priority == (requested if allowed else 0)
    assert len(list(parts(url, 2))) == 2


def test_a_camera_that_is_killed_is_noticed_and_keeps_nobody_waiting(camera_process, until):
    process, url, _ = camera_process()
    list(parts(url, 1))
    process._process.kill()
    assert until(lambda: not process.running)
    assert until(lambda: not process.is_exposing)
    process.expose(ExposureSample(pose_of((10, 0, 0)), pose_of((10, 0, 0)), 0.0))
    assert not process.is_exposing


def test_two_viewers_and_a_wrong_path(stream):
    _, url, _ = stream
    assert len(list(parts(url, 2))) == len(list(parts(url, 2))) == 2
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(url.replace("stream.mjpg", "secret"), timeout=5)


def test_headings_are_those_of_a_closing_finger():
    # closing goes towards -y, which is down in the picture
    optics = draw_optics(640, 480, seed=2)
    tip = optics.to_pixels(pose_of((40, 30, 20)).joints_m)[-1]
    base = optics.to_pixels(np.zeros((1, 2)))[0]
    assert tip[1] > base[1] + 100
    assert math.isfinite(tip[0])
