# SPDX-License-Identifier: Apache-2.0
"""Which cell a bag is of, and which messages on the topics that all cells of a domain share come from it.

The nodes of a named cell live in its namespace. A recorder in a namespace keeps what is published below it, and of
the shared topics (/diagnostics, /rosout, /parameter_events, /tf) those messages whose sender says that it is there.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from softgrip_bag.errors import BagError

#: Topics of every cell, by which its namespace is found.
_OF_A_CELL = (
    "/tendon/state",
    "/cell/state",
    "/finger/predicted",
    "/finger/markers",
    "/shape/predicted",
    "/friction/active",
    "/rig/sample",
    "/grasp_mix_manager/trace",
)


def cell_namespace(topics: Iterable[str]) -> str:
    """Return the namespace of the cell that topics belong to, as a prefix: "" or "/cell_2".

    Raises:
        BagError: there are several cells.
    """
    found = {topic.removesuffix(own) for topic in topics for own in _OF_A_CELL if topic.endswith(own)}
    if len(found) > 1:
        names = ", ".join(sorted(name or "/" for name in found))
        raise BagError(f"expected topics of one cell, found {names}; record each cell by its own recorder")
    return found.pop() if found else ""


def is_below(name: str, namespace: str) -> bool:
    """Return whether a node or topic lies in a namespace ("" or "/" = everything)."""
    prefix = namespace.rstrip("/")
    return not prefix or name.startswith(f"{prefix}/")


def _of_log(message: Any, name: str) -> bool:
    return str(message.name).startswith(f"{name.replace('/', '.')}.")


def _of_event(message: Any, name: str) -> bool:
    return str(message.node).startswith(f"/{name}/")


def _of_diagnostics(message: Any, name: str) -> bool:
    return all(str(status.name).startswith(f"{name}/") for status in message.status)


def _of_tf(message: Any, name: str) -> bool:
    return all(str(transform.child_frame_id).startswith(f"{name}/") for transform in message.transforms)


#: Type of a shared topic -> whether a message comes from a cell (its namespace without the first slash).
_SENDERS = {
    "rcl_interfaces/msg/Log": _of_log,
    "rcl_interfaces/msg/ParameterEvent": _of_event,
    "diagnostic_msgs/msg/DiagnosticArray": _of_diagnostics,
    "tf2_msgs/msg/TFMessage": _of_tf,
}
#: Shared topics that no message of which belongs to one cell alone.
_OF_ALL = ("/clock",)


def is_shared(topic: str, type_name: str) -> bool:
    """Return whether a topic outside of every cell's namespace carries messages of all cells."""
    return topic.count("/") == 1 and (type_name in _SENDERS or topic in _OF_ALL)


def is_of_cell(type_name: str, message: Any, namespace: str) -> bool:
    """Return whether a message on a shared topic comes from a cell."""
    sender = _SENDERS.get(type_name)
    return sender is None or sender(message, namespace.strip("/"))
