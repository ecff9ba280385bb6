# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes."""

from __future__ import annotations

import traceback
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import state_machine as sm
from rclpy.lifecycle.managed_entity import ManagedEntity
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.lifecycle.state_machine import LifecycleState, StateMachine, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.publisher import Publisher

_CALLBACKS = {
    sm.CONFIGURING: "on_configure",
    sm.CLEANINGUP: "on_cleanup",
    sm.SHUTTINGDOWN: "on_shutdown",
    sm.ACTIVATING: "on_activate",
    sm.DEACTIVATING: "on_deactivate",
    sm.ERRORPROCESSING: "on_error",
}


class LifecycleNodeMixin(ManagedEntity):
    """Adds the lifecycle to a node: put it before Node in the bases."""

    def __init__(
        self, *, enable_communication_interface: bool = True, callback_group: CallbackGroup | None = None
    ) -> None:
        if not isinstance(self, Node):
            raise RuntimeError("This class must be initialized after Node, as a mixin of it")
        self._state_machine = StateMachine()
        self._managed_entities: set[ManagedEntity] = set()
        self._rcl_transition_event: Publisher | None = None
        if enable_communication_interface:
            self._rcl_start_services(self, callback_group)

    def _rcl_start_services(self, node: Node, group: CallbackGroup | None) -> None:
        from lifecycle_msgs import srv  # noqa: PLC0415  classes are made on first use
        from lifecycle_msgs.msg import TransitionEvent  # noqa: PLC0415  as above

        for kind, name, callback in (
            (srv.ChangeState, "change_state", self._rcl_on_change_state),
            (srv.GetState, "get_state", self._rcl_on_get_state),
            (srv.GetAvailableStates, "get_available_states", self._rcl_on_get_available_states),
            (srv.GetAvailableTransitions, "get_available_transitions", self._rcl_on_get_available_transitions),
            (srv.GetAvailableTransitions, "get_transition_graph", self._rcl_on_get_transition_graph),
        ):
            node.create_service(kind, f"~/{name}", callback, callback_group=group)
        self._rcl_transition_event = Node.create_publisher(
            node, TransitionEvent, "~/transition_event", QoSProfile(depth=10)
        )

    # -- transitions ------------------------------------------------------------------------------------------

    def trigger_configure(self) -> TransitionCallbackReturn:
        """Make the transition configure."""
        return self._rcl_change_state("configure")

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        """Make the transition cleanup."""
        return self._rcl_change_state("cleanup")

    def trigger_shutdown(self) -> TransitionCallbackReturn:
        """Make the transition shutdown."""
        if self._state_machine.current_state not in {sm.UNCONFIGURED, sm.INACTIVE, sm.ACTIVE}:
            raise RCLError("Shutdown transtion not possible")
        return self._rcl_change_state("shutdown")

    def trigger_activate(self) -> TransitionCallbackReturn:
        """Make the transition activate."""
        return self._rcl_change_state("activate")

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        """Make the transition deactivate."""
        return self._rcl_change_state("deactivate")

    def _rcl_change_state(self, key: int | str) -> TransitionCallbackReturn:
        initial = self._state_machine.current_state
        self._rcl_step(key)
        code = self._rcl_call(initial)
        self._rcl_step(code.to_label())
        if code is TransitionCallbackReturn.ERROR:
            self._rcl_step(self._rcl_call(initial).to_label())
        return code

    def _rcl_step(self, key: int | str) -> None:
        transition = self._state_machine.trigger(key)
        publisher = self._rcl_transition_event
        if publisher is None or not publisher._node.context.ok():
            return
        event = publisher.msg_type()
        event.timestamp = publisher._node.get_clock().now().nanoseconds
        event.transition.id, event.transition.label = transition.transition_id, transition.label
        event.start_state.id, event.start_state.label = transition.start
        event.goal_state.id, event.goal_state.label = transition.goal
        publisher.publish(event)

    def _rcl_call(self, previous: LifecycleState) -> TransitionCallbackReturn:
        name = _CALLBACKS[self._state_machine.current_state]
        try:
            code = getattr(self, name)(previous)
        except Exception:  # noqa: BLE001  any failure of a transition is an ERROR of the state machine
            traceback.print_exc()
            return TransitionCallbackReturn.ERROR
        if not isinstance(code, TransitionCallbackReturn):
            message = f"{name}: expected a TransitionCallbackReturn, found {code!r}"
            if isinstance(self, Node):
                self.get_logger().error(message)
            return TransitionCallbackReturn.ERROR
        return code

    # -- managed entities -------------------------------------------------------------------------------------

    def _rcl_pass_on(self, callback_name: str, state: LifecycleState) -> TransitionCallbackReturn:
        for entity in self._managed_entities:
            code = getattr(entity, callback_name)(state)
            if not isinstance(code, TransitionCallbackReturn):
                raise TypeError(
                    f"{callback_name}() of {type(entity)}: expected a TransitionCallbackReturn, found {code!r}"
                )
            if code is not TransitionCallbackReturn.SUCCESS:
                return code
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle configure; by default the managed entities do."""
        return self._rcl_pass_on("on_configure", state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle cleanup; by default the managed entities do."""
        return self._rcl_pass_on("on_cleanup", state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle shutdown; by default the managed entities do."""
        return self._rcl_pass_on("on_shutdown", state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle activate; by default the managed entities do."""
        return self._rcl_pass_on("on_activate", state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle deactivate; by default the managed entities do."""
        return self._rcl_pass_on("on_deactivate", state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle an error; by default the managed entities do."""
        return self._rcl_pass_on("on_error", state)

    def create_lifecycle_publisher(self, *args: Any, **kwargs: Any) -> Any:
        """Make a publisher that publishes only while the node is active."""
        if "publisher_class" in kwargs:
            raise TypeError("create_publisher() got an unexpected keyword argument 'publisher_class'")
        publisher = Node.create_publisher(self, *args, **kwargs, publisher_class=LifecyclePublisher)  # type: ignore[arg-type]
        self._managed_entities.add(publisher)
        return publisher

    # -- services ---------------------------------------------------------------------------------------------

    def _rcl_on_change_state(self, request: Any, response: Any) -> Any:
        try:
            code = self._rcl_change_state(request.transition.label or request.transition.id)
        except RCLError as error:
            if isinstance(self, Node):
                self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return response
        response.success = code is TransitionCallbackReturn.SUCCESS
        return response

    def _rcl_on_get_state(self, request: Any, response: Any) -> Any:  # noqa: ARG002
        response.current_state.id, response.current_state.label = self._state_machine.current_state
        return response

    def _rcl_on_get_available_states(self, request: Any, response: Any) -> Any:  # noqa: ARG002
        from lifecycle_msgs.msg import State  # noqa: PLC0415  classes are made on first use

        response.available_states = [State(id=state.state_id, label=state.label) for state in sm.STATES]
        return response

    def _rcl_on_get_available_transitions(self, request: Any, response: Any) -> Any:  # noqa: ARG002
        return _describe(self._state_machine.available_transitions, response)

    def _rcl_on_get_transition_graph(self, request: Any, response: Any) -> Any:  # noqa: ARG002
        return _describe(sm.TRANSITIONS, response)


def _describe(transitions: Any, response: Any) -> Any:
    from lifecycle_msgs.msg import TransitionDescription  # noqa: PLC0415  classes are made on first use

    for item in transitions:
        described = TransitionDescription()
        described.transition.id, described.transition.label = item.transition_id, item.label
        described.start_state.id, described.start_state.label = item.start
        described.goal_state.id, described.goal_state.label = item.goal
        response.available_transitions.append(described)
    return response


class LifecycleNode(LifecycleNodeMixin, Node):
    """A node with a lifecycle."""

    def __init__(self, node_name: str, *, enable_communication_interface: bool = True, **kwargs: Any) -> None:
        Node.__init__(self, node_name, **kwargs)
        LifecycleNodeMixin.__init__(self, enable_communication_interface=enable_communication_interface)
