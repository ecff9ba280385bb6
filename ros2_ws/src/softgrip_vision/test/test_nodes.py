# SPDX-License-Identifier: Apache-2.0
"""camera and marker_tracker as processes of their own: stream in, joint angles out; what they say when it is wrong."""

from __future__ import annotations

import array
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from softgrip_interfaces.msg import CellState, FingerMarkers, FingerStates, MountedFinger
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, seconds, to_time_message
from softgrip_testing.free_domains import own_domain
from softgrip_testing.synthetic_images import SyntheticScene
from softgrip_vision import calibration as files
from softgrip_vision.calibration import CameraCalibration

pytestmark = pytest.mark.ros

POSE = np.array([0.4, 0.3, 0.2])
DEADLINE = 15.0


class Watcher(Node):
    """Hears everything the two nodes say."""

    def __init__(self) -> None:
        super().__init__("watcher")
        self.measured: list[FingerStates] = []
        self.markers: list[FingerMarkers] = []
        self.images: list[CompressedImage] = []
        self.infos: list[CameraInfo] = []
        self.overlays: list[CompressedImage] = []
        self.transforms: list[TFMessage] = []
        self.health: dict[str, tuple[int, str]] = {}
        self.levels: dict[str, set[int]] = defaultdict(set)  # all that there were
        self.create_subscription(FingerStates, "finger/measured", self.measured.append, SENSOR)
        self.create_subscription(FingerMarkers, "finger/markers", self.markers.append, SENSOR)
        self.create_subscription(CompressedImage, "camera/image_raw/compressed", self.images.append, SENSOR)
        self.create_subscription(CameraInfo, "camera/camera_info", self.infos.append, SENSOR)
        self.create_subscription(CompressedImage, "finger/overlay/compressed", self.overlays.append, SENSOR)
        self.create_subscription(TFMessage, "/tf_static", self.transforms.append, LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)
        self.compressed = self.create_publisher(CompressedImage, "camera/image_raw/compressed", SENSOR)
        self.raw = self.create_publisher(Image, "camera/image_raw", SENSOR)
        self.cell = self.create_publisher(CellState, "cell/state", LATCHED)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)
        self.processes: list[subprocess.Popen[str]] = []
        self._stamp_ns = 1_000_000_000_000

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self.health[status.name] = (level, status.message)
            self.levels[status.name].add(level)

    def start(self, node: str, **parameters: object) -> subprocess.Popen[str]:
        settings = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-m", f"softgrip_vision.nodes.{node}", "--ros-args", *settings]
        self.processes.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
        return self.processes[-1]

    def until(self, condition: Callable[[], bool]) -> bool:
        end = time.monotonic() + DEADLINE
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor_.spin_once(timeout_sec=0.05)
        return True

    def header(self) -> Header:
        self._stamp_ns += 33_000_000
        return Header(stamp=to_time_message(self._stamp_ns), frame_id="camera_optical_frame")

    def show(self, jpeg: bytes) -> None:
        self.compressed.publish(CompressedImage(header=self.header(), format="jpeg", data=array.array("B", jpeg)))

    def said(self, text: str) -> bool:
        return any(text in message for _, message in self.health.values())


@pytest.fixture
def watcher(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watcher]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    node = Watcher()
    yield node
    for process in node.processes:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=10)
    node.executor_.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    assert all(process.returncode in {0, 2} for process in node.processes)


@pytest.fixture
def calibration_file(tmp_path: Path, calibration: CameraCalibration) -> Path:
    files.save(calibration, tmp_path / "camera.yaml")
    return tmp_path / "camera.yaml"


@pytest.fixture(scope="module")
def jpeg(scene: SyntheticScene) -> bytes:
    return bytes(cv2.imencode(".jpg", scene.render({"index": POSE}).image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1])


def test_from_stream_to_joint_angles(
    watcher: Watcher,
    calibration_file: Path,
    calibration: CameraCalibration,
    jpeg: bytes,
    tmp_path: Path,
    scene: SyntheticScene,
    serve: Callable[..., str],
    part: Callable[[bytes, str | None], bytes],
) -> None:
    """Both nodes; the stream's address appears after they started; it ends again and again and is found again."""
    pointer = tmp_path / "camera.url"
    camera = {
        "source": f"'@{pointer}'",
        "calibration_file": calibration_file,
        "reconnect_delay_s": 0.1,
        "frame_prefix": "left/",
    }
    watcher.start("camera", **camera)
    watcher.start("marker_tracker", calibration_file=calibration_file, overlay=True)
    assert watcher.until(lambda: watcher.said("waiting for the file"))
    assert watcher.until(lambda: watcher.said("no frame yet; is the camera running?"))
    now = time.time()
    pointer.write_text(serve([part(jpeg, f"{now:.6f}")]))
    assert watcher.until(lambda: bool(watcher.images and watcher.infos and watcher.measured and watcher.overlays))
    assert bytes(watcher.images[0].data) == jpeg
    assert seconds(watcher.images[0].header.stamp) == pytest.approx(now, abs=2e-6)
    assert watcher.images[0].header.frame_id == "left/camera_optical_frame"
    assert watcher.infos[0].header.frame_id == "left/camera_optical_frame"
    (camera_at,) = [one for message in watcher.transforms for one in message.transforms]
    assert camera_at.header.frame_id == f"left/{calibration.planes[0].finger}_base"
    assert camera_at.child_frame_id == "left/camera_optical_frame"
    # the base is seen where the plane's homography puts its origin
    turn, place = camera_at.transform.rotation, camera_at.transform.translation
    into = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).inv()
    origin = calibration.lens.matrix @ into.apply([-place.x, -place.y, -place.z])
    seen = calibration.planes[0].homography[:, 2]
    assert (origin / origin[2])[:2] == pytest.approx((seen / seen[2])[:2], abs=0.01)
    assert watcher.infos[0].k[0] == pytest.approx(1152.0)
    (finger,) = watcher.measured[0].fingers
    assert finger.finger == "index"
    assert list(finger.joint_angles) == pytest.approx(POSE.tolist(), abs=0.01)
    assert (finger.tip.x, finger.tip.y) == pytest.approx(tuple(scene.tip("index", POSE)), abs=3e-4)
    assert math.isnan(finger.pulled_length)
    assert math.isnan(finger.tension)
    assert seconds(watcher.measured[0].header.stamp) == pytest.approx(now, abs=2e-6)
    markers = watcher.markers[0].markers
    assert [marker.name for marker in markers] == ["base", "joint_0", "joint_1", "joint_2", "tip"]
    assert not any(marker.occluded for marker in markers)
    assert cv2.imdecode(np.frombuffer(watcher.overlays[0].data, np.uint8), cv2.IMREAD_COLOR).shape == (720, 1280, 3)


def test_the_first_frame_waits_for_those_who_want_all_of_them(
    watcher: Watcher, jpeg: bytes, serve: Callable[..., str], part: Callable[[bytes, str | None], bytes]
) -> None:
    """With one that never comes the wait has its end."""
    now = time.time()
    stream = serve([part(jpeg, f"{now + i:.6f}") for i in range(3)])
    late = watcher.start("camera", source=stream, wait_for="watcher,nobody", wait_limit_s=0.2)
    assert watcher.until(lambda: bool(watcher.images))
    late.send_signal(signal.SIGINT)
    said = late.communicate(timeout=10)[1]
    assert "expected a subscription of nobody to /camera/image_raw/compressed within 0.2 s, found none" in said

    end = time.monotonic() + 0.5
    watcher.until(lambda: time.monotonic() > end)
    watcher.images.clear()
    watcher.start("camera", source=stream, wait_for="'watcher, second'", wait_limit_s=60.0)
    assert watcher.until(lambda: watcher.count_publishers("camera/image_raw/compressed") == 2)  # the test's own is one
    end = time.monotonic() + 1.0
    watcher.until(lambda: time.monotonic() > end)
    assert not watcher.images
    second: list[CompressedImage] = []
    node = Node("second")
    watcher.executor_.add_node(node)
    node.create_subscription(CompressedImage, "camera/image_raw/compressed", second.append, SENSOR)
    assert watcher.until(lambda: bool(watcher.images and second))
    assert second[0].header.stamp == watcher.images[0].header.stamp
    node.destroy_node()


class HeldBack:
    """A body whose one piece is sent once it is let go of."""

    def __init__(self, piece: bytes) -> None:
        self._piece = piece
        self.go = threading.Event()

    def __iter__(self) -> Iterator[bytes]:
        self.go.wait(DEADLINE)
        yield self._piece
        time.sleep(DEADLINE)  # the stream goes on, without another frame


def test_before_the_first_frame_a_camera_waits_and_afterwards_a_missing_one_is_an_error(
    watcher: Watcher, jpeg: bytes, serve: Callable[..., str], part: Callable[[bytes, str | None], bytes]
) -> None:
    body = HeldBack(part(jpeg, f"{time.time():.6f}"))
    watcher.start("camera", source=serve(body), timeout_s=60.0, stale_after_s=0.1)
    assert watcher.until(lambda: watcher.said("no frame yet, waiting"))
    end = time.monotonic() + 1.5  # three looks of the node
    watcher.until(lambda: time.monotonic() > end)
    assert watcher.levels["camera: capture"] == {3}  # DiagnosticStatus.STALE
    body.go.set()
    assert watcher.until(lambda: bool(watcher.images))
    assert watcher.until(lambda: watcher.said("expected frames younger than 0.1 s"))
    assert watcher.health["camera: capture"][0] == 2


def test_a_camera_that_never_delivers_is_named(watcher: Watcher, jpeg: bytes, serve: Callable[..., str]) -> None:
    watcher.start("camera", source=serve(HeldBack(jpeg)), timeout_s=60.0, first_frame_s=1.0)
    assert watcher.until(lambda: watcher.said("expected a first frame within 1 s, found none; check camera, cable"))
    assert watcher.health["camera: capture"][0] == 2


def test_bad_frames_are_named_and_nothing_is_measured(watcher: Watcher, calibration_file: Path, jpeg: bytes) -> None:
    watcher.start("marker_tracker", calibration_file=calibration_file)
    assert watcher.until(lambda: watcher.compressed.get_subscription_count() >= 2)
    small = bytes(cv2.imencode(".jpg", np.zeros((360, 640, 3), np.uint8))[1])
    green = bytes(cv2.imencode(".jpg", np.full((720, 1280, 3), (60, 190, 50), np.uint8))[1])
    for bad, complaint in (
        (b"not a jpeg", "expected a compressed image"),
        (jpeg[: len(jpeg) // 200], "expected a compressed image"),
        (small, "expected images of 1280x720, found 640x360"),
        (green, "expected a chain of 5 markers"),
    ):

        def shown(bad: bytes = bad, complaint: str = complaint) -> bool:
            watcher.show(bad)
            watcher.executor_.spin_once(timeout_sec=0.05)
            return watcher.said(complaint)

        assert watcher.until(shown), (complaint, watcher.health)
    assert watcher.measured == []

    def good() -> bool:
        watcher.show(jpeg)
        watcher.executor_.spin_once(timeout_sec=0.05)
        return bool(watcher.measured)

    assert watcher.until(good), "a good frame after bad ones is measured"


def test_a_size_that_changes_in_mid_stream_is_named_by_both_nodes(
    watcher: Watcher,
    calibration_file: Path,
    jpeg: bytes,
    serve: Callable[..., str],
    part: Callable[[bytes, str | None], bytes],
) -> None:
    """Frames of the calibrated size, then of another one: those are passed on as uncalibrated and not measured."""
    small = bytes(cv2.imencode(".jpg", np.zeros((360, 640, 3), np.uint8))[1])
    url = serve([part(jpeg, None), part(small, None)])
    watcher.start("marker_tracker", calibration_file=calibration_file)
    assert watcher.until(lambda: watcher.said("no frame yet; is the camera running?"))
    watcher.start("camera", source=url, calibration_file=calibration_file, reconnect_delay_s=0.2)
    assert watcher.until(
        lambda: all(
            "found 640x360" in watcher.health.get(f"{node}: frames", (0, ""))[1]
            for node in ("camera", "marker_tracker")
        )
    ), watcher.health
    assert watcher.health["camera: frames"][0] == 2
    assert watcher.until(lambda: {info.width for info in watcher.infos} == {640, 1280})
    assert all(info.k[0] == 0.0 for info in watcher.infos if info.width == 640)
    assert watcher.until(lambda: bool(watcher.measured))
    sizes = {seconds(info.header.stamp): info.width for info in watcher.infos}
    stamps = [seconds(message.header.stamp) for message in watcher.measured]
    assert all(sizes.get(stamp, 1280) == 1280 for stamp in stamps)


def test_raw_images_of_another_driver_and_a_swap(watcher: Watcher, calibration_file: Path, jpeg: bytes) -> None:
    watcher.start("marker_tracker", calibration_file=calibration_file, transport="raw")
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    rgb = np.ascontiguousarray(image[:, :, ::-1])
    mounted = MountedFinger(finger="index", serial="F-1", profile="hook", state=MountedFinger.VERIFIED)
    watcher.cell.publish(CellState(mounted=[mounted]))

    def profile() -> str:
        message = Image(header=watcher.header(), height=720, width=1280, encoding="rgb8", step=1280 * 3)
        message.data = array.array("B", rgb.tobytes())
        watcher.raw.publish(message)
        watcher.executor_.spin_once(timeout_sec=0.05)
        return watcher.measured[-1].fingers[0].profile if watcher.measured else ""

    assert watcher.until(lambda: profile() == "hook")
    assert list(watcher.measured[-1].fingers[0].joint_angles) == pytest.approx(POSE.tolist(), abs=0.01)

    def grey() -> bool:
        message = Image(header=watcher.header(), height=720, width=1280, encoding="mono8", step=1280)
        message.data = array.array("B", bytes(720 * 1280))
        watcher.raw.publish(message)
        watcher.executor_.spin_once(timeout_sec=0.05)
        return watcher.said("found encoding 'mono8'")

    assert watcher.until(grey)


def test_a_tracker_whose_frames_take_long_steps_behind_until_they_are_brief_again(
    watcher: Watcher, calibration_file: Path
) -> None:
    trial = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    if subprocess.run([sys.executable, "-c", trial], capture_output=True, check=False).returncode != 0:
        pytest.skip("no right to real-time priority here")
    noise = np.random.default_rng(1).integers(0, 256, (720, 1280, 3), np.uint8)  # nothing takes longer to decode
    large, small = (bytes(cv2.imencode(".jpg", image)[1]) for image in (noise, noise[:8, :8]))
    process = watcher.start("marker_tracker", calibration_file=calibration_file, realtime_priority=10).pid

    def goes(policy: int, jpeg: bytes) -> bool:
        def look() -> bool:
            watcher.show(jpeg)
            return os.sched_getscheduler(process) == policy

        return watcher.until(look)

    assert watcher.until(lambda: watcher.said("no frame yet; is the camera running?"))
    assert watcher.until(lambda: os.sched_getscheduler(process) == os.SCHED_FIFO)
    assert goes(os.SCHED_OTHER, large)
    assert goes(os.SCHED_FIFO, small)


def test_what_keeps_the_nodes_from_starting(watcher: Watcher, tmp_path: Path) -> None:
    missing = tmp_path / "missing.yaml"
    for node, parameters, complaint in (
        (
            "marker_tracker",
            {"calibration_file": missing, "calibration_wait_s": 0.2},
            "expected a file there within 0.2 s",
        ),
        ("camera", {"source": "ftp://nowhere"}, "expected http, https or rtsp"),
        ("camera", {"jpeg_quality": 500}, "jpeg_quality"),
    ):
        process = watcher.start(node, **parameters)
        _, errors = process.communicate(timeout=DEADLINE)
        assert process.returncode == 2
        assert complaint in errors


def test_a_bench_that_lacks_camera_or_calibration_says_so(watcher: Watcher) -> None:
    watcher.start("camera", source="none")
    watcher.start("marker_tracker")
    assert watcher.until(lambda: watcher.said("this bench has no camera"))
    assert watcher.until(lambda: watcher.said("run calibrate_camera"))
    assert watcher.health["camera: capture"][0] == 0
    assert watcher.health["marker_tracker: calibration"][0] == 1


def test_no_camera_is_an_error_on_diagnostics(watcher: Watcher) -> None:
    watcher.start("camera", source="/dev/video97")
    assert watcher.until(lambda: watcher.said("/dev/video97: expected a camera"))
    assert watcher.health["camera: capture"][0] == 2


def test_a_lens_from_camera_calibration_is_written_and_used(
    watcher: Watcher,
    tmp_path: Path,
    jpeg: bytes,
    calibration: CameraCalibration,
    serve: Callable[..., str],
    part: Callable[[bytes, str | None], bytes],
) -> None:
    """As cameracalibrator calls it with camera:=camera: refused for another size, then written and published."""
    stream = serve([part(jpeg, None)] * 400)
    lens_file = tmp_path / "lens.yaml"
    watcher.start("camera", source=stream, lens_file=lens_file, reconnect_delay_s=0.2)
    assert watcher.until(lambda: bool(watcher.infos))
    assert not any(watcher.infos[-1].k)
    client = watcher.create_client(SetCameraInfo, "camera/set_camera_info")
    assert watcher.until(client.service_is_ready)
    lens = calibration.lens
    info = CameraInfo(
        width=lens.width,
        height=lens.height,
        distortion_model=lens.distortion_model,
        k=[float(value) for value in lens.matrix.ravel()],
        d=[float(value) for value in lens.distortion],
    )

    def answer(message: CameraInfo) -> tuple[bool, str]:
        future = client.call_async(SetCameraInfo.Request(camera_info=message))
        assert watcher.until(future.done)
        return future.result().success, future.result().status_message

    wrong = CameraInfo(width=10, height=10, distortion_model=info.distortion_model, k=info.k, d=info.d)
    assert answer(wrong) == (False, f"expected a lens for images of {lens.width}x{lens.height}, found 10x10")
    spoiled = CameraInfo(width=lens.width, height=lens.height, distortion_model="plumb_bob", k=info.k, d=[math.nan] * 5)
    assert "expected finite numbers" in answer(spoiled)[1]
    assert not lens_file.exists()
    success, said = answer(info)
    assert success, said
    assert "in use" in said
    assert files.load(lens_file).lens.matrix == pytest.approx(lens.matrix)
    assert watcher.until(lambda: list(watcher.infos[-1].k) == pytest.approx(lens.matrix.ravel()))


def test_a_camera_without_a_place_for_the_lens_refuses_it(watcher: Watcher, tmp_path: Path) -> None:
    watcher.start("camera", source=f"'@{tmp_path}/never'")
    client = watcher.create_client(SetCameraInfo, "camera/set_camera_info")
    assert watcher.until(client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request())
    assert watcher.until(future.done)
    assert not future.result().success
    assert "lens_file" in future.result().status_message
