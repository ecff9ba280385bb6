# SPDX-License-Identifier: Apache-2.0
"""Checks that a class is a message, service or action type; the messages of every action, for type checkers."""

from typing import Any, Protocol, TypeVar

from rclpy.exceptions import NoTypeSupportImportedException

from embedded_ros.messages import Message

ResultT_co = TypeVar("ResultT_co", covariant=True)
FeedbackT_co = TypeVar("FeedbackT_co", covariant=True)


class GetResultServiceResponse(Protocol[ResultT_co]):
    """How a goal ended: what ``get_result_async`` ends with."""

    @property
    def status(self) -> int:
        """As action_msgs/GoalStatus has it."""

    @property
    def result(self) -> ResultT_co:
        """The action's result."""


class FeedbackMessage(Protocol[FeedbackT_co]):
    """What a feedback callback gets."""

    @property
    def goal_id(self) -> Any:
        """The goal's unique_identifier_msgs/UUID."""

    @property
    def feedback(self) -> FeedbackT_co:
        """The action's feedback."""


def check_for_type_support(msg_or_srv_type: Any) -> None:
    """Raise unless the class is an interface type."""
    if hasattr(msg_or_srv_type, "DEFINITION"):
        return
    if not isinstance(msg_or_srv_type, type):
        raise AttributeError(f"expected an interface class, found {msg_or_srv_type!r}")
    raise NoTypeSupportImportedException


def check_is_valid_msg_type(msg_type: Any) -> None:
    """Raise RuntimeError unless the class is a message type."""
    check_for_type_support(msg_type)
    if not (isinstance(msg_type, type) and issubclass(msg_type, Message)):
        raise RuntimeError(f"The message type provided is not valid ({msg_type}), this might be a service or action")


def check_is_valid_srv_type(srv_type: Any) -> None:
    """Raise RuntimeError unless the class is a service type."""
    check_for_type_support(srv_type)
    if not (hasattr(srv_type, "Request") and hasattr(srv_type, "Response") and hasattr(srv_type, "Event")):
        raise RuntimeError(f"The service type provided is not valid ({srv_type}), this might be a message or action")


def check_is_valid_action_type(action_type: Any) -> None:
    """Raise RuntimeError unless the class is an action type."""
    check_for_type_support(action_type)
    if not hasattr(action_type, "Impl"):
        raise RuntimeError(f"The action type provided is not valid ({action_type}), this might be a message or service")
