# SPDX-License-Identifier: Apache-2.0
"""What a node of the suite has beside rclpy's: `CellNode`, and `HardwareNode` for those that own devices."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node


class CellNode(Node):
    """A node that `run` starts and stops.

    Attributes:
        device_paths: files of the devices that its parameters name; set by `ParameterTable.declare`.
        former_parameters: earlier names of its parameters, which are still read; likewise.
    """

    device_paths: Sequence[str] = ()
    former_parameters: Sequence[str] = ()

    def close(self) -> None:
        """Leave hardware safe and let go of what is open; called on every exit path, before the node is destroyed."""


class HardwareNode(LifecycleNode, CellNode):
    """A node with a lifecycle that owns devices: configured = connected, active = may move.

    A subclass says in `disconnect` how its hardware is left safe, from any state.

    Attributes:
        startup_problem: why a transition failed; `run` says so where the node cannot be brought up.
    """

    startup_problem: str = ""

    def disconnect(self) -> None:
        """Leave the hardware safe and let go of it; nothing where nothing is connected."""
        raise NotImplementedError

    def fail(self, problem: str) -> TransitionCallbackReturn:
        """Log why a transition does not succeed, and return that it did not."""
        self.startup_problem = problem
        self.get_logger().error(problem)
        return TransitionCallbackReturn.FAILURE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disconnect."""
        self.disconnect()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the hardware safe, from any state."""
        self.disconnect()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the hardware safe; configure again afterwards."""
        del state
        self.disconnect()
        return TransitionCallbackReturn.SUCCESS
