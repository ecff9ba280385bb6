# SPDX-License-Identifier: Apache-2.0
"""Calls back when parameters of any node change."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, qos_profile_parameter_events

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.node import Node


class ParameterCallbackHandle:
    """A callback for one parameter of one node."""

    def __init__(self, parameter_name: str, node_name: str, callback: Callable[[Any], None]) -> None:
        self.parameter_name = parameter_name
        self.node_name = node_name
        self.callback = callback


class ParameterEventCallbackHandle:
    """A callback for every event."""

    def __init__(self, callback: Callable[[Any], None]) -> None:
        self.callback = callback


class _Callbacks:
    """The callbacks of a handler; the last one added is called first."""

    def __init__(self) -> None:
        self.parameter_callbacks: dict[tuple[str, str], list[ParameterCallbackHandle]] = {}
        self.event_callbacks: list[ParameterEventCallbackHandle] = []
        self._lock = threading.Lock()

    def event_callback(self, event: Any) -> None:
        """Call whom an event concerns; callbacks may add and remove callbacks."""
        with self._lock:
            calls = [
                (handle.callback, parameter)
                for (name, node), handles in self.parameter_callbacks.items()
                if (parameter := ParameterEventHandler.get_parameter_from_event(event, name, node)) is not None
                for handle in handles
            ]
            calls += [(handle.callback, event) for handle in self.event_callbacks]
        for callback, argument in calls:
            callback(argument)

    def add_parameter_callback(
        self, parameter_name: str, node_name: str, callback: Callable[[Any], None]
    ) -> ParameterCallbackHandle:
        """Add a callback for one parameter."""
        handle = ParameterCallbackHandle(parameter_name, node_name, callback)
        with self._lock:
            self.parameter_callbacks.setdefault((parameter_name, node_name), []).insert(0, handle)
        return handle

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Remove it."""
        key = (handle.parameter_name, handle.node_name)
        with self._lock:
            if handle not in self.parameter_callbacks.get(key, []):
                raise RuntimeError("Callback doesn't exist")
            self.parameter_callbacks[key].remove(handle)
            if not self.parameter_callbacks[key]:
                del self.parameter_callbacks[key]

    def add_parameter_event_callback(self, callback: Callable[[Any], None]) -> ParameterEventCallbackHandle:
        """Add a callback for every event."""
        handle = ParameterEventCallbackHandle(callback)
        with self._lock:
            self.event_callbacks.insert(0, handle)
        return handle

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Remove it."""
        with self._lock:
            if handle not in self.event_callbacks:
                raise RuntimeError("Callback doesn't exist")
            self.event_callbacks.remove(handle)


class ParameterEventHandler:
    """Listens to /parameter_events."""

    Callbacks = _Callbacks

    def __init__(self, node: Node, qos_profile: QoSProfile = qos_profile_parameter_events, **options: Any) -> None:
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        self.node = node
        self.qos_profile = qos_profile
        self._callbacks = _Callbacks()
        self.parameter_event_subscription = node.create_subscription(
            ParameterEvent, "/parameter_events", self._callbacks.event_callback, qos_profile, **options
        )

    def destroy(self) -> None:
        """Stop listening."""
        self.node.destroy_subscription(self.parameter_event_subscription)

    @staticmethod
    def get_parameter_from_event(event: Any, parameter_name: str, node_name: str) -> Any:
        """Return the parameter message of a name in an event of a node; None when it is not there."""
        if event.node != node_name:
            return None
        for parameter in ParameterEventHandler.get_parameters_from_event(event):
            if parameter.name == parameter_name:
                return parameter
        return None

    @staticmethod
    def get_parameters_from_event(event: Any) -> Iterable[Any]:
        """Return the new and changed parameters of an event."""
        yield from event.new_parameters
        yield from event.changed_parameters

    def add_parameter_callback(
        self, parameter_name: str, node_name: str, callback: Callable[[Any], None]
    ) -> ParameterCallbackHandle:
        """Call back when a parameter of a node is set; a relative node name is in this node's namespace."""
        return self._callbacks.add_parameter_callback(parameter_name, self._resolve_path(node_name), callback)

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Stop calling back."""
        self._callbacks.remove_parameter_callback(handle)

    def add_parameter_event_callback(self, callback: Callable[[Any], None]) -> ParameterEventCallbackHandle:
        """Call back on every event."""
        return self._callbacks.add_parameter_event_callback(callback)

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Stop calling back."""
        self._callbacks.remove_parameter_event_callback(handle)

    def _resolve_path(self, node_path: str | None = None) -> str:
        if not node_path:
            return self.node.get_fully_qualified_name()
        return node_path if node_path.startswith("/") else f"{self.node.get_namespace().rstrip('/')}/{node_path}"
