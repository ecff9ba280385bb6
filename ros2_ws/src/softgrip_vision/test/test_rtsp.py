# SPDX-License-Identifier: Apache-2.0
"""RTSP for real: FFmpeg (inside OpenCV) talks to a small server that sends JPEG over RTP (RFC 2326, 2435, 3550)."""

from __future__ import annotations

import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
import pytest

from softgrip_vision.errors import SourceError
from softgrip_vision.sources import CameraFrame, Capture, CaptureState, SourceOptions, open_source

#: [s] between frames, and how long anything may take.
PERIOD, DEADLINE = 0.02, 20.0
PAYLOAD_TYPE, CLOCK = 26, 90_000
LARGEST_PAYLOAD = 1400
DESCRIPTION = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
    f"m=video 0 RTP/AVP {PAYLOAD_TYPE}\r\na=control:streamid=0\r\n"
)


def segments(jpeg: bytes) -> tuple[bytes, bytes]:
    """The two quantisation tables and the entropy-coded scan of a baseline JPEG (ITU-T T.81 annex B)."""
    tables, at = b"", 2
    while True:
        marker, length = struct.unpack_from(">HH", jpeg, at)
        body = jpeg[at + 4 : at + 2 + length]
        at += 2 + length
        if marker == 0xFFDB:
            for start in range(0, len(body), 65):
                tables += body[start + 1 : start + 65]
        if marker == 0xFFDA:
            return tables, jpeg[at : jpeg.rindex(b"\xff\xd9")]


def packets(jpeg: bytes, size: tuple[int, int], index: int, first: int) -> Iterator[bytes]:
    """The RTP packets of one frame: 4:2:0 (type 1), tables sent along (Q = 255)."""
    tables, scan = segments(jpeg)
    at = 0
    while at < len(scan):
        header = struct.pack(">I", at) + bytes([1, 255, size[0] // 8, size[1] // 8])
        if at == 0:
            header += struct.pack(">BBH", 0, 0, len(tables)) + tables
        piece = scan[at : at + LARGEST_PAYLOAD]
        at += len(piece)
        last = 0x80 if at == len(scan) else 0
        stamp = round(index * PERIOD * CLOCK)
        yield struct.pack(">BBHII", 0x80, last | PAYLOAD_TYPE, first & 0xFFFF, stamp, 1) + header + piece
        first += 1


class Camera(socketserver.ThreadingTCPServer):
    """Plays its frames to everyone who asks, then hangs up, or falls silent."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, images: Sequence[np.ndarray], *, hang_up: bool) -> None:
        super().__init__(("127.0.0.1", 0), Session)
        self.size = images[0].shape[1], images[0].shape[0]
        self.jpegs = [bytes(cv2.imencode(".jpg", image)[1]) for image in images]
        self.hang_up = hang_up
        self.over = threading.Event()
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()

    @property
    def url(self) -> str:
        return f"rtsp://127.0.0.1:{self.server_address[1]}/camera"


class Session(socketserver.StreamRequestHandler):
    server: Camera

    def handle(self) -> None:
        while (request := self._request()) is not None:
            method, number, transport = request
            if method == "SETUP" and "/TCP" not in transport:
                self.wfile.write(f"RTSP/1.0 461 Unsupported transport\r\nCSeq: {number}\r\n\r\n".encode())
                continue
            answer = {
                "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n\r\n",
                "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(DESCRIPTION)}\r\n\r\n{DESCRIPTION}",
                "SETUP": "Session: 1\r\nTransport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n\r\n",
            }.get(method, "Session: 1\r\n\r\n")
            self.wfile.write(f"RTSP/1.0 200 OK\r\nCSeq: {number}\r\n{answer}".encode())
            if method == "PLAY":
                self._play()
                return

    def _request(self) -> tuple[str, str, str] | None:
        """Method, number and transport asked for."""
        method, headers = "", {}
        while line := self.rfile.readline().decode().strip():
            method = method or line.split()[0]
            name, _, value = line.partition(":")
            headers[name.lower()] = value.strip()
        return (method, headers.get("cseq", ""), headers.get("transport", "")) if method else None

    def _play(self) -> None:
        sent = 0
        try:
            for index, jpeg in enumerate(self.server.jpegs):
                for packet in packets(jpeg, self.server.size, index, sent):
                    self.wfile.write(struct.pack(">cBH", b"$", 0, len(packet)) + packet)
                    sent += 1
                if self.server.over.wait(PERIOD):
                    return
            if not self.server.hang_up:
                self.server.over.wait(DEADLINE)
        except OSError:
            return  # the reader went away


@pytest.fixture
def camera() -> Iterator[Callable[..., Camera]]:
    """Start cameras."""
    started: list[Camera] = []

    def start(images: Sequence[np.ndarray], *, hang_up: bool = True) -> Camera:
        started.append(Camera(images, hang_up=hang_up))
        return started[-1]

    yield start
    for server in started:
        server.over.set()
        server.shutdown()
        server.server_close()


def greys(count: int) -> list[np.ndarray]:
    return [np.full((120, 160, 3), 20 + 4 * k, np.uint8) for k in range(count)]


def test_frames_come_in_order_with_their_time_of_arrival(camera: Callable[..., Camera]) -> None:
    before = time.time_ns()
    source = open_source(camera(greys(40)).url, SourceOptions(timeout=5.0))
    frames: list[CameraFrame] = []
    while (frame := source.read()) is not None:
        frames.append(frame)
    source.close()
    levels = [float(frame.pixels().mean()) for frame in frames]
    assert len(frames) >= 30
    assert levels == sorted(levels)
    assert levels[-1] == pytest.approx(20 + 4 * 39, abs=3)
    assert (frames[0].width, frames[0].height) == (160, 120)
    stamps = [frame.stamp_ns for frame in frames]
    assert before < stamps[0]
    assert stamps == sorted(stamps)
    assert stamps[-1] <= time.time_ns()


def test_a_stream_that_ends_is_connected_to_again(camera: Callable[..., Camera]) -> None:
    url = camera(greys(20)).url
    capture = Capture(url, SourceOptions(timeout=5.0), lambda: None, reconnect_delay=0.05)
    capture.start()
    end = time.monotonic() + DEADLINE
    waiting = threading.Event()
    while capture.status.connections < 2 and time.monotonic() < end:
        waiting.wait(0.02)
    assert capture.status.connections >= 2
    assert capture.status.frames > 10
    capture.stop()


def test_a_stream_that_falls_silent_is_given_up_in_time(camera: Callable[..., Camera]) -> None:
    source = open_source(camera(greys(30), hang_up=False).url, SourceOptions(timeout=0.7))
    while source.read() is not None:
        pass
    source.close()


def test_no_rtsp_server_is_named() -> None:
    with pytest.raises(SourceError, match="expected a stream that FFmpeg can read"):
        open_source("rtsp://127.0.0.1:1/camera", SourceOptions(timeout=1.0))


def test_a_capture_says_that_a_stream_is_missing() -> None:
    capture = Capture("rtsp://127.0.0.1:1/camera", SourceOptions(timeout=1.0), lambda: None, reconnect_delay=0.05)
    capture.start()
    end = time.monotonic() + DEADLINE
    waiting = threading.Event()
    while capture.status.state is not CaptureState.BROKEN and time.monotonic() < end:
        waiting.wait(0.02)
    assert capture.status.state is CaptureState.BROKEN
    assert "rtsp://127.0.0.1:1/camera" in capture.status.message
    capture.stop()
