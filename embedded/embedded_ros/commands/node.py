# SPDX-License-Identifier: Apache-2.0
"""``ros2 node``."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from embedded_ros.commands import common
from embedded_ros.graph import names_and_types
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from embedded_ros.graph import Graph
    from embedded_ros.wire import Entity

_ACTION_PART = "/_action/"


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 node", description="Look at nodes.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    listing = verbs.add_parser("list", help="output a list of available nodes")
    listing.add_argument("-a", "--all", action="store_true", help="display all nodes even hidden ones")
    listing.add_argument("-c", "--count-nodes", action="store_true", help="only display the number of nodes")
    info = verbs.add_parser("info", help="output information about a node")
    info.add_argument("node_name", help="full name of the node, such as /talker")
    info.add_argument(
        "--include-hidden", action="store_true", help="display hidden topics, services and actions as well"
    )
    for verb in verbs.choices.values():
        verb.add_argument(
            "--no-daemon", action="store_true", help="accepted for compatibility; there is no daemon here"
        )
        verb.add_argument("--spin-time", type=float, help="accepted for compatibility")
    arguments = parser.parse_args(argv)
    return {"list": _list, "info": _info}[arguments.verb](arguments)


def _names(graph: Graph, *, include_hidden: bool) -> list[str]:
    nodes = graph.snapshot(EntityKind.NODE)
    return sorted(node.full_node_name for node in nodes if include_hidden or not common.hidden(node.full_node_name))


def _list(arguments: argparse.Namespace) -> None:
    with common.graph() as graph:
        names = _names(graph, include_hidden=arguments.all)
    if arguments.count_nodes:
        print(len(names))
        return
    if len(set(names)) != len(names):
        print("WARNING: Be aware that there are nodes in the graph that share an exact name, which can have "
              "unintended side effects.", file=sys.stderr)  # fmt: skip
    for name in names:
        print(name)


def _info(arguments: argparse.Namespace) -> str | None:
    with common.graph() as graph:
        count = _names(graph, include_hidden=True).count(arguments.node_name)
        if not count:
            return f"Unable to find node '{arguments.node_name}'"
        if count > 1:
            print(f"There are {count} nodes in the graph with the exact name '{arguments.node_name}'. You are seeing "
                  "information about only one of them.", file=sys.stderr)  # fmt: skip

        def mine(kind: EntityKind) -> list[Entity]:
            return [item for item in graph.snapshot(kind) if item.full_node_name == arguments.node_name]

        subscriptions, publishers = mine(EntityKind.SUBSCRIPTION), mine(EntityKind.PUBLISHER)
        services, clients = mine(EntityKind.SERVICE), mine(EntityKind.CLIENT)
    print(arguments.node_name)
    for title, entities in (
        ("Subscribers", subscriptions),
        ("Publishers", publishers),
        ("Service Servers", services),
        ("Service Clients", clients),
    ):
        print(f"  {title}:")
        shown = [item for item in names_and_types(entities) if arguments.include_hidden or not common.hidden(item[0])]
        print(*(f"    {name}: {', '.join(types)}" for name, types in shown), sep="\n")
    for title, entities in (("Action Servers", services), ("Action Clients", clients)):
        print(f"  {title}:")
        actions = [item for item in names_and_types(entities) if item[0].endswith(_ACTION_PART + "send_goal")]
        print(
            *(
                f"    {name.split(_ACTION_PART)[0]}: {', '.join(kind.removesuffix('_SendGoal') for kind in types)}"
                for name, types in actions
            ),
            sep="\n",
        )
    return None
