# SPDX-License-Identifier: Apache-2.0
"""Every fault of the emulated camera, through the stream and the camera node's own capture and watch.

One row a fault: it is named with what to do, and the name goes when the fault does. What the tracker makes of pictures
that show nothing is in softgrip_vision's tests.
"""

import threading
import time
from pathlib import Path

import pytest

from softgrip_emulator.cell import EmulatedCell
from softgrip_model.profile import load_directory
from softgrip_vision.frame_watch import FrameWatch
from softgrip_vision.sources import Capture, SourceOptions

PROFILES = Path(__file__).parents[2] / "ros2_ws" / "src" / "softgrip_bringup" / "profiles"
ROWS = [
    ("camera_frozen", {}, "the picture is frozen"),
    ("camera_dropped", {"share": 0.6}, "frames are lost"),
    ("camera_dropped", {"share": 1.0}, ""),
    ("camera_dark", {}, "too dark"),
    ("camera_overexposed", {}, "over-exposed"),
]
DEADLINE = 10.0


class Camera:
    """Capture and watch of the camera node on the emulated stream."""

    def __init__(self, cell):
        self.watch = FrameWatch()
        self.frames = 0
        self._came = threading.Event()
        self._capture = Capture(cell.stream_url, SourceOptions(0, 0, 0.0, 2.0), self._came.set)
        self._capture.start()

    def look_until(self, condition):
        """Take frames until the watch's word meets a condition; (word, seconds), or fail."""
        began = time.monotonic()
        while True:
            self._came.wait(0.05)
            self._came.clear()
            while (frame := self._capture.take_frame()) is not None:
                self.watch.observe_frame(frame)
                self.frames += 1
            word, elapsed = self.watch.problem(), time.monotonic() - began
            if condition(word):
                return word, elapsed
            assert elapsed < DEADLINE, f"not in time; last word: {word!r}"

    def close(self):
        self._capture.stop()


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    cell = EmulatedCell(load_directory(PROFILES), tmp_path_factory.mktemp("wires"), seed=1)
    cell.plant.mount(["index"], ["PW-I-01"], ["power"])
    with cell:
        one = Camera(cell)
        yield cell, one
        one.close()


@pytest.fixture(scope="module", autouse=True)
def table(request):
    request.config.camera_fault_table = []
    return request.config.camera_fault_table


@pytest.mark.parametrize(("fault", "arguments", "word"), ROWS, ids=str)
def test_a_camera_fault_is_named_and_ends(camera, table, fault, arguments, word):
    cell, eyes = camera
    eyes.look_until(lambda found: not found and eyes.frames > 0)
    cell.faults.inject(fault, arguments=arguments)
    if word:
        said, after = eyes.look_until(lambda found: found.startswith(word))
        assert ";" in said, "what to do"
    else:
        # No frame at all: the node's capture tells by the age of the newest one (parameter stale_after_s).
        seen, stopped = eyes.frames, time.monotonic()
        eyes.look_until(lambda _: time.monotonic() - stopped > 0.5)
        assert eyes.frames <= seen + 2
        said, after = "expected frames younger than", None
    cell.faults.clear()
    eyes.look_until(lambda found: not found and eyes.frames > 0)
    label = fault + "".join(f" {name}={value}" for name, value in arguments.items())
    table.append(
        (label, said.split(":")[0], "stale_after_s" if after is None else f"{after * 1e3:.0f} ms", "by itself")
    )
