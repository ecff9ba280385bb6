# SPDX-License-Identifier: Apache-2.0
"""Shows the mounted fingers as the mesh predicts them, from their pulled tendon lengths.

Subscribes tendon/state, cell/state and friction/active; publishes shape/predicted and shape/marker, from the
subscription callback of tendon/state only. Each shape is a function of its own pulled length, the mounted profile and
the active friction model (the profile's own until there is one) alone, and states are taken by their stamps (the first
in every period of the rate), so that a bag replays to the same bits on the same machine. A state that comes while
another is being solved waits alone: older ones are dropped, never shown late. The rate in the message is that of the
stamps solved; when it is below the rate asked for, the reason says so. Where shapes come too slowly to look at, the
coarse mesh serves for a while: the message then has its hexahedra, its digest and the reason. From the first tendon
state on, a thread of its own computes what shapes start from before they need it: for the mounted fingers, then for
other profiles. A new friction model or a swap back to a finger keeps meshes and factored matrices.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker

from softgrip_interfaces.msg import CellState, FrictionModel, PredictedShape
from softgrip_model.finger import FingerError
from softgrip_model.friction.errors import FrictionError
from softgrip_model.gdfe.closing import AT_REST, ClosingSettings
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.session import ShapeSession
from softgrip_model.nodes import convert
from softgrip_model.profile import ProfileError, load_profiles, mounting_of
from softgrip_nodekit import (
    LATCHED,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    StampedInputs,
    lateness_parameter,
    nanoseconds,
    run,
    startup_errors,
)
from softgrip_time.units import to_s

_SETTINGS = ClosingSettings()

PARAMETERS = ParameterTable(
    Parameter("profiles_directory", "", "folder of finger profiles; empty = those of softgrip_bringup"),
    Parameter("fingers", ["index"], "slots whose finger is shown"),
    Parameter("profiles", ["power"], "profile in each of these slots, or one for all, until cell/state says otherwise"),
    Parameter("frame_prefix", "", "before every frame: that of hand_description"),
    Parameter("rate_hz", 35.0, "shapes at most, by the stamps of tendon/state; some are missed", "Hz", 0.5, 200.0),
    Parameter("marker_rate_hz", 1.0, "of shape/marker at most; 0 = none", "Hz", 0.0, 60.0),
    Parameter(
        "resolution", "fine", "mesh: coarse is about 430 hexahedra, fine about 2,100", "", choices=tuple(RESOLUTIONS)
    ),
    Parameter("tolerance", _SETTINGS.tolerance, "out-of-balance force relative to reactions", "", 1e-8, 1e-2),
    lateness_parameter(0.2),
    Parameter("travel_m", 1e-3 * _SETTINGS.travel_mm, "longest pulled length shown", "m", 0.001, 0.1),
)

#: Only the newest state waits.
_NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)


class GdfeSimulator(CellNode):
    """Translates between topics and a `ShapeSession`."""

    def __init__(self) -> None:
        super().__init__("gdfe_simulator")
        values = PARAMETERS.declare(self)
        self._session = self._start(values)
        self._diagnostics = Diagnostics(self)
        self._inputs = StampedInputs(self, "tendon/state", values["allowed_lateness_s"], self._diagnostics)
        self._frame_prefix: str = values["frame_prefix"]
        self._shapes = self.create_publisher(PredictedShape, "shape/predicted", SENSOR)
        self._markers = self.create_publisher(Marker, "shape/marker", SENSOR)
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.create_subscription(FrictionModel, "friction/active", self._on_friction, LATCHED)
        self.create_subscription(JointState, "tendon/state", self._on_tendons, _NEWEST)
        self._report("profile", Health.OK, "as given by parameters", self._session.mounted)
        self._report("friction", Health.OK, "the profiles' own")
        self.get_logger().info(f"simulating {self._session.mounted}: {self._session.description}")

    @staticmethod
    def _start(values: dict[str, Any]) -> ShapeSession:
        settings = ClosingSettings(
            resolution=RESOLUTIONS[values["resolution"]],
            travel_mm=1e3 * values["travel_m"],
            tolerance=values["tolerance"],
        )
        with startup_errors(GdfeError, FingerError, ProfileError):
            return ShapeSession(
                load_profiles(values["profiles_directory"]),
                mounting_of(values["fingers"], values["profiles"]),
                settings,
                rate_hz=values["rate_hz"],
                marker_rate_hz=values["marker_rate_hz"],
                prefetch=True,
            )

    def close(self) -> None:
        """End the worker of the keyframes."""
        self._session.close()

    def _on_tendons(self, message: JointState) -> None:
        self._inputs.drive(message)
        try:
            names, samples = convert.tendon_samples(message)
        except FingerError as error:
            self._report("tendons", Health.WARN, str(error))
            return
        for shown in self._session.on_tendons(names, samples):
            self._shapes.publish(convert.shape_message(message.header.stamp, shown, self._frame_prefix))
            if shown.marker_due:
                self._markers.publish(convert.marker_message(message.header.stamp, shown, self._frame_prefix))
            health = Health.OK if shown.reason in {"", AT_REST} else Health.WARN
            text = shown.reason or f"{shown.hexahedra} hexahedra at {shown.rate_hz:.0f} Hz"
            behind = to_s(self.get_clock().now().nanoseconds - nanoseconds(message.header.stamp))
            values = {"solve_time_s": f"{shown.shape.solve_time:.4f}", "behind_state_s": f"{behind:.3f}"}
            self._report(f"finger {shown.finger}", health, text, values)

    def _on_friction(self, message: FrictionModel) -> None:
        self._inputs.latch("friction/active", message, lambda: self._use_friction(message))

    def _use_friction(self, message: FrictionModel) -> None:
        try:
            self._session.set_friction(convert.active_friction(message))
        except (GdfeError, FingerError, FrictionError) as error:
            kept = self._session.friction_id or "the profiles' own"
            self._report("friction", Health.WARN, f"{error}; still using {kept}")
            return
        self._report("friction", Health.OK, f"using {self._session.friction_id}")
        self.get_logger().info(f"friction model {self._session.friction_id}")

    def _on_cell(self, message: CellState) -> None:
        self._inputs.latch("cell/state", message, lambda: self._use_cell(message))

    def _use_cell(self, message: CellState) -> None:
        try:
            self._session.set_mounted(convert.mounted_profiles(message))
        except (GdfeError, FingerError, ProfileError) as error:
            self._report("profile", Health.WARN, f"{error}; still showing {self._session.mounted}")
            return
        self._report("profile", Health.OK, "as mounted by cell/state", self._session.mounted)

    def _report(self, component: str, health: Health, text: str, values: dict[str, str] | None = None) -> None:
        self._diagnostics.set(component, health, text, values)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run(GdfeSimulator, args))


if __name__ == "__main__":
    main()
