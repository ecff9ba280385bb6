# SPDX-License-Identifier: Apache-2.0
"""Frames from streams, files and folders; everything that can be wrong with them."""

from __future__ import annotations

import io
import os
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_vision.errors import FrameError, SourceError
from softgrip_vision.sources import (
    CameraFrame,
    Capture,
    CaptureState,
    SourceOptions,
    decode,
    image_size,
    jpeg_size,
    open_source,
)
from softgrip_vision.sources.mjpeg import PartReader, boundary_of, capture_time_ns
from softgrip_vision.sources.opencv import DeviceStream
from softgrip_vision.sources.opening import SourceKind, dereference, kind_of
from softgrip_vision.v4l2_controls import ControlSettings

Serve = Callable[..., str]
Part = Callable[[bytes, str | None], bytes]
DEADLINE = 5.0


def until(condition: Callable[[], bool]) -> bool:
    """Wait for a condition; False at the deadline."""
    pause, end = threading.Event(), time.monotonic() + DEADLINE
    while time.monotonic() < end:
        if condition():
            return True
        pause.wait(0.01)
    return False


def test_parts_of_a_known_body() -> None:
    body = (
        b"\r\n--gc0p4Jq0M2Yt08jU534c0p\r\nContent-Type: image/jpeg\r\nContent-Length: 4\r\n"
        b"X-Timestamp: 1795227745.250\r\n\r\nab\r\n\r\n--gc0p4Jq0M2Yt08jU534c0p\r\n\r\n"
        b"\xff\xd8--\n\xff\xd9\r\n--gc0p4Jq0M2Yt08jU534c0p--\r\n"
    )
    reader = PartReader(io.BytesIO(body), b"gc0p4Jq0M2Yt08jU534c0p")
    headers, first = reader.next_part() or ({}, b"")
    assert headers == {"content-type": "image/jpeg", "content-length": "4", "x-timestamp": "1795227745.250"}
    assert first == b"ab\r\n"
    assert reader.next_part() == ({}, b"\xff\xd8--\n\xff\xd9")
    assert reader.next_part() is None


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        (b"--b\r\nContent-Length: 10\r\n\r\nabc", "7 short"),
        (b"--b\r\nContent-Length: -3\r\n\r\nabc", "Content-Length"),
        (b"--b\r\nContent-Length: 99999999999\r\n\r\nabc", "Content-Length"),
        (b"--b\r\nno colon here\r\n\r\nabc", "header lines"),
        (b"--b\r\nContent-Type: image/jpeg\r\n", "end of the stream"),
        (b"--b\r\n\r\nnever ends", "end of a JPEG part"),
    ],
)
def test_broken_bodies_are_named(body: bytes, complaint: str) -> None:
    with pytest.raises(SourceError, match=complaint):
        PartReader(io.BytesIO(body), b"--b").next_part()


def test_content_types() -> None:
    assert boundary_of("multipart/x-mixed-replace; boundary=frame") == b"frame"
    assert boundary_of('multipart/x-mixed-replace;boundary="--my boundary"') == b"--my boundary"
    with pytest.raises(SourceError, match="found 'text/html'"):
        boundary_of("text/html")


def test_capture_time_is_exact_to_the_nanosecond() -> None:
    assert capture_time_ns({"x-timestamp": "1795227745.123456789"}, 5) == 1795227745_123456789
    assert capture_time_ns({}, 5) == 5
    for wrong in ("soon", "-1", "nan", "1e30"):
        with pytest.raises(SourceError, match="X-Timestamp"):
            capture_time_ns({"x-timestamp": wrong}, 5)


def test_jpeg_size_without_decoding() -> None:
    for size in ((1280, 720), (33, 17)):
        data = bytes(cv2.imencode(".jpg", np.zeros((size[1], size[0], 3), np.uint8))[1])
        assert jpeg_size(data) == size
        for cut in (0, 1, 2, 10, 100):
            with pytest.raises(FrameError):
                jpeg_size(data[:cut])
    with pytest.raises(FrameError, match="found 89 50"):
        jpeg_size(b"\x89PNG")


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"hello", bytes(1000)])
def test_bytes_that_are_no_image(data: bytes) -> None:
    with pytest.raises(FrameError, match="expected a compressed image"):
        decode(data)


def png_that_claims(width: int, height: int) -> bytes:
    """A black PNG of some hundred bytes, valid but for the number of its rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(1 + width), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_the_size_of_an_image_is_read_without_decoding_it(suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytes(cv2.imencode(suffix, np.zeros((48, 64, 3), np.uint8))[1])
    assert decode(data).shape == (48, 64, 3)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    assert image_size(data) == (64, 48)


@pytest.mark.parametrize(
    "data",
    [png_that_claims(20_000, 20_000), b"BM" + bytes(100), b"II*\0" + bytes(100)],
    ids=["png bomb", "bmp", "tiff"],
)
def test_huge_images_and_other_formats_do_not_reach_the_decoder(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    with pytest.raises(FrameError, match=r"32000000 pixels at most, found 20000x20000|expected a compressed image"):
        decode(data)


def test_a_stream_passes_jpeg_bytes_and_stamps_untouched(serve: Serve, part: Part, jpegs: list[bytes]) -> None:
    url = serve([part(data, f"1000.{k:03d}") for k, data in enumerate(jpegs)])
    source = open_source(url)
    for k, data in enumerate(jpegs):
        frame = source.read()
        assert frame is not None
        assert frame.encoded(50) == data
        assert frame.stamp_ns == 1000_000_000_000 + k * 1_000_000
        assert (frame.width, frame.height) == (1280, 720)
    assert source.read() is None
    source.close()


def test_a_stream_of_something_else_is_named(serve: Serve, part: Part) -> None:
    with pytest.raises(SourceError, match="found 'text/plain'"):
        open_source(serve([b"hello"], "text/plain"))
    source = open_source(serve([part(b"not a jpeg", None)]))
    with pytest.raises(SourceError, match="expected a JPEG"):
        source.read()
    source.close()


def test_no_server_is_named() -> None:
    with pytest.raises(SourceError, match="is the camera running"):
        open_source("http://127.0.0.1:1/stream")


def test_a_video_keeps_its_own_time(tmp_path: Path, jpegs: list[bytes]) -> None:
    path = tmp_path / "film.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (1280, 720))
    for data in jpegs:
        writer.write(decode(data))
    writer.release()
    source = open_source(str(path), start_ns=0)
    stamps = []
    while (frame := source.read()) is not None:
        stamps.append(frame.stamp_ns)
    assert stamps == [0, 40_000_000, 80_000_000, 120_000_000, 160_000_000]
    truncated = tmp_path / "cut.mp4"
    truncated.write_bytes(path.read_bytes()[:200])
    with pytest.raises(SourceError, match="corrupt"):
        open_source(str(truncated))


class FakeDevice:
    """Stands where OpenCV's V4L2 capture stands: three frames, then unplugged. No machine of the tests has a camera."""

    def __init__(self, buffer_ms: float) -> None:
        self.buffer_ms, self.frames, self.asked, self.released = buffer_ms, 3, {}, False

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> None:
        self.asked[key] = value

    def get(self, key: int) -> float:
        return self.buffer_ms if key == cv2.CAP_PROP_POS_MSEC else 0.0

    def grab(self) -> bool:
        self.frames -= 1
        return self.frames >= 0

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((48, 64, 3), self.frames, np.uint8)

    def release(self) -> None:
        self.released = True


@pytest.mark.parametrize(
    ("buffer_ms", "age_ns"),
    [(7_988.0, 12_000_000), (0.0, 0), (9_000.0, 0)],  # the buffer's own time; none given; another clock
)
def test_a_device_stamps_with_the_time_of_its_buffer(
    monkeypatch: pytest.MonkeyPatch, buffer_ms: float, age_ns: int
) -> None:
    device = FakeDevice(buffer_ms)
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: device)
    now = 1_700_000_000_000_000_000
    stream = DeviceStream(Path("/dev/null"), 64, 48, 60.0, lambda: now, lambda: 8_000_000_000)
    assert device.asked[cv2.CAP_PROP_FRAME_WIDTH] == 64
    assert device.asked[cv2.CAP_PROP_FPS] == 60.0
    frames = [stream.read() for _ in range(3)]
    assert [frame.stamp_ns for frame in frames if frame] == [now - age_ns] * 3
    assert [(frame.width, frame.height) for frame in frames if frame] == [(64, 48)] * 3
    with pytest.raises(SourceError, match="was it unplugged"):
        stream.read()
    stream.close()
    assert device.released


def test_what_came_of_a_devices_controls_is_in_the_captures_status(monkeypatch: pytest.MonkeyPatch) -> None:
    """/dev/null stands for a camera that knows no control: each that was asked for is a problem."""
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: FakeDevice(0.0))
    captured = threading.Event()
    capture = Capture("/dev/null", SourceOptions(controls=ControlSettings(gain=3)), captured.set, reconnect_delay=10.0)
    capture.start()
    assert captured.wait(10.0)
    found = capture.status.controls
    capture.stop()
    assert found is not None
    assert [text.partition(":")[0] for text in found.problems] == ["gain"]


def test_a_device_that_is_no_camera_is_named() -> None:
    with pytest.raises(SourceError, match="/dev/null: expected a V4L2 camera, found a device that cannot be opened"):
        open_source("/dev/null")


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Not root, whom nothing is forbidden."""
    root = os.getuid() == 0
    if root:
        os.setreuid(65534, 0)
    try:
        yield
    finally:
        if root:
            os.setreuid(0, 0)


def test_a_file_without_permission_is_named(tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    film.write_bytes(b"film")
    film.chmod(0)
    with ordinary_user(), pytest.raises(SourceError, match=r"film\.mp4: .*Permission denied"):
        open_source(str(film))


def test_a_video_with_a_hole_ends_without_a_crash(tmp_path: Path, jpegs: list[bytes]) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (1280, 720))
    for data in jpegs:
        writer.write(decode(data))
    writer.release()
    whole = path.read_bytes()
    random = np.random.default_rng(3)
    for name, data in (
        ("hole.avi", whole[: len(whole) // 3] + random.bytes(len(whole) // 3) + whole[2 * len(whole) // 3 :]),
        ("cut.avi", whole[: 2 * len(whole) // 3]),
    ):
        (tmp_path / name).write_bytes(data)
        source = open_source(str(tmp_path / name), start_ns=0)
        frames = 0
        while (frame := source.read()) is not None:
            assert frame.pixels().shape == (720, 1280, 3)
            frames += 1
        assert 1 <= frames <= 5
        source.close()


def test_a_folder_is_read_in_order_of_names(tmp_path: Path) -> None:
    for name, level in (("b.png", 20), ("a.png", 10), ("notes.txt", 0)):
        path = tmp_path / name
        if path.suffix == ".png":
            cv2.imwrite(str(path), np.full((8, 8, 3), level, np.uint8))
        else:
            path.write_text("no image")
    source = open_source(str(tmp_path), SourceOptions(fps=10.0), start_ns=0)
    frames = [source.read(), source.read()]
    assert [(int(f.pixels()[0, 0, 0]), f.stamp_ns) for f in frames if f] == [(10, 0), (20, 100_000_000)]
    assert source.read() is None


def test_paths_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SourceError, match="No such file"):
        open_source(str(tmp_path / "missing.mp4"))
    with pytest.raises(SourceError, match="No such file"):
        open_source("97")
    with pytest.raises(SourceError, match="expected images"):
        open_source(str(tmp_path))
    (tmp_path / "x.png").write_bytes(b"no image")
    source = open_source(str(tmp_path))
    with pytest.raises(SourceError, match="remove it"):
        source.read()
    monkeypatch.setattr(os, "access", lambda *_: False)  # a root user may read everything
    with pytest.raises(SourceError, match=r"Permission denied.*group 'video'"):
        open_source(str(tmp_path / "x.png"))


def test_kinds_of_sources(tmp_path: Path) -> None:
    kinds = {
        "0": SourceKind.DEVICE,
        "/dev/null": SourceKind.DEVICE,
        str(tmp_path): SourceKind.FOLDER,
        "film.mp4": SourceKind.VIDEO,
        "http://host/x": SourceKind.MJPEG,
        "rtsp://host/x": SourceKind.RTSP,
        "@/tmp/url": SourceKind.REFERENCE,
    }
    assert {source: kind_of(source) for source in kinds} == kinds
    for wrong in ("", "ftp://host/x"):
        with pytest.raises(SourceError):
            kind_of(wrong)
    pointer = tmp_path / "url"
    assert dereference(f"@{pointer}") is None
    pointer.write_text("@elsewhere")
    with pytest.raises(SourceError, match="another reference"):
        dereference(f"@{pointer}")


def run(source: str, frames: list[CameraFrame], *, repeat: bool = False) -> Capture:
    """Start a capture that puts its frames into a list."""

    def on_frame() -> None:
        frame = capture.take_frame()
        if frame is not None:
            frames.append(frame)

    capture = Capture(source, SourceOptions(timeout=1.0), on_frame, reconnect_delay=0.05, repeat=repeat)
    capture.start()
    return capture


def test_capture_waits_for_the_file_that_names_it_and_reconnects(
    tmp_path: Path, serve: Serve, part: Part, jpegs: Sequence[bytes]
) -> None:
    frames: list[CameraFrame] = []
    pointer = tmp_path / "camera.url"
    capture = run(f"@{pointer}", frames)
    assert until(lambda: capture.status.state is CaptureState.WAITING)
    pointer.write_text(serve([part(jpegs[0], "5.0"), part(jpegs[1], "6.0")]))
    # Each connection gives two frames and ends: more than two means that it came back.
    assert until(lambda: len(frames) > 4)
    assert capture.status.connections >= 2
    capture.stop()
    assert frames[0].stamp_ns == 5_000_000_000


def test_what_is_broken_stays_named_while_it_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log that tells each change of health would otherwise fill with one line a try."""
    during: list[CaptureState] = []

    def fail(*_: object) -> None:
        during.append(capture.status.state)
        raise SourceError("nothing there")

    monkeypatch.setattr("softgrip_vision.sources.capture.open_source", fail)
    pointer = tmp_path / "camera.url"
    pointer.write_text("/dev/video97")
    capture = Capture(f"@{pointer}", SourceOptions(), lambda: None, reconnect_delay=0.01)
    capture.start()
    assert until(lambda: len(during) > 4)
    capture.stop()
    assert during[0] is CaptureState.CONNECTING
    assert set(during[1:]) == {CaptureState.BROKEN}
    assert capture.status.message == "nothing there"


def test_capture_drops_the_oldest_rather_than_lag(serve: Serve, part: Part, jpegs: Sequence[bytes]) -> None:
    url = serve([part(jpegs[k % 5], f"{k}.0") for k in range(10)])
    capture = Capture(url, SourceOptions(), lambda: None, depth=2, reconnect_delay=60.0)
    capture.start()
    assert until(lambda: capture.status.frames == 10)
    assert capture.status.dropped == 8
    kept = [capture.take_frame(), capture.take_frame(), capture.take_frame()]
    assert [frame.stamp_ns // 1_000_000_000 for frame in kept if frame] == [8, 9]
    capture.stop()


def test_capture_says_when_a_file_ended(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((8, 8, 3), np.uint8))
    frames: list[CameraFrame] = []
    capture = run(str(tmp_path), frames)
    assert until(lambda: capture.status.state is CaptureState.ENDED)
    assert len(frames) == 1
    capture.stop()
    again = run(str(tmp_path), frames, repeat=True)
    assert until(lambda: len(frames) > 3)
    again.stop()
    assert again.status.state is not CaptureState.ENDED


def test_capture_says_why_it_has_no_camera() -> None:
    capture = run("97", [])
    assert until(lambda: capture.status.state is CaptureState.BROKEN)
    assert "/dev/video97" in capture.status.message
    capture.stop()
