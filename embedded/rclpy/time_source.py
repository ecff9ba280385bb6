# SPDX-License-Identifier: Apache-2.0
"""Drives the ROS clocks of a node from /clock while its parameter use_sim_time is true."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

from rclpy.clock import ROSClock
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time

if TYPE_CHECKING:
    from rclpy.clock import Clock
    from rclpy.node import Node

CLOCK_TOPIC = "/clock"
USE_SIM_TIME_NAME = "use_sim_time"


class TimeSource:
    """Belongs to a node."""

    def __init__(self, *, node: Node | None = None) -> None:
        self._clock_sub: Any = None
        self._node_weak_ref: weakref.ref[Node] | None = None
        self._associated_clocks: set[ROSClock] = set()
        self._last_time_set = Time(clock_type=ROSClock().clock_type)
        self._ros_time_is_active = False
        if node is not None:
            self.attach_node(node)

    @property
    def ros_time_is_active(self) -> bool:
        """Whether /clock drives the clocks."""
        return self._ros_time_is_active

    @ros_time_is_active.setter
    def ros_time_is_active(self, enabled: bool) -> None:
        if self._ros_time_is_active == enabled:
            return
        self._ros_time_is_active = enabled
        for clock in self._associated_clocks:
            clock._set_ros_time_is_active(enabled)
        if enabled:
            self._subscribe_to_clock_topic()
        elif self._clock_sub is not None and (node := self._get_node()) is not None:
            node.destroy_subscription(self._clock_sub)
            self._clock_sub = None

    def _get_node(self) -> Node | None:
        return self._node_weak_ref() if self._node_weak_ref is not None else None

    def _subscribe_to_clock_topic(self) -> None:
        node = self._get_node()
        if self._clock_sub is None and node is not None:
            from rosgraph_msgs.msg import Clock  # noqa: PLC0415  only nodes on simulated time need it

            qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._clock_sub = node.create_subscription(Clock, CLOCK_TOPIC, self.clock_callback, qos)
            # As rclcpp's thread for the clock: the executor is woken for timers that are due, not for each tick.
            self._clock_sub._run_on_arrival()

    def attach_node(self, node: Node) -> None:
        """Follow the parameter use_sim_time of a node; declare it when it is not."""
        self._node_weak_ref = weakref.ref(node)
        if not node.has_parameter(USE_SIM_TIME_NAME):
            node.declare_parameter(USE_SIM_TIME_NAME, value=False)
        value = node.get_parameter(USE_SIM_TIME_NAME)
        if value.type_ is Parameter.Type.BOOL:
            self.ros_time_is_active = value.value
        elif value.type_ is not Parameter.Type.NOT_SET:
            node.get_logger().error(f"Invalid type for parameter '{USE_SIM_TIME_NAME}' {value.type_!r} should be bool")
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._on_set)

    def detach_node(self) -> None:
        """Let the node go."""
        if self._node_weak_ref is None:
            raise RuntimeError("Unable to detach node, no node attached to time source")
        self.ros_time_is_active = False
        self._node_weak_ref = None

    def attach_clock(self, clock: Clock) -> None:
        """Drive a ROS clock."""
        if not isinstance(clock, ROSClock):
            raise ValueError("Only clocks with type ROS_TIME can be attached.")
        clock.set_ros_time_override(self._last_time_set)
        clock._set_ros_time_is_active(self.ros_time_is_active)
        self._associated_clocks.add(clock)

    def clock_callback(self, msg: Any) -> None:
        """Take a time from /clock."""
        time = Time.from_msg(msg.clock)
        self._last_time_set = time
        for clock in self._associated_clocks:
            clock.set_ros_time_override(time)

    def _check(self, parameters: list[Parameter]) -> Any:
        from rcl_interfaces.msg import SetParametersResult  # noqa: PLC0415  classes are made on first use

        for parameter in parameters:
            if parameter.name == USE_SIM_TIME_NAME and parameter.type_ is not Parameter.Type.BOOL:
                return SetParametersResult(successful=False, reason=f"'{USE_SIM_TIME_NAME}' must be a bool")
        return SetParametersResult(successful=True)

    def _on_set(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == USE_SIM_TIME_NAME:
                self.ros_time_is_active = bool(parameter.value)
