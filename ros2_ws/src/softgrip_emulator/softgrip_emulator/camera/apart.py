# SPDX-License-Identifier: Apache-2.0
"""The camera in a process of its own, so that rendering holds up neither the servos' bus nor the plant.

The cell starts `python -m softgrip_emulator.camera.apart FD` and speaks with it over the socket FD: first the set-up,
answered by the stream's address or by what went wrong; then the process asks at each exposure (with the number of
frames so far) and gets a `Look`. It ends when its standard input does, however the cell ended.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from softgrip_emulator.camera.camera import Camera, CameraFaults, Look
from softgrip_emulator.camera.scene import Scene
from softgrip_emulator.camera.stream import FrameBoard, StreamServer

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from softgrip_emulator.camera.optics import Optics

_START_S: Final = 20.0
_END_S: Final = 2.0
_NICE: Final = 5
"""A late frame is a late frame; a late servo stops the cell."""


@dataclass(frozen=True)
class CameraSettings:
    """Resolution and rate of the emulated camera; port 0 = a free one."""

    width: int = 640
    height: int = 480
    fps: float = 30.0
    port: int = 0
    jpeg_quality: int = 88


@dataclass(frozen=True)
class _SetUp:
    settings: CameraSettings
    optics: Optics
    seed: int
    url_file: Path


class CameraApart:
    """The cell's end: starts the process, answers its looks, ends it.

    Args:
        settings: resolution, rate, port.
        optics: the true ones.
        seed: of everything that is drawn.
        look: gives what the exposure just over has seen; called in a thread of this object.
    """

    def __init__(self, settings: CameraSettings, optics: Optics, seed: int, look: Callable[[], Look]) -> None:
        self.faults = CameraFaults()
        self.frames_taken = 0
        self.stream_url = ""
        self._settings, self._optics, self._seed = settings, optics, seed
        self._look = look
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Connection[Any, Any] | None = None
        self._thread = threading.Thread(target=self._answer, name="camera", daemon=True)

    def open(self, url_file: Path) -> None:
        """Start the process; returns when the stream is there and `url_file` has its address.

        Raises:
            OSError: the port is taken, the folder cannot be written, or the process does not start.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __spec__.name, str(theirs.fileno())],
                stdin=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
            )
        self._link = Connection(ours.detach())
        try:
            self._link.send(_SetUp(self._settings, self._optics, self._seed, url_file))
            answer = self._link.recv() if self._link.poll(_START_S) else OSError(f"no answer in {_START_S} s")
        except EOFError:
            answer = OSError("its process ended while starting")
        if isinstance(answer, OSError):
            self.close()
            raise answer
        self.stream_url = answer
        self._thread.start()

    @property
    def running(self) -> bool:
        """False when the process ended without being told to."""
        return self._process is not None and self._process.poll() is None

    def close(self) -> None:
        """End the process. May be called more than once."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._thread.is_alive():
            self._thread.join(_END_S)
        if self._link is not None:
            self._link.close()
            self._link = None

    def _answer(self) -> None:
        link = self._link
        assert link is not None
        try:
            while True:
                self.frames_taken = link.recv()
                link.send(self._look())
        except (EOFError, OSError):
            return


def main() -> None:
    """Be the camera until the cell ends."""
    # Ctrl-C reaches the whole group of processes; it is the cell that says when the camera ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    cv2.setNumThreads(1)
    link: Connection[Any, Any] = Connection(int(sys.argv[1]))
    set_up: _SetUp = link.recv()
    settings = set_up.settings
    board = FrameBoard()
    try:
        server = StreamServer(board, settings.port)
        server.start(set_up.url_file)
    except OSError as error:
        link.send(error)
        return
    link.send(server.url)

    def look() -> Look:
        link.send(camera.frames_taken)
        seen: Look = link.recv()
        return seen

    camera = Camera(
        Scene(set_up.optics, set_up.seed),
        board,
        look,
        fps=settings.fps,
        jpeg_quality=settings.jpeg_quality,
        random=np.random.default_rng([set_up.seed, 0x4652]).random,
    )
    camera.start()
    sys.stdin.buffer.read()
    camera.close()
    server.close()


if __name__ == "__main__":
    main()
