# SPDX-License-Identifier: Apache-2.0
"""States and transitions of lifecycle nodes; numbers and labels are lifecycle_msgs' and rcl_lifecycle's."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from rclpy._rclpy_pybind11 import RCLError


class TransitionCallbackReturn(IntEnum):
    """How a transition callback ended."""

    SUCCESS = 97
    FAILURE = 98
    ERROR = 99

    def to_label(self) -> str:
        """Return the label of the internal transition that follows."""
        return f"transition_{self.name.lower()}"


class LifecycleState(NamedTuple):
    """A state."""

    state_id: int
    label: str


class Transition(NamedTuple):
    """A transition: possible in ``start`` only."""

    transition_id: int
    label: str
    start: LifecycleState
    goal: LifecycleState


UNKNOWN = LifecycleState(0, "unknown")
UNCONFIGURED = LifecycleState(1, "unconfigured")
INACTIVE = LifecycleState(2, "inactive")
ACTIVE = LifecycleState(3, "active")
FINALIZED = LifecycleState(4, "finalized")
CONFIGURING = LifecycleState(10, "configuring")
CLEANINGUP = LifecycleState(11, "cleaningup")
SHUTTINGDOWN = LifecycleState(12, "shuttingdown")
ACTIVATING = LifecycleState(13, "activating")
DEACTIVATING = LifecycleState(14, "deactivating")
ERRORPROCESSING = LifecycleState(15, "errorprocessing")

STATES = (UNKNOWN, UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED, CONFIGURING, CLEANINGUP, SHUTTINGDOWN, ACTIVATING,
          DEACTIVATING, ERRORPROCESSING)  # fmt: skip


def _outcomes(
    first_id: int, start: LifecycleState, success: LifecycleState, failure: LifecycleState
) -> list[Transition]:
    error = FINALIZED if start is ERRORPROCESSING else ERRORPROCESSING
    return [
        Transition(first_id, "transition_success", start, success),
        Transition(first_id + 1, "transition_failure", start, failure),
        Transition(first_id + 2, "transition_error", start, error),
    ]


TRANSITIONS = (
    Transition(1, "configure", UNCONFIGURED, CONFIGURING),
    *_outcomes(10, CONFIGURING, INACTIVE, UNCONFIGURED),
    Transition(2, "cleanup", INACTIVE, CLEANINGUP),
    *_outcomes(20, CLEANINGUP, UNCONFIGURED, INACTIVE),
    Transition(3, "activate", INACTIVE, ACTIVATING),
    *_outcomes(30, ACTIVATING, ACTIVE, INACTIVE),
    Transition(4, "deactivate", ACTIVE, DEACTIVATING),
    *_outcomes(40, DEACTIVATING, INACTIVE, ACTIVE),
    Transition(5, "shutdown", UNCONFIGURED, SHUTTINGDOWN),
    Transition(6, "shutdown", INACTIVE, SHUTTINGDOWN),
    Transition(7, "shutdown", ACTIVE, SHUTTINGDOWN),
    *_outcomes(50, SHUTTINGDOWN, FINALIZED, FINALIZED),
    *_outcomes(60, ERRORPROCESSING, UNCONFIGURED, FINALIZED),
)


class StateMachine:
    """Where a node is."""

    def __init__(self) -> None:
        self._state = UNCONFIGURED

    @property
    def current_state(self) -> LifecycleState:
        """The state."""
        return self._state

    @property
    def initialized(self) -> bool:
        """Always true here."""
        return True

    @property
    def available_transitions(self) -> list[Transition]:
        """The transitions out of the state."""
        return [item for item in TRANSITIONS if item.start is self._state]

    def find(self, key: int | str) -> Transition:
        """Return the transition out of the state with an id or label; RCLError when there is none."""
        for item in self.available_transitions:
            if key in {item.transition_id, item.label}:
                return item
        possible = ", ".join(f"{item.label} ({item.transition_id})" for item in self.available_transitions) or "none"
        raise RCLError(f"no transition {key!r} from state '{self._state.label}'; possible are: {possible}")

    def trigger(self, key: int | str) -> Transition:
        """Make a transition and return it."""
        transition = self.find(key)
        self._state = transition.goal
        return transition
