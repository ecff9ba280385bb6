# SPDX-License-Identifier: Apache-2.0
"""From a bag to what it shows over time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import Transform as TransformMessage
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from softgrip_bag.errors import BagError
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.messages import message_class, stamp_of
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.reader import attachments, bag_digest
from softgrip_bag.scene import Curve, FingerBase, FingerPosture, RecordedScene, SceneEvent, finger_points
from softgrip_interfaces.msg import FingerStates, PredictionResidual, TeleoperationState
from softgrip_model.profile import Profile, ProfileError, load_directory, loads, shipped_directory

_STATE, _PREDICTED, _MEASURED = "/tendon/state", "/finger/predicted", "/finger/measured"
_RESIDUAL, _IMAGE, _HAND = "/finger/residual", "/camera/image_raw/compressed", "/teleoperation/state"
_TRANSFORMS: Final = ("/tf", "/tf_static")
#: A finger's pose is shown this often at most [ns]: nobody sees more.
_POSE_PERIOD_NS: Final = 30_000_000
#: Fingers of a bag without /tf stand side by side, this far apart [m].
_APART_M: Final = 0.04
_SUCCESS: Final = "GRIPPED"
_VERDICTS: Final = ("OK", "WATCH", "RECALIBRATE", "WORN")

Transform = tuple[str, NDArray[np.float64]]


class _SceneReader:
    """Takes messages one by one.

    Args:
        cell: namespace.
        scene: to fill.
        profiles: id -> profile that the bag carries.
        bases: finger -> its base, where the bag has transforms.
    """

    def __init__(
        self, cell: str, scene: RecordedScene, profiles: dict[str, Profile], bases: dict[str, FingerBase]
    ) -> None:
        self._cell, self._scene, self._profiles, self._bases = cell, scene, profiles, bases
        self._curves: dict[tuple[str, str], list[tuple[int, float]]] = defaultdict(list)
        self._verdicts: dict[str, str] = {}
        self._takers: dict[str, Callable[[Any], None]] = {
            _STATE: self._take_state,
            _PREDICTED: lambda message: self._take_fingers("predicted", message),
            _MEASURED: lambda message: self._take_fingers("measured", message),
            _RESIDUAL: self._take_residual,
            _IMAGE: lambda message: scene.images.append((stamp_of(message), bytes(message.data))),
            _HAND: self._take_hand,
        }

    @property
    def topics(self) -> set[str]:
        """What it takes."""
        return {self._cell + topic for topic in self._takers}

    def read_message(self, topic: str, message: Any) -> None:
        """Take a message."""
        self._takers[topic.removeprefix(self._cell)](message)

    def end(self) -> None:
        """Put the curves into the scene."""
        for (path, unit), rows in self._curves.items():
            times_ns, values = np.array([row[0] for row in rows], np.int64), np.array([row[1] for row in rows])
            self._scene.curves.append(Curve(path, unit, times_ns, values))

    def _take_state(self, message: JointState) -> None:
        stamp = stamp_of(message)
        for name, length_m, tension_n in zip(message.name, message.position, message.effort, strict=False):
            self._curves[f"pulled_length/{name}", "mm"].append((stamp, 1e3 * length_m))
            self._curves[f"tension/{name}", "N"].append((stamp, tension_n))

    def _take_fingers(self, source: str, message: FingerStates) -> None:
        stamp = stamp_of(message)
        for finger in message.fingers:
            poses = self._scene.poses.setdefault((source, finger.finger), [])
            profile = self._profiles.get(finger.profile)
            is_due = not poses or stamp - poses[-1].time_ns >= _POSE_PERIOD_NS
            if finger.validity == finger.FAILED or profile is None or not is_due:
                continue
            links_m = profile.finger(finger.finger).link_lengths_m
            if len(links_m) == len(finger.joint_angles):
                tip = (float(finger.tip.x), float(finger.tip.y))
                points = finger_points(self._base(finger.finger), links_m, list(finger.joint_angles), tip)
                if np.isfinite(points).all():
                    poses.append(FingerPosture(stamp, points))

    def _base(self, finger: str) -> FingerBase:
        if finger not in self._bases:
            self._bases[finger] = FingerBase(np.array([0.0, 0.0, _APART_M * len(self._bases)]), np.eye(3))
        return self._bases[finger]

    def _take_residual(self, message: PredictionResidual) -> None:
        stamp = stamp_of(message)
        self._curves[f"tip_error/{message.finger}", "%"].append((stamp, float(message.tip_error_percent)))
        verdict = next((name for name in _VERDICTS if getattr(message, name) == message.verdict), "")
        if verdict and self._verdicts.get(message.finger, "OK") != verdict:
            level = "INFO" if verdict == "OK" else "WARN"
            self._scene.events.append(SceneEvent(stamp, level, f"{message.finger}: {verdict}: {message.reason}"))
        self._verdicts[message.finger] = verdict or self._verdicts.get(message.finger, "OK")

    def _take_hand(self, message: TeleoperationState) -> None:
        stamp = stamp_of(message)
        for name, deflection in zip(message.tendons, message.deflections, strict=False):
            if np.isfinite(deflection):
                self._curves[f"hand_deflection/{name}", "deg"].append((stamp, float(np.degrees(deflection))))


def recorded_scene(path: Path) -> RecordedScene:
    """Return what a bag shows.

    Raises:
        BagError: no bag, or one with nothing to show.
    """
    bag = RecordedBag(path)
    scene = RecordedScene(path.name, bag_digest(path))
    reader = _SceneReader(bag.cell, scene, _profiles(path), _finger_bases(bag))
    topics = reader.topics & set(bag.types)
    if not topics:
        raise BagError(f"{path}: expected one of {', '.join(sorted(reader.topics))}, found none of them")
    for raw in bag.read(topics):
        reader.read_message(raw.topic, deserialize_message(raw.data, message_class(raw.type_name)))
    reader.end()
    _tell_story(path, scene)
    return scene


def _tell_story(path: Path, scene: RecordedScene) -> None:
    """Add modes, grasps, friction models and faults, in order of time."""
    story = digest(path)
    events = [
        SceneEvent(one.time, "INFO", f"{one.mode} {one.product}: {one.reason}".strip(" :")) for one in story.modes
    ]
    events += [
        SceneEvent(
            one.time,
            "INFO" if one.outcome == _SUCCESS else "WARN",
            f"{one.product or 'grasp'}: {one.outcome}: {one.reason}",
        )
        for one in story.grasps
    ]
    events += [SceneEvent(one.time, "INFO", f"friction {one.id}: {one.verdict}") for one in story.fits]
    events += [SceneEvent(one.time, "ERROR", f"{one.name}: {one.text}") for one in story.faults]
    scene.events[:] = sorted([*scene.events, *events], key=lambda one: one.time_ns)


def _profiles(path: Path) -> dict[str, Profile]:
    """Return profiles by id: those that the bag carries, of others the shipped ones."""
    found = dict(load_directory(shipped_directory()))
    for one in attachments(path):
        if one.name.endswith(".yaml") and "/profiles_directory/" in one.name:
            try:
                profile = loads(one.data.decode())
            except (ProfileError, UnicodeDecodeError) as error:
                raise BagError(f"{path}: {one.name}: expected a profile, found none: {error}") from error
            found[profile.id] = profile
    return found


def _finger_bases(bag: RecordedBag) -> dict[str, FingerBase]:
    """Return the base of each finger in the frame that all come from, by what /tf and /tf_static say."""
    parents: dict[str, Transform] = {}
    prefix = f"{bag.cell.strip('/')}/" if bag.cell else ""
    for raw in bag.read(set(_TRANSFORMS) & set(bag.types)):
        for one in deserialize_message(raw.data, message_class(raw.type_name)).transforms:
            child, parent = one.child_frame_id.removeprefix(prefix), one.header.frame_id.removeprefix(prefix)
            parents.setdefault(child, (parent, _matrix(one.transform)))
    bases = {}
    for frame in parents:
        if frame.endswith("_base"):
            pose = _pose(frame, parents)
            bases[frame.removesuffix("_base")] = FingerBase(pose[:3, 3], pose[:3, :3])
    return bases


def _pose(frame: str, parents: dict[str, Transform]) -> NDArray[np.float64]:
    """Return a frame's pose in its root, (4, 4)."""
    pose, seen = np.eye(4), {frame}
    while frame in parents:
        frame, matrix = parents[frame]
        pose = matrix @ pose
        if frame in seen:
            raise BagError(f"/tf: expected a tree, found that {frame} is above itself")
        seen.add(frame)
    return pose


def _matrix(transform: TransformMessage) -> NDArray[np.float64]:
    """Return a geometry_msgs/Transform as (4, 4)."""
    q, t = transform.rotation, transform.translation
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / (np.linalg.norm([q.x, q.y, q.z, q.w]) or 1.0)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = t.x, t.y, t.z
    return matrix
