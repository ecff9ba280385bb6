# SPDX-License-Identifier: Apache-2.0
"""The camera's calibration: lens, and where each finger's plane lies in the image.

The file is OpenCV/ROS camera_info YAML (what ``camera_calibration_parsers`` reads) with one more key, ``softgrip``:

.. code-block:: yaml

    image_width: 1280                  # [px]
    image_height: 720                  # [px]
    camera_name: cell_camera
    camera_matrix: {rows: 3, cols: 3, data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]}         # [px]
    distortion_model: plumb_bob        # or rational_polynomial
    distortion_coefficients: {rows: 1, cols: 5, data: [k1, k2, p1, p2, k3]}
    rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}      # optional
    projection_matrix: {rows: 3, cols: 4, data: [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]}  # optional
    softgrip:
      schema: 1
      date: "2026-11-21T10:15:00Z"     # ISO 8601 UTC
      camera_serial: "CAM-0042"
      reprojection_error_px: 0.12      # [px] RMS of the lens calibration
      views: 18                        # used for the lens
      planes:
        - finger: index                # name of the finger that moves in this plane
          homography: {rows: 3, cols: 3, data: [...]}
          base_marker_m: 0.020         # [m] the base marker's centre lies at x = -base_marker_m, y = 0
          marker_diameter_m: 0.005     # [m] of every marker on this finger
          reprojection_error_px: 0.20  # [px] RMS of the plane's points

A plane's homography takes (x, y, 1) [m] in the finger's base frame (x along the straight finger from the first joint,
closing towards -y) to *undistorted* pixels (camera_matrix applied, no distortion). Pixel (0, 0) is the centre of the
top left pixel. Fingers seen from behind simply have a homography of the other handedness.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from softgrip_model.digest import text_digest
from softgrip_model.durable import write_durably
from softgrip_vision import _core
from softgrip_vision.errors import CalibrationError

SCHEMA = 1
DISTORTION_LENGTHS = {"plumb_bob": (4, 5), "rational_polynomial": (8,)}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """Pinhole camera with lens distortion.

    Attributes:
        width, height: [px] of the images it was calibrated for.
        matrix: (3, 3) camera matrix [px].
        distortion: (4,), (5,) or (8,) OpenCV coefficients.
        name: of the camera.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    name: str = "camera"

    @property
    def distortion_model(self) -> str:
        """ROS name of the distortion model."""
        return "rational_polynomial" if len(self.distortion) == 8 else "plumb_bob"

    @cached_property
    def core(self) -> _core.Lens:
        """The compiled lens."""
        return _core.Lens(self.matrix, self.distortion)

    def undistort(self, pixels: Array) -> Array:
        """Return (n, 2) undistorted pixels of (n, 2) pixels."""
        return self.core.undistort(pixels)

    def distort(self, undistorted: Array) -> Array:
        """Return (n, 2) pixels as the lens shows (n, 2) undistorted pixels."""
        return self.core.distort(undistorted)


@dataclass(frozen=True)
class FingerPlane:
    """The plane one finger moves in.

    Attributes:
        finger: its name.
        homography: (3, 3), metres in the finger's base frame to undistorted pixels.
        base_marker_m: [m] distance of the base marker behind the first joint.
        marker_diameter_m: [m].
        reprojection_error_px: [px] RMS of the points it was found from; NaN when unknown.
    """

    finger: str
    homography: Array
    base_marker_m: float
    marker_diameter_m: float
    reprojection_error_px: float = math.nan


@dataclass(frozen=True)
class CameraCalibration:
    """A lens and the planes of the fingers it sees.

    Attributes:
        lens: the camera.
        planes: one per finger.
        date: ISO 8601.
        camera_serial: of the camera that was calibrated.
        reprojection_error_px: [px] RMS of the lens calibration.
        views: number of views the lens was found from.
        digest: of the file's content; empty for a calibration that was not read from a file.
    """

    lens: Lens
    planes: tuple[FingerPlane, ...]
    date: str
    camera_serial: str
    reprojection_error_px: float
    views: int
    digest: str = ""

    def plane(self, finger: str) -> FingerPlane:
        """Return the plane of a finger.

        Raises:
            CalibrationError: when the file has none for it.
        """
        for plane in self.planes:
            if plane.finger == finger:
                return plane
        known = ", ".join(plane.finger for plane in self.planes) or "none"
        raise CalibrationError(
            f"calibration: expected a plane for finger '{finger}', found: {known}; run calibrate_camera plane"
        )

    def require_size(self, width: int, height: int) -> None:
        """Raise CalibrationError when an image is not of the size this calibration is for."""
        if (width, height) != (self.lens.width, self.lens.height):
            raise CalibrationError(
                f"calibration: expected images of {self.lens.width}x{self.lens.height}, found {width}x{height}; "
                "set the camera to the calibrated resolution or calibrate at this one"
            )


class PlaneMap:
    """Between a finger's plane [m] and the image [px], through homography and lens."""

    def __init__(self, lens: Lens, plane: FingerPlane) -> None:
        self._core = _core.PlaneMap(lens.core, plane.homography)

    def to_pixels(self, points: Array) -> Array:
        """Return (n, 2) pixels of (n, 2) plane points [m]."""
        return self._core.to_pixels(points)

    def to_pixel(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the pixel of one plane point [m]."""
        return self._core.to_pixel(point)

    def to_plane(self, pixels: Array) -> Array:
        """Return (n, 2) plane points [m] of (n, 2) pixels."""
        return self._core.to_plane(pixels)

    def to_plane_with_jacobian(self, pixels: Array) -> tuple[Array, Array]:
        """Return (n, 2) plane points [m] and (n, 2, 2) their derivatives by the pixels [m/px]."""
        return self._core.to_plane_with_jacobian(pixels)

    def pixels_per_metre(self, point: Array) -> float:
        """Return the geometric mean scale [px/m] at a plane point (2,) [m]."""
        step = 1e-4
        corner, right, up = self.to_pixels(point + np.array([[0.0, 0.0], [step, 0.0], [0.0, step]]))
        return math.sqrt(abs(float(np.linalg.det(np.stack([right - corner, up - corner]))))) / step


def load(path: Path | str) -> CameraCalibration:
    """Read and check a calibration file.

    Raises:
        CalibrationError: when it cannot be read or does not make sense.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        document = yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CalibrationError(f"{path}: expected a camera calibration (YAML), found: {error}") from error
    if not isinstance(document, dict):
        raise CalibrationError(f"{path}: expected a camera calibration (YAML mapping), found {type(document).__name__}")
    try:
        return _parse(document, text_digest(text))
    except (CalibrationError, KeyError, TypeError, ValueError) as error:
        missing = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise CalibrationError(f"{path}: {missing}; see softgrip_vision/calibration.py for the layout") from error


def lens_from_camera_info(
    size: tuple[int, int], distortion_model: str, matrix: ArrayLike, distortion: Sequence[float], name: str
) -> Lens:
    """Return the lens that a sensor_msgs/CameraInfo describes.

    Args:
        size: width and height [px].
        distortion_model: ROS name.
        matrix: K, row by row (9,).
        distortion: D.
        name: of the camera.

    Raises:
        CalibrationError: the numbers describe no lens.
    """
    return _parse_lens({
        "image_width": size[0],
        "image_height": size[1],
        "camera_matrix": {"data": matrix},
        "distortion_model": distortion_model,
        "distortion_coefficients": {"data": distortion},
        "camera_name": name,
    })  # fmt: skip


def _parse(document: Mapping[str, Any], digest: str) -> CameraCalibration:
    extra = document["softgrip"]
    if extra.get("schema") != SCHEMA:
        raise CalibrationError(f"expected softgrip.schema {SCHEMA}, found {extra.get('schema')!r}")
    planes = tuple(_parse_plane(entry) for entry in extra.get("planes", []))
    names = [plane.finger for plane in planes]
    if len(set(names)) != len(names):
        raise CalibrationError(f"expected one plane per finger, found {names}")
    return CameraCalibration(
        lens=_parse_lens(document),
        planes=planes,
        date=str(extra["date"]),
        camera_serial=str(extra["camera_serial"]),
        reprojection_error_px=float(extra["reprojection_error_px"]),
        views=int(extra["views"]),
        digest=digest,
    )


def _parse_lens(document: Mapping[str, Any]) -> Lens:
    width, height = int(document["image_width"]), int(document["image_height"])
    matrix = _matrix(document["camera_matrix"], "camera_matrix", (3, 3))
    model = document["distortion_model"]
    if model not in DISTORTION_LENGTHS:
        raise CalibrationError(f"expected distortion_model {' or '.join(DISTORTION_LENGTHS)}, found {model!r}")
    distortion = _numbers(document["distortion_coefficients"]["data"], "distortion_coefficients")
    if len(distortion) not in DISTORTION_LENGTHS[model]:
        raise CalibrationError(
            f"expected {DISTORTION_LENGTHS[model]} distortion_coefficients for {model}, found {len(distortion)}"
        )
    inside = 0 < matrix[0, 2] < width and 0 < matrix[1, 2] < height
    if width <= 0 or height <= 0 or matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not inside:
        raise CalibrationError(
            f"expected positive focal lengths and a principal point inside {width}x{height}, found {matrix.tolist()}"
        )
    return Lens(width, height, matrix, distortion, str(document.get("camera_name", "camera")))


def _parse_plane(entry: Mapping[str, Any]) -> FingerPlane:
    finger = str(entry["finger"])
    homography = _matrix(entry["homography"], f"homography of '{finger}'", (3, 3))
    if abs(np.linalg.det(homography)) < 1e-12 * np.linalg.norm(homography) ** 3:
        raise CalibrationError(f"expected an invertible homography of '{finger}', found {homography.tolist()}")
    base, diameter = float(entry["base_marker_m"]), float(entry["marker_diameter_m"])
    if not (0 < base < 1 and 0 < diameter < 0.1):
        raise CalibrationError(
            f"plane of '{finger}': expected base_marker_m in 0..1 m and marker_diameter_m in 0..0.1 m, "
            f"found {base} and {diameter}"
        )
    return FingerPlane(finger, homography, base, diameter, float(entry.get("reprojection_error_px", math.nan)))


def _numbers(data: Any, what: str) -> Array:
    values = np.array([float(value) for value in data])
    if not np.isfinite(values).all():
        raise CalibrationError(f"expected finite numbers in {what}, found {values.tolist()}")
    return values


def _matrix(entry: Mapping[str, object], what: str, shape: tuple[int, int]) -> Array:
    values = _numbers(entry["data"], what)
    if values.size != shape[0] * shape[1]:
        raise CalibrationError(f"expected {shape[0]}x{shape[1]} numbers in {what}, found {values.size}")
    return values.reshape(shape)


def save(calibration: CameraCalibration, path: Path | str) -> None:
    """Write a calibration file (replaced in one step, so that a reader never sees half of it)."""
    path = Path(path)
    lens = calibration.lens
    projection = np.hstack([lens.matrix, np.zeros((3, 1))])
    document = {
        "image_width": lens.width,
        "image_height": lens.height,
        "camera_name": lens.name,
        "camera_matrix": _entry(lens.matrix),
        "distortion_model": lens.distortion_model,
        "distortion_coefficients": _entry(lens.distortion[None, :]),
        "rectification_matrix": _entry(np.eye(3)),
        "projection_matrix": _entry(projection),
        "softgrip": {
            "schema": SCHEMA,
            "date": calibration.date,
            "camera_serial": calibration.camera_serial,
            "reprojection_error_px": float(calibration.reprojection_error_px),
            "views": int(calibration.views),
            "planes": [
                {
                    "finger": plane.finger,
                    "homography": _entry(plane.homography),
                    "base_marker_m": float(plane.base_marker_m),
                    "marker_diameter_m": float(plane.marker_diameter_m),
                    "reprojection_error_px": float(plane.reprojection_error_px),
                }
                for plane in calibration.planes
            ],
        },
    }
    write_durably(path, yaml.safe_dump(document, sort_keys=False).encode())


def _entry(matrix: Array) -> dict[str, object]:
    rows, cols = matrix.shape
    return {"rows": rows, "cols": cols, "data": [float(value) for value in matrix.ravel()]}


#: [s] between two looks whether a file is there
_LOOK_PERIOD_S = 0.05


def file_when_there(path: Path, deadline: float) -> Path:
    """Return the path once a file is there.

    Args:
        path: of the file.
        deadline: [s] to wait at most.

    Raises:
        CalibrationError: when it did not appear.
    """
    clock = threading.Event()
    end = time.monotonic() + deadline
    while not path.is_file():
        if time.monotonic() >= end:
            raise CalibrationError(
                f"{path}: expected a file there within {deadline:g} s, found none; run calibrate_camera"
            )
        clock.wait(_LOOK_PERIOD_S)
    return path
