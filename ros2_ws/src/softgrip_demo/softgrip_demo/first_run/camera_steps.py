# SPDX-License-Identifier: Apache-2.0
"""Steps on the camera, before any node runs: exposure, focus, markers of the straight finger, and its plane."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.figures import Figure, at_least, at_most, equal_to
from softgrip_description.cell_file import CellCamera
from softgrip_time import Clock, WallClock
from softgrip_time.units import to_s
from softgrip_vision import calibration
from softgrip_vision.calibrating.plane import LARGEST_RMS
from softgrip_vision.calibration import CameraCalibration, FingerPlane, PlaneMap
from softgrip_vision.colour import ColourModel, Image
from softgrip_vision.frame import FrameSource
from softgrip_vision.layout import ChainLayout, read_chains
from softgrip_vision.sources import open_source
from softgrip_vision.sources.opening import SourceOptions, dereference
from softgrip_vision.v4l2_controls import ControlSettings

Array = NDArray[np.float64]

#: [s] for a frame: somebody waits, and a computer that has just been set up may be busy
FRAME_TIMEOUT_S = 10.0
#: frames that are looked at
FRAMES = 8
#: frames from before the check that are passed over: more than the buffers of driver and network hold
MAX_STALE_FRAMES = 40
#: [grey levels] that the brightest hundredth of a picture has at least, unless no light comes in
MIN_PICTURE_LEVEL = 30.0
#: [grey levels] of green above the other colours that a marker must show, and share of its disc that may be saturated:
#: a clipped edge moves the centre
MIN_SIGNAL, MAX_CLIPPED_SHARE, CLIPPED_AT = 40.0, 0.05, 250
#: relative scatter of the markers' brightness from frame to frame: more is flicker, or a camera that chooses for itself
MAX_FLICKER = 0.03
#: width of a marker's edge (10 to 90 %) as a share of its diameter: beyond, no point of the disc shows its own colour
MAX_EDGE_SHARE = 0.35
#: [m] by which a marker may be beside its place on the straight finger, and a link's length beside the profile's
MAX_MARKER_OFFSET_M, MAX_LINK_ERROR_M = 0.006, 0.001
#: share of a marker's peak signal at which its disc ends
_HALF = 0.5
_RAYS = 24
UNSEEN_REMEDY = (
    "keep the lens free (cap, hand, cable) and the whole finger in sight while the check runs; a light that flickers "
    "hides markers, too"
)
FOCUS_REMEDY = "turn the focus ring, or set `focus` of the camera in the cell file, until the markers' edges are sharp"


@dataclass(frozen=True)
class SeenMarker:
    """One marker in one frame.

    Attributes:
        pixel: (2,) [px] centre.
        signal: [grey levels] of its middle above the surroundings.
        edge_px: [px] width of its edge, 10 to 90 %.
        clipped_share: of its disc.
    """

    pixel: Array
    signal: float
    edge_px: float
    clipped_share: float


@dataclass
class BenchCamera:
    """What the steps on the camera share.

    Attributes:
        camera: of the cell file.
        finger: in front of it.
        profile: mounted.
        profiles: folder, None = the shipped ones.
        colour: of the markers.
        clock: of the frames' stamps; None = the computer's.
    """

    camera: CellCamera
    finger: str = "index"
    profile: str = "power"
    profiles: Path | None = None
    colour: ColourModel = field(default_factory=lambda: ColourModel(120.0))
    clock: Clock | None = None

    @cached_property
    def frames(self) -> Sequence[Image]:
        """Some frames, all taken since they were asked for; raises VisionError or FirstRunError."""
        camera = self.camera
        controls = ControlSettings(
            camera.exposure_s or 0.0,
            -1 if camera.gain is None else camera.gain,
            -1 if camera.focus is None else camera.focus,
            camera.white_balance_k or 0,
            -1 if camera.power_line_hz is None else camera.power_line_hz,
        )
        size = (camera.width or 0, camera.height or 0, camera.fps or 0.0)
        options = SourceOptions(*size, timeout=FRAME_TIMEOUT_S, controls=controls)
        name = dereference(camera.source) if camera.source.startswith("@") else camera.source
        if name is None:
            raise FirstRunError(f"camera: expected the name of a camera in {camera.source}, found none; is it running?")
        began_ns = self._now_ns()
        source = open_source(name, options, began_ns)
        try:
            found = list(_frames_since(source, began_ns, name))
        finally:
            source.close()
        if not found:
            raise FirstRunError(f"camera {name}: expected frames, found none; check its cable and the group video")
        return found

    def _now_ns(self) -> int:
        """Return the time since the epoch [ns]."""
        clock = self.clock or WallClock()
        clock.wait(clock.now_s())  # an emulated cell's clock knows its time from its last wait
        return clock.epoch_ns(clock.now_s())

    @cached_property
    def known(self) -> CameraCalibration:
        """The calibration; raises VisionError or FirstRunError."""
        if self.camera.calibration is None:
            raise FirstRunError(
                "camera: expected a calibration in the cell file, found none; make one with "
                "`ros2 run softgrip_vision calibrate_camera` (docs/bench.md, section 7)"
            )
        return calibration.load(self.camera.calibration)

    @cached_property
    def plane(self) -> FingerPlane:
        """The plane of the finger in front of the camera."""
        for plane in self.known.planes:
            if plane.finger == self.finger:
                return plane
        raise FirstRunError(
            f"camera: expected the plane of '{self.finger}', found {[one.finger for one in self.known.planes]}; run "
            f"`ros2 run softgrip_vision calibrate_camera plane ... --finger {self.finger}`"
        )

    @cached_property
    def plane_map(self) -> PlaneMap:
        """Between that plane and the image."""
        return PlaneMap(self.known.lens, self.plane)

    @cached_property
    def layout(self) -> ChainLayout:
        """The markers of the finger."""
        return read_chains(self.profiles)[self.profile][self.finger]

    @cached_property
    def places_m(self) -> Array:
        """(n, 2) [m] where the markers of the straight finger are."""
        along = np.cumsum([0.0, *self.layout.link_lengths_m])
        x = np.array([-self.plane.base_marker_m, *along])
        return np.column_stack([x, np.zeros_like(x)])

    def diameter_px(self, place: Array) -> float:
        """Return the diameter [px] of a marker at a place (2,) [m]."""
        return self.plane.marker_diameter_m * self.plane_map.pixels_per_metre(place)

    def look_for_marker(self, image: Image, place: Array) -> SeenMarker | None:
        """Return the marker at a place (2,) [m], None where nothing near it has its colour."""
        diameter = self.diameter_px(place)
        half = diameter + MAX_MARKER_OFFSET_M / self.plane.marker_diameter_m * diameter
        (centre,) = self.plane_map.to_pixels(place[None])
        left, top = (max(0, math.floor(value - half)) for value in centre)
        right, bottom = (math.ceil(value + half) + 1 for value in centre)
        window = np.ascontiguousarray(image[top:bottom, left:right])
        if min(window.shape[:2]) < diameter:
            return None
        signal = np.asarray(self.colour.signal(window), dtype=np.float64)
        surroundings = float(np.median(signal))
        v, u = np.unravel_index(int(np.argmax(_smoothed(signal, diameter))), signal.shape)
        peak = float(np.median(signal[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2])) - surroundings
        if peak < 0.5 * MIN_SIGNAL:
            return None
        rows, columns = np.indices(signal.shape)
        near = np.hypot(columns - u, rows - v) <= diameter
        disc = near & (signal - surroundings > _HALF * peak)
        weights = np.clip(signal - surroundings, 0.0, None) * disc
        middle = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
        return SeenMarker(
            middle + np.array([left, top]),
            peak,
            _edge_width(signal - surroundings, middle, peak, diameter),
            float((window[disc].max(axis=1) >= CLIPPED_AT).mean()),
        )

    @cached_property
    def seen(self) -> Sequence[Sequence[SeenMarker | None]]:
        """The markers in each frame, base to tip."""
        return [[self.look_for_marker(image, place) for place in self.places_m] for image in self.frames]

    def of_first(self) -> list[SeenMarker]:
        """Return the markers of the first frame; raises FirstRunError where there is none at all."""
        found = [one for one in self.seen[0] if one is not None]
        level = float(np.percentile(self.frames[0].max(axis=2), 99))
        if not found and level < MIN_PICTURE_LEVEL:
            raise FirstRunError(
                f"camera: expected a picture, found a dark one (its brightest hundredth has {level:.0f} of 255 grey "
                "levels); take the cap off the lens, put the light on, or set a longer exposure_s"
            )
        if not found:
            raise FirstRunError(
                f"camera: expected green markers on the straight '{self.finger}', found none; is the finger in sight "
                "and straight, the light on, the lens free, the calibration that of this camera?"
            )
        return found


def _frames_since(source: FrameSource, began_ns: int, name: str) -> Iterator[Image]:
    """Yield frames that were taken since a time [ns]: buffers, and servers that repeat their last one, have older ones.

    Raises:
        FirstRunError: all are older.
    """
    taken = stale = 0
    while taken < FRAMES and (frame := source.read()) is not None:
        if frame.stamp_ns >= began_ns:
            taken += 1
            yield frame.pixels()
            continue
        stale += 1
        if stale == MAX_STALE_FRAMES:
            raise FirstRunError(
                f"camera {name}: expected frames taken since the check began, found {stale} that say they are "
                f"{to_s(began_ns - frame.stamp_ns):.1f} s older; set the camera's clock by the computer's (NTP), or "
                "switch the camera off and on"
            )


def _smoothed(signal: Array, diameter: float) -> Array:
    """Return the signal averaged over half a marker: a single bright pixel is none."""
    size = max(1, round(0.5 * diameter))
    kernel = np.ones(size) / size
    rows = np.apply_along_axis(np.convolve, 1, signal, kernel, "same")
    return np.asarray(np.apply_along_axis(np.convolve, 0, rows, kernel, "same"))


def _edge_width(signal: Array, middle: Array, peak: float, diameter: float) -> float:
    """Return the width [px] over which the mean radial profile falls from 90 to 10 % of its middle."""
    radii = np.arange(0.0, 1.2 * diameter, 0.25)
    angles = np.arange(_RAYS) * 2.0 * math.pi / _RAYS
    u = middle[0] + radii[:, None] * np.cos(angles)
    v = middle[1] + radii[:, None] * np.sin(angles)
    inside = (u >= 0) & (v >= 0) & (u < signal.shape[1] - 1) & (v < signal.shape[0] - 1)
    i, j = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    fv, fu = v - i, u - j
    values = (
        signal[i, j] * (1 - fv) * (1 - fu)
        + signal[i, j + 1] * (1 - fv) * fu
        + signal[i + 1, j] * fv * (1 - fu)
        + signal[i + 1, j + 1] * fv * fu
    )
    profile = np.median(np.where(inside, values, 0.0), axis=1) / peak
    high = radii[np.argmax(profile < 0.9)]
    below = profile < 0.1
    low = radii[np.argmax(below)] if below.any() else radii[-1]
    return float(max(0.0, low - high))


@dataclass(frozen=True)
class ExposureStep:
    """The markers are bright enough, not clipped, and do not flicker."""

    bench: BenchCamera
    key = "exposure"
    title = "Camera: exposure"
    needs = ("camera",)

    def measure(self) -> Iterator[Figure]:
        """Yield signal, clipping and flicker of the markers."""
        markers = self.bench.of_first()
        signal = float(np.median([one.signal for one in markers]))
        yield at_least("green of the markers", signal, MIN_SIGNAL, "grey levels", "more light, or a longer exposure_s")
        clipped = max(one.clipped_share for one in markers)
        yield at_most(
            "clipped share of a marker", clipped, MAX_CLIPPED_SHARE, "", "less light, or a shorter exposure_s"
        )
        frames = [[one.signal for one in frame if one is not None] for frame in self.bench.seen]
        levels = [np.mean(signals) for signals in frames if signals]
        if len(levels) < len(frames):
            yield equal_to("frames that show a marker", len(levels), len(frames), UNSEEN_REMEDY)
            return
        flicker = float(np.std(levels) / np.mean(levels))
        remedy = "set exposure_s, gain and white_balance_k, so that the camera chooses nothing, and power_line_hz"
        yield at_most("change from frame to frame", flicker, MAX_FLICKER, "", remedy)


@dataclass(frozen=True)
class FocusStep:
    """The markers' edges are sharp."""

    bench: BenchCamera
    key = "focus"
    title = "Camera: focus"
    needs = ("camera",)

    def measure(self) -> Iterator[Figure]:
        """Yield the width of the markers' edges as a share of their diameter."""
        markers = self.bench.of_first()
        diameter = float(np.mean([self.bench.diameter_px(place) for place in self.bench.places_m]))
        share = float(np.median([one.edge_px for one in markers])) / diameter
        yield at_most("edge of a marker over its diameter", share, MAX_EDGE_SHARE, "", FOCUS_REMEDY)


@dataclass(frozen=True)
class MarkersStep:
    """Every marker of the straight finger is in its place."""

    bench: BenchCamera
    key = "markers"
    title = "Camera: markers"
    needs = ("camera",)

    def measure(self) -> Iterator[Figure]:
        """Yield a figure for each marker."""
        names, places = self.bench.layout.marker_names, self.bench.places_m
        for name, place, seen in zip(names, places, self.bench.seen[0], strict=True):
            where = f"{self.bench.finger} {name}"
            remedy = (
                f"glue a green marker of {self.bench.plane.marker_diameter_m * 1e3:g} mm there, or free the view of it"
            )
            if seen is None:
                yield equal_to(where, "no marker", "a marker", remedy)
                continue
            (point,) = self.bench.plane_map.to_plane(seen.pixel[None])
            offset = float(np.hypot(*(point - place))) * 1e3
            straight = f"{remedy}; is the finger straight, its profile {self.bench.profile}?"
            yield at_most(f"{where}: beside its place", offset, MAX_MARKER_OFFSET_M * 1e3, "mm", straight)


@dataclass(frozen=True)
class PlaneStep:
    """The plane was calibrated well, and links measure in it what the profile says."""

    bench: BenchCamera
    key = "plane"
    title = "Camera: plane"
    needs = ("camera",)

    def measure(self) -> Iterator[Figure]:
        """Yield the calibration's residual and the lengths of the links."""
        bench = self.bench
        remedy = "calibrate the plane again: `ros2 run softgrip_vision calibrate_camera plane`"
        yield at_most("residual of the plane", bench.plane.reprojection_error_px, LARGEST_RMS, "px", remedy)
        seen = [one for one in bench.seen[0] if one is not None]
        if len(seen) < len(bench.places_m):
            raise FirstRunError("expected every marker, found some missing; see the step before")
        points = bench.plane_map.to_plane(np.array([one.pixel for one in seen]))[1:]
        for number, ((a, b), length) in enumerate(zip(pairwise(points), bench.layout.link_lengths_m, strict=True)):
            error = abs(float(np.hypot(*(b - a))) - length) * 1e3
            yield at_most(f"link {number}: length beside the profile's", error, MAX_LINK_ERROR_M * 1e3, "mm", remedy)
