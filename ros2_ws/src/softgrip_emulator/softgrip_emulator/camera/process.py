# SPDX-License-Identifier: Apache-2.0
"""The process that is the camera: `python -m softgrip_emulator.camera.process FD`, started by `apart`."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from softgrip_emulator.camera.camera import Camera
from softgrip_emulator.camera.optics import calibrated, draw_optics, write_calibration
from softgrip_emulator.camera.scene import Scene
from softgrip_emulator.camera.stream import FrameBoard, StreamServer

if TYPE_CHECKING:
    from softgrip_emulator.camera.exposure_sample import ExposureSample, SetUp

_NICE: Final = 5
"""A late frame is a late frame; a late servo stops the cell."""


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

    def look() -> ExposureSample:
        link.send(camera.frames_taken)
        seen: ExposureSample = link.recv()
        return seen

    camera = Camera(
        Scene(optics, set_up.seed),
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
