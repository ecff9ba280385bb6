# SPDX-License-Identifier: Apache-2.0
"""Write a scene as a Rerun recording (https://rerun.io, .rrd) with a layout: camera, fingers, tendons, verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from softgrip_bag.errors import BagError
from softgrip_bag.scene import Curve, RecordedScene

INSTALL: Final = "make rerun-setup, or pip install --no-deps --require-hashes -r requirements-rerun.lock"
TIMELINE: Final = "time"
#: RGB of what a model says and what the camera saw, as in the report's plots.
COLOURS: Final = {"predicted": (68, 119, 170), "measured": (238, 102, 119)}
_LINK_RADIUS_M: Final = 0.003
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG"


def write_rerun(path: Path, scene: RecordedScene) -> None:
    """Write a recording.

    Args:
        path: of a file that is not there yet.
        scene: of one bag.

    Raises:
        BagError: rerun-sdk is not installed, or the file is there.
    """
    try:
        import rerun as rr  # noqa: PLC0415  an extra
    except ImportError as error:
        raise BagError(f"expected rerun-sdk for .rrd files, found none ({error}); install it: {INSTALL}") from error
    if path.exists():
        raise BagError(f"{path}: expected a new file, found that it exists; name another")
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("softgrip", recording_id=scene.identity, send_properties=False)
    stream.save(path, default_blueprint=_layout())
    stream.log("hand", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for curve in scene.curves:
        _send_curve(rr, stream, curve)
    _log_images(rr, stream, scene)
    _log_poses(rr, stream, scene)
    for event in scene.events:
        _set_time(stream, event.time_ns)
        stream.log("verdicts", rr.TextLog(event.text, level=event.level))
    stream.flush()
    stream.disconnect()


def _layout() -> Any:
    """Return the layout: what is seen on the left, what is measured on the right, what is decided below."""
    from rerun import blueprint as rrb  # noqa: PLC0415  an extra

    curves = [
        rrb.TimeSeriesView(origin=f"/{origin}", name=name)
        for origin, name in (
            ("tension", "tensions [N]"),
            ("pulled_length", "pulled lengths [mm]"),
            ("tip_error", "tip errors [% of the finger]"),
            ("hand_deflection", "the person's hand [deg]"),
        )
    ]
    seen = rrb.Vertical(
        rrb.Spatial2DView(origin="/camera", name="camera"), rrb.Spatial3DView(origin="/hand", name="fingers")
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(seen, rrb.Vertical(*curves)),
            rrb.TextLogView(origin="/verdicts", name="verdicts"),
            row_shares=[4, 1],
        ),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _send_curve(rr: Any, stream: Any, curve: Curve) -> None:
    name = f"{curve.path.rpartition('/')[2]} [{curve.unit}]"
    stream.log(curve.path, rr.SeriesLines(names=[name]), static=True)
    times = rr.TimeColumn(TIMELINE, timestamp=curve.times_ns.astype("datetime64[ns]"))
    stream.send_columns(curve.path, [times], rr.Scalars.columns(scalars=curve.values))


def _log_images(rr: Any, stream: Any, scene: RecordedScene) -> None:
    for time_ns, data in scene.images:
        kind = "image/jpeg" if data.startswith(_JPEG) else "image/png" if data.startswith(_PNG) else None
        if kind is not None:
            _set_time(stream, time_ns)
            stream.log("camera", rr.EncodedImage(contents=data, media_type=kind))


def _log_poses(rr: Any, stream: Any, scene: RecordedScene) -> None:
    for (source, finger), poses in scene.poses.items():
        colour = COLOURS[source]
        for pose in poses:
            _set_time(stream, pose.time_ns)
            points = pose.points_m.astype(np.float32)
            stream.log(
                f"hand/{finger}/{source}",
                rr.LineStrips3D([points], colors=[colour], radii=[_LINK_RADIUS_M]),
                rr.Points3D(points, colors=[colour], radii=[1.5 * _LINK_RADIUS_M]),
            )


def _set_time(stream: Any, time_ns: int) -> None:
    stream.set_time(TIMELINE, timestamp=np.datetime64(time_ns, "ns"))
