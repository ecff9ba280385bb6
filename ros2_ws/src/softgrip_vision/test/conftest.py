# SPDX-License-Identifier: Apache-2.0
"""Scenes, cameras and streams that the tests share."""

from __future__ import annotations

import http.server
import os
import socketserver
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_testing.synthetic_images import Conditions, SyntheticScene, make_calibration
from softgrip_vision.calibration import CameraCalibration
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.tracker import Tracker

CHAIN = ChainLayout((0.045, 0.027, 0.023))


@pytest.fixture(scope="session", autouse=True)
def one_core() -> None:
    cv2.setNumThreads(1)


@pytest.fixture(scope="session")
def calibration() -> CameraCalibration:
    return make_calibration()


@pytest.fixture(scope="session")
def scene(calibration: CameraCalibration) -> SyntheticScene:
    return SyntheticScene(calibration, {"index": CHAIN}, seed=1)


@pytest.fixture
def tracker(calibration: CameraCalibration) -> Tracker:
    return Tracker((FingerSetup("index"),), {"power": {"index": CHAIN}}, calibration, "power")


@pytest.fixture(scope="session")
def jpegs(scene: SyntheticScene) -> list[bytes]:
    """Five frames of a finger that closes slowly."""
    images = [scene.render({"index": np.full(3, 0.1 + 0.02 * k)}, Conditions(noise=1.0)).image for k in range(5)]
    return [bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]) for image in images]


@pytest.fixture(scope="session")
def hand_video() -> Path:
    """A real hand, without markers: named by SOFTGRIP_HAND_VIDEO, or in the shared data beside the repository."""
    named = os.environ.get("SOFTGRIP_HAND_VIDEO")
    path = Path(named) if named else Path(__file__).parents[5] / "shared/data/hand/human_hand_video.mp4"
    if not path.exists():
        pytest.skip(f"no recording of a real hand at {path}")
    return path


class _Server(socketserver.ThreadingMixIn, http.server.HTTPServer):
    daemon_threads = True


@pytest.fixture
def serve() -> Iterator[Callable[[Iterable[bytes], str], str]]:
    """Serve the given pieces of a body, one connection after the other gets all of them; returns the URL."""
    servers: list[_Server] = []

    def start(pieces: Iterable[bytes], content_type: str = "multipart/x-mixed-replace; boundary=frame") -> str:
        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", content_type)
                self.end_headers()
                for piece in pieces:
                    self.wfile.write(piece)

            def log_message(self, *_: object) -> None:
                pass

        server = _Server(("127.0.0.1", 0), Handler)
        servers.append(server)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return f"http://127.0.0.1:{server.server_address[1]}/stream"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def _part(jpeg: bytes, stamp: str | None) -> bytes:
    header = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n"
    if stamp is not None:
        header += f"X-Timestamp: {stamp}\r\n"
    return header.encode() + b"\r\n" + jpeg + b"\r\n"


@pytest.fixture(scope="session")
def part() -> Callable[[bytes, str | None], bytes]:
    """One part of a multipart body."""
    return _part
