# SPDX-License-Identifier: Apache-2.0
"""``ros2 lifecycle``."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from embedded_ros.commands import common
from embedded_ros.wire import EntityKind

_TIMEOUT_S = 30.0  # a transition may home hardware


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(
        prog="ros2 lifecycle", description="Look at and change the state of lifecycle nodes."
    )
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    nodes = verbs.add_parser("nodes", help="output a list of nodes with lifecycle")
    nodes.add_argument("-c", "--count-nodes", action="store_true", help="only display the number of nodes")
    get = verbs.add_parser("get", help="get lifecycle state for one or more nodes")
    get.add_argument("node_name", nargs="?", help="name of the node; all when not given")
    put = verbs.add_parser("set", help="trigger lifecycle state transition")
    put.add_argument("node_name", help="name of the node")
    put.add_argument("transition", help="label or id, such as configure, activate, deactivate, cleanup, shutdown")
    listing = verbs.add_parser("list", help="output a list of available transitions")
    listing.add_argument("node_name", help="name of the node")
    listing.add_argument("--all", action="store_true", help="display all existing transitions")
    for verb in verbs.choices.values():
        common.add_hidden(verb)
    arguments = parser.parse_args(argv)
    with common.node("lifecycle") as node:
        names = sorted(
            entity.name.removesuffix("/get_state")
            for entity in node.context._graph.snapshot(EntityKind.SERVICE)
            if entity.name.endswith("/get_state") and entity.ros_type == "lifecycle_msgs/srv/GetState"
        )
        names = [name for name in names if arguments.include_hidden_nodes or not common.hidden(name)]
        if arguments.verb == "nodes":
            print(len(names) if arguments.count_nodes else "\n".join(names))
            return None
        requested = arguments.node_name and common.absolute(arguments.node_name)
        if requested and requested not in names:
            return "Node not found"
        if arguments.verb == "get":
            return _get(node, [requested] if requested else names, alone=bool(requested))
        return (_set if arguments.verb == "set" else _list)(node, requested, arguments)


def _ask(node: Any, target: str, kind: str, name: str, **fields: Any) -> Any:
    from lifecycle_msgs import srv  # noqa: PLC0415  classes are made on first use

    service = getattr(srv, kind)
    return common.call(node, service, f"{target}/{name}", service.Request(**fields), _TIMEOUT_S)


def _get(node: Any, names: list[str], *, alone: bool) -> str | None:
    for name in names:
        response = _ask(node, name, "GetState", "get_state")
        if response is None:
            return f"no answer from {name}"
        state = response.current_state
        print(f"{'' if alone else name + ': '}{state.label} [{state.id}]")
    return None


def _set(node: Any, name: str, arguments: argparse.Namespace) -> str | None:
    response = _ask(node, name, "GetAvailableTransitions", "get_available_transitions")
    if response is None:
        return f"no answer from {name}"
    transitions = [item.transition for item in response.available_transitions]
    for transition in transitions:
        if arguments.transition in {transition.label, str(transition.id)}:
            break
    else:
        known = "".join(f"\n- {transition.label} [{transition.id}]" for transition in transitions)
        return f"Unknown transition requested, available ones are:{known}"
    result = _ask(node, name, "ChangeState", "change_state", transition=transition)
    if result is None:
        return f"no answer from {name}"
    print("Transitioning successful" if result.success else "Transitioning failed",
          file=sys.stdout if result.success else sys.stderr)  # fmt: skip
    return None


def _list(node: Any, name: str, arguments: argparse.Namespace) -> str | None:
    service = "get_transition_graph" if arguments.all else "get_available_transitions"
    response = _ask(node, name, "GetAvailableTransitions", service)
    if response is None:
        return f"no answer from {name}"
    for item in response.available_transitions:
        print(f"- {item.transition.label} [{item.transition.id}]")
        print(f"\tStart: {item.start_state.label}\n\tGoal: {item.goal_state.label}")
    return None
