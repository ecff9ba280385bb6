# SPDX-License-Identifier: Apache-2.0
"""The camera in a process of its own, so that rendering holds up neither the servos' bus nor the plant.

This is the cell's end; `process` is the other. The cell speaks with it over a socket: first the set-up, answered by the
stream's address or by what went wrong; then the cell sends an `ExposureSample` for each exposure and gets an
`ExposureReport` back. The process ends when its standard input does, however the cell ended.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Final

from softgrip_emulator.camera.exposure_sample import CameraFaults, CameraSettings, ExposureReport, SetUp

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from softgrip_emulator.camera.exposure_sample import ExposureSample

_PROCESS: Final = "softgrip_emulator.camera.process"
_START_S: Final = 60.0
_END_S: Final = 2.0


class CameraProcess:
    """The cell's end: starts the process, asks for exposures, ends it.

    Args:
        settings: resolution, rate, port.
        seed: of everything that is drawn.
        finger: that the camera looks at.
        on_report: called in a thread of this object with each report of the process.
    """

    def __init__(
        self, settings: CameraSettings, seed: int, finger: str, on_report: Callable[[ExposureReport], None]
    ) -> None:
        self.faults = CameraFaults()
        self.frames_taken = 0
        #: of the stream
        self.viewers = 0
        #: an exposure is being rendered
        self.is_exposing = False
        self.stream_url = ""
        self._settings, self._seed, self._finger = settings, seed, finger
        self._on_report = on_report
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Connection[Any, Any] | None = None
        self._thread = threading.Thread(target=self._listen, name="camera", daemon=True)

    def open(self, url_file: Path, calibration_file: Path) -> None:
        """Start the process; returns when the stream is there and its address and its calibration are in these files.

        Raises:
            OSError: the port is taken, the folder cannot be written, or the process does not start.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", _PROCESS, str(theirs.fileno())],
                stdin=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
            )
        self._link = Connection(ours.detach())
        try:
            self._link.send(SetUp(self._settings, self._seed, self._finger, url_file, calibration_file))
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

    def expose(self, sample: ExposureSample) -> None:
        """Ask for a frame; `is_exposing` until the process has reported it. One at a time."""
        link = self._link
        if link is None or not self.running:
            return
        self.is_exposing = True
        try:
            link.send(sample)
        except OSError:
            self.is_exposing = False

    def _listen(self) -> None:
        link = self._link
        assert link is not None
        try:
            while True:
                report: ExposureReport = link.recv()
                self.frames_taken, self.viewers = report.frames_taken, report.viewers
                self.is_exposing = self.is_exposing and not report.is_rendered
                self._on_report(report)
        except (EOFError, OSError):
            self.is_exposing, self.viewers = False, 0
