# SPDX-License-Identifier: Apache-2.0
"""The process that is the camera: `python -m softgrip_emulator.camera.process FD`, started by `camera_process`."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from softgrip_emulator.camera.camera import Camera
from softgrip_emulator.camera.exposure_sample import ExposureReport
from softgrip_emulator.camera.optics import calibrated, draw_optics, write_calibration
from softgrip_emulator.camera.scene import Scene
from softgrip_emulator.camera.stream import FrameBoard, StreamServer

if TYPE_CHECKING:
    from softgrip_emulator.camera.exposure_sample import ExposureSample, SetUp

_NICE: Final = 5
"""A late frame is a late frame; a late servo stops the cell."""
_VIEWERS_POLL_S: Final = 0.02
"""How often to look whether the stream has viewers."""


def main() -> None:
    """Be the camera until the cell ends."""
    # Ctrl-C reaches the whole group of processes; it is the cell that says when the camera ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    cv2.setNumThreads(1)
    link: Connection[Any, Any] = Connection(int(sys.argv[1]))
    set_up: SetUp = link.recv()
    settings = set_up.settings
    if settings.realtime_priority > 0:
        # not by softgrip_nodekit, which would bring rclpy into this process
        with suppress(OSError, AttributeError):  # not allowed, or not on this system: ordinary
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(settings.realtime_priority))
    board = FrameBoard()
    optics = draw_optics(settings.width, settings.height, set_up.seed)
    try:
        write_calibration(set_up.calibration_file, calibrated(optics, set_up.seed), set_up.finger, set_up.seed)
        server = StreamServer(board, settings.port)
        server.start(set_up.url_file)
    except OSError as error:
        link.send(error)
        return
    link.send(server.url)
    random = np.random.default_rng([set_up.seed, 0x4652]).random
    camera = Camera(Scene(optics, set_up.seed), board, jpeg_quality=settings.jpeg_quality, random=random)
    threading.Thread(target=_serve, args=(link, camera, board), name="camera", daemon=True).start()
    sys.stdin.buffer.read()
    server.close()


def _serve(link: Connection[Any, Any], camera: Camera, board: FrameBoard) -> None:
    """Expose whenever the cell asks; report the frames and the viewers."""
    viewers = 0
    with suppress(OSError, EOFError):  # the cell has ended
        while True:
            if link.poll(_VIEWERS_POLL_S):
                sample: ExposureSample = link.recv()
                is_shown = camera.expose(sample)
                viewers = board.viewers
                link.send(ExposureReport(camera.frames_taken, viewers, is_rendered=True, is_shown=is_shown))
                # what can be done ahead is done when the frame just taken is on its way
                camera.prepare()
            elif viewers != board.viewers:
                viewers = board.viewers
                link.send(ExposureReport(camera.frames_taken, viewers))


if __name__ == "__main__":
    main()
