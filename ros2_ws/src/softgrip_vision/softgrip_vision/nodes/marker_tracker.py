# SPDX-License-Identifier: Apache-2.0
"""Measures the fingers' joint angles and tips from the camera's frames.

Subscribes camera/image_raw/compressed (or camera/image_raw, parameter transport) and cell/state (which profile sits in
which slot); publishes finger/measured, finger/markers and, on request, finger/overlay/compressed. Results leave from
the image callback only and depend on the messages and their stamps alone (softgrip_nodekit/event_time.py), so
that a bag replays to the same numbers.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from softgrip_interfaces.msg import CellState, FingerMarkers, FingerStates, MountedFinger
from softgrip_nodekit import (
    LATCHED,
    REALTIME_PRIORITY,
    SENSOR,
    CellFollower,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    Rank,
    StampedInputs,
    WhileBrief,
    lateness_parameter,
    nanoseconds,
    realtime_parameter,
    run,
    seconds,
    startup_errors,
)
from softgrip_vision import calibration, colour
from softgrip_vision.calibration import file_when_there
from softgrip_vision.encoded_image import decode, image_size, thumbnail, thumbnail_of
from softgrip_vision.errors import VisionError
from softgrip_vision.frame import CameraFrame
from softgrip_vision.layout import FingerSetup, parse_region, read_chains
from softgrip_vision.loss_watch import LossWatch
from softgrip_vision.nodes import convert
from softgrip_vision.options import TrackerOptions
from softgrip_vision.overlay import draw
from softgrip_vision.readings import FingerReading
from softgrip_vision.still import StillWatch
from softgrip_vision.tracker import Tracker

#: [s] by which an emulated cell's time may run ahead of a frame that is not measured yet; shorter than its period
FRAME_LAG_S = 0.04

PARAMETERS = ParameterTable(
    Parameter(
        "calibration_file",
        "",
        "camera calibration with the fingers' planes (YAML, see calibrate_camera); empty: nothing is measured",
    ),
    Parameter("calibration_wait_s", 8.0, "how long the calibration file may take to appear at start", "s", 0.0, 60.0),
    Parameter("transport", "compressed", "image topic to take", choices=("compressed", "raw")),
    Parameter("fingers", ["index"], "fingers to follow; each has a plane in the calibration"),
    Parameter(
        "hues_deg", [120.0], "marker colour of each finger on the HSV circle; one for all, or one each", "deg", 0, 360
    ),
    Parameter(
        "regions", [""], "where each finger is looked for: 'LEFT TOP WIDTH HEIGHT' [px] or '' for the whole image"
    ),
    Parameter(
        "profiles_directory", "", "folder of finger profiles, for the link lengths; empty = those of softgrip_bringup"
    ),
    Parameter("profile", "power", "profile assumed until cell/state names the mounted ones"),
    Parameter(
        "threshold_share",
        TrackerOptions().threshold_share,
        "a pixel counts as marker above this share of the markers' own signal, which is found automatically",
        "",
        0.1,
        0.9,
        changeable=True,
    ),
    Parameter(
        "placement_stddev_m",
        TrackerOptions().placement_stddev_m,
        "how exactly the markers sit on the finger",
        "m",
        0.0,
        0.005,
        changeable=True,
    ),
    Parameter(
        "largest_angle_stddev_rad",
        TrackerOptions().largest_angle_stddev,
        "a finger less certain than this is not published",
        "rad",
        0.001,
        1.0,
        changeable=True,
    ),
    Parameter(
        "reacquire_timeout_s",
        TrackerOptions().reacquire_timeout_s,
        "hidden markers are waited for so long, then the finger is searched for again",
        "s",
        0.1,
        10.0,
        changeable=True,
        former="patience_s",
    ),
    Parameter(
        "rest_period_s",
        0.0,
        "between measured frames while the picture stays the same; 0 = every frame is measured",
        "s",
        0.0,
        0.4,
    ),
    Parameter("overlay", False, "publish finger/overlay/compressed: the frame with what was found", changeable=True),
    lateness_parameter(0.2),
    realtime_parameter(Rank.ORDINARY),
)


class MarkerTrackerNode(CellNode):
    """The marker tracker node."""

    def __init__(self) -> None:
        super().__init__("marker_tracker")
        self._values = PARAMETERS.declare(self)
        self._diagnostics = Diagnostics(self)
        if not self._values["calibration_file"]:
            text = "no finger is measured: expected a calibration with planes in 'calibration_file', found ''; "
            self._diagnostics.set("calibration", Health.WARN, text + "run calibrate_camera (docs/bench.md)")
            return
        with startup_errors(VisionError):
            self._tracker = self._make_tracker()
        self._configuration = self._tracker.configuration
        PARAMETERS.on_change(self, self._apply)
        self._measured = self.create_publisher(FingerStates, "finger/measured", SENSOR)
        self._markers = self.create_publisher(FingerMarkers, "finger/markers", SENSOR)
        self._overlay = self.create_publisher(CompressedImage, "finger/overlay/compressed", SENSOR)
        self.create_subscription(CellState, "cell/state", self._on_cell_state, LATCHED)
        driver = "camera/image_raw" if self._values["transport"] == "raw" else "camera/image_raw/compressed"
        self._inputs = StampedInputs(self, driver, self._values["allowed_lateness_s"], self._diagnostics)
        if self._values["transport"] == "raw":
            self.create_subscription(Image, driver, self._on_raw, SENSOR)
        else:
            self.create_subscription(CompressedImage, driver, self._on_compressed, SENSOR)
        self._frames = self._skipped = 0
        self._losses = LossWatch()
        self._still = StillWatch(self._values["rest_period_s"])
        self._follower = CellFollower(self, "frames", FRAME_LAG_S)
        # a search of a large picture is long
        self._while_brief = WhileBrief(self._values[REALTIME_PRIORITY])
        self._diagnostics.set("frames", Health.WARN, "no frame yet; is the camera running?")

    def _make_tracker(self) -> Tracker:
        value = self._values
        known = calibration.load(file_when_there(Path(value["calibration_file"]), value["calibration_wait_s"]))
        names, hues, regions = value["fingers"], value["hues_deg"], value["regions"]
        for what, entries in (("hues_deg", hues), ("regions", regions)):
            if len(entries) not in {1, len(names)}:
                raise VisionError(
                    f"parameter '{what}': expected one entry, or one for each of {names}, found {entries}"
                )
        setups = tuple(
            FingerSetup(name, hues[index % len(hues)] % 360.0, parse_region(regions[index % len(regions)]))
            for index, name in enumerate(names)
        )
        directory = value["profiles_directory"]
        chains = read_chains(Path(directory) if directory else None)
        return Tracker(setups, chains, known, value["profile"], self._options())

    def _options(self) -> TrackerOptions:
        value = self._values
        return TrackerOptions(
            threshold_share=value["threshold_share"],
            placement_stddev_m=value["placement_stddev_m"],
            largest_angle_stddev=value["largest_angle_stddev_rad"],
            reacquire_timeout_s=value["reacquire_timeout_s"],
        )

    def _apply(self, changed: dict[str, Any]) -> None:
        self._values.update(changed)
        self._still.reset()
        self._tracker.set_options(self._options())
        self._configuration = self._tracker.configuration

    def _on_cell_state(self, message: CellState) -> None:
        self._inputs.latch("cell/state", message, lambda: self._use_cell_state(message))

    def _use_cell_state(self, message: CellState) -> None:
        problems = []
        self._still.reset()
        for mounted in message.mounted:
            if mounted.state in {MountedFinger.TO_BE_VERIFIED, MountedFinger.VERIFIED}:
                try:
                    self._tracker.mount(mounted.finger, mounted.profile)
                except VisionError as error:
                    problems.append(f"{mounted.finger}: {error}; not measured until it has a known one")
        self._configuration = self._tracker.configuration
        self._diagnostics.set(
            "profiles", Health.ERROR if problems else Health.OK, "; ".join(problems) or self._tracker.profiles_text
        )

    def _on_compressed(self, message: CompressedImage) -> None:
        data = bytes(message.data)

        def pixels() -> colour.Image:
            self._tracker.calibration.require_size(*image_size(data))
            return decode(data)

        self._on_frame(message, pixels, lambda: thumbnail(data))

    def _on_raw(self, message: Image) -> None:
        def pixels() -> colour.Image:
            return convert.from_image_message(message)

        self._on_frame(message, pixels, lambda: thumbnail_of(pixels()))

    def _on_frame(
        self,
        message: Image | CompressedImage,
        pixels: Callable[[], colour.Image],
        small: Callable[[], colour.Image],
    ) -> None:
        start = time.thread_time()
        self._inputs.drive(message)
        if self._may_skip(seconds(message.header.stamp), small):
            self._skipped += 1
        else:
            self._measure(message.header, pixels)
        self._follower.report(nanoseconds(message.header.stamp))
        self._while_brief.add_turn(time.thread_time() - start)

    def _may_skip(self, stamp_s: float, small: Callable[[], colour.Image]) -> bool:
        """Whether a frame shows what the last measured one showed, not long ago; never while somebody looks at all."""
        if not self._values["rest_period_s"] or self._values["overlay"]:
            return False
        try:
            return self._still.may_skip(small(), stamp_s)
        except VisionError:
            return False  # measuring it says what is wrong

    def _measure(self, header: Header, pixels: Callable[[], colour.Image]) -> None:
        start = time.perf_counter()
        try:
            image = pixels()
            readings = self._tracker.measure(image, seconds(header.stamp))
        except VisionError as error:
            self._diagnostics.set("frames", Health.ERROR, str(error))
            return
        measured = convert.to_states_message(readings, self._configuration, header)
        if measured is not None:
            self._measured.publish(measured)
        for reading in readings:
            self._markers.publish(convert.to_markers_message(reading, self._configuration, header))
        self._frames += 1
        if self._values["overlay"]:
            self._publish_overlay(image, readings, header)
        self._report(readings, seconds(header.stamp), time.perf_counter() - start)

    def _publish_overlay(self, image: colour.Image, readings: Sequence[FingerReading], header: Header) -> None:
        drawn = draw(image, readings)
        frame = CameraFrame(0, drawn.shape[1], drawn.shape[0], image=drawn)
        self._overlay.publish(convert.to_compressed_message(frame, 80, header))

    def _report(self, readings: Sequence[FingerReading], stamp_s: float, duration: float) -> None:
        values = {"frames": self._frames, "the same again": self._skipped, "last_duration_s": f"{duration:.4f}"}
        self._diagnostics.set("frames", Health.OK, "measured", values)
        for reading in readings:
            # each grasp hides markers for a moment: that is said, and is nothing to warn of
            is_lost = self._losses.is_lasting(reading.finger, stamp_s, is_measured=reading.pose is not None)
            health = Health.WARN if is_lost else Health.OK
            hidden = [marker.name for marker in reading.markers if marker.occluded]
            values = {
                "profile": reading.profile,
                "threshold_quality": f"{reading.threshold_quality:.3f}",
                "not_seen": ", ".join(hidden),
                "least_confidence": f"{min(marker.confidence for marker in reading.markers):.2f}",
            }
            self._diagnostics.set(f"finger {reading.finger}", health, reading.problem or "measured", values)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    cv2.setNumThreads(1)
    sys.exit(run(MarkerTrackerNode, args))


if __name__ == "__main__":
    main()
