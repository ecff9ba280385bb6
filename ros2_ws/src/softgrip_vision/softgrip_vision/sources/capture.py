# SPDX-License-Identifier: Apache-2.0
"""A thread that captures: reconnects, and drops rather than lags."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

from softgrip_time.units import to_s
from softgrip_vision.errors import SourceError
from softgrip_vision.frame import CameraFrame, FrameSource
from softgrip_vision.sources.opening import SourceKind, SourceOptions, dereference, kind_of, open_source
from softgrip_vision.v4l2_controls import ControlReport

#: [s] how often a file that is to appear is looked for.
REFERENCE_PERIOD = 0.05


class CaptureState(Enum):
    """What the capture is doing."""

    WAITING = "waiting for the file that names the camera"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    BROKEN = "broken, will reconnect"
    ENDED = "ended"


@dataclass(frozen=True)
class CaptureStatus:
    """How the capture is.

    Attributes:
        state: what it is doing.
        message: in words.
        frames: captured since the start.
        dropped: of these, those that nobody took in time.
        connections: made since the start.
        controls: what came of the controls of a device; None for any other source.
    """

    state: CaptureState = CaptureState.CONNECTING
    message: str = ""
    frames: int = 0
    dropped: int = 0
    connections: int = 0
    controls: ControlReport | None = None


class Capture:
    """Reads a source in a thread of its own and keeps the newest frames until they are taken.

    Args:
        source: as the user wrote it, also ``@file``: the source is named in a file that may appear later.
        options: how to open it.
        on_frame: called from the thread after a frame was put in.
        depth: frames kept; when one more comes, the oldest is dropped.
        reconnect_delay: [s] between attempts.
        repeat: start a file or folder again at its end.
        live_pace: give a file's frames out at their own rate, not as fast as they can be read.

    Raises:
        SourceError: when the source cannot be a source at all (see kind_of).
    """

    def __init__(
        self,
        source: str,
        options: SourceOptions,
        on_frame: Callable[[], None],
        *,
        depth: int = 2,
        reconnect_delay: float = 1.0,
        repeat: bool = False,
        live_pace: bool = True,
    ) -> None:
        self._kind = kind_of(source)
        self._source, self._options, self._on_frame = source, options, on_frame
        self._reconnect_delay, self._repeat, self._live_pace = reconnect_delay, repeat, live_pace
        self._frames: deque[CameraFrame] = deque()
        self._depth = depth
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._status = CaptureStatus()
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)

    @property
    def status(self) -> CaptureStatus:
        """How the capture is now."""
        with self._lock:
            return self._status

    def start(self) -> None:
        """Start capturing."""
        self._thread.start()

    def take_frame(self) -> CameraFrame | None:
        """Return the oldest frame that was not taken yet, None when there is none."""
        with self._lock:
            return self._frames.popleft() if self._frames else None

    def stop(self, timeout: float = 3.0) -> None:
        """Stop and let go of the source; waits up to ``timeout`` [s] for a read that is under way."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _note(self, state: CaptureState, message: str) -> None:
        with self._lock:
            connections = self._status.connections + (state is CaptureState.STREAMING)
            self._status = replace(self._status, state=state, message=message, connections=connections)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                if self._session():
                    return
            except SourceError as error:
                self._note(CaptureState.BROKEN, str(error))
            self._stop.wait(self._reconnect_delay)

    def _session(self) -> bool:
        """Capture until the source ends; return True when there is nothing more to capture."""
        target = self._target()
        if target is None:
            return True
        # Another try of what is broken leaves the reason standing: it would come and go with every try.
        if self.status.state is not CaptureState.BROKEN:
            self._note(CaptureState.CONNECTING, target)
        opened = open_source(target, self._options)
        finite = kind_of(target) in {SourceKind.VIDEO, SourceKind.FOLDER}
        try:
            self._note(CaptureState.STREAMING, target)
            with self._lock:
                self._status = replace(self._status, controls=getattr(opened, "controls", None))
            self._pump(opened, paced=finite and self._live_pace)
        finally:
            opened.close()
        if finite and not self._repeat:
            self._note(CaptureState.ENDED, f"{target}: all frames were given out")
            return True
        if not finite:
            self._note(CaptureState.BROKEN, f"{target}: the stream ended")
        return False

    def _target(self) -> str | None:
        """Return the source, once its name is known; None when stopped before."""
        if self._kind is not SourceKind.REFERENCE:
            return self._source
        while not self._stop.is_set():
            target = dereference(self._source)
            if target is not None:
                return target
            self._note(CaptureState.WAITING, self._source.removeprefix("@"))
            self._stop.wait(REFERENCE_PERIOD)
        return None

    def _pump(self, source: FrameSource, *, paced: bool) -> None:
        start: tuple[float, int] | None = None
        while not self._stop.is_set():
            frame = source.read()
            if frame is None:
                return
            if paced:
                start = start or (time.monotonic(), frame.stamp_ns)
                due = start[0] + to_s(frame.stamp_ns - start[1])
                self._stop.wait(max(0.0, due - time.monotonic()))
            self._put(frame)

    def _put(self, frame: CameraFrame) -> None:
        with self._lock:
            self._frames.append(frame)
            dropped = len(self._frames) > self._depth
            if dropped:
                self._frames.popleft()
            self._status = replace(self._status, frames=self._status.frames + 1, dropped=self._status.dropped + dropped)
        self._on_frame()
