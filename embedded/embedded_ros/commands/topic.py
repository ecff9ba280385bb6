# SPDX-License-Identifier: Apache-2.0
"""``ros2 topic``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from embedded_ros.commands import common, topic_messages
from embedded_ros.graph import names_and_types
from embedded_ros.wire import EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 topic", description="Look at, listen to and publish topics.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    _add_list(verbs.add_parser("list", help="output a list of available topics"))
    _add_info(verbs.add_parser("info", help="print information about a topic"))
    _add_type(verbs.add_parser("type", help="print a topic's type"))
    _add_find(verbs.add_parser("find", help="output a list of available topics of a given type"))
    topic_messages.add_echo(verbs.add_parser("echo", help="output messages from a topic"))
    topic_messages.add_hz(verbs.add_parser("hz", help="print the average publishing rate to screen"))
    topic_messages.add_bw(verbs.add_parser("bw", help="display bandwidth used by topic"))
    topic_messages.add_pub(verbs.add_parser("pub", help="publish a message to a topic"))
    for verb in verbs.choices.values():
        common.add_hidden(verb)
    arguments = parser.parse_args(argv)
    function: Callable[[argparse.Namespace], int | str | None] = arguments.function
    return function(arguments)


# -- graph ----------------------------------------------------------------------------------------------------


def _topics(*, include_hidden: bool) -> list[tuple[str, list[str], int, int]]:
    with common.graph() as graph:
        publishers = graph.snapshot(EntityKind.PUBLISHER)
        subscriptions = graph.snapshot(EntityKind.SUBSCRIPTION)
    return [
        (
            name,
            types,
            sum(item.name == name for item in publishers),
            sum(item.name == name for item in subscriptions),
        )
        for name, types in names_and_types([*publishers, *subscriptions])
        if include_hidden or not common.hidden(name)
    ]


def _add_list(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-t", "--show-types", action="store_true", help="additionally show the topic type")
    parser.add_argument(
        "-c", "--count-topics", action="store_true", help="only display the number of topics discovered"
    )
    parser.add_argument("--include-hidden-topics", action="store_true", help="consider hidden topics as well")
    parser.add_argument("-v", "--verbose", action="store_true", help="list full details about each topic")
    parser.set_defaults(function=_list)


def _list(arguments: argparse.Namespace) -> None:
    topics = _topics(include_hidden=arguments.include_hidden_topics)
    if arguments.count_topics:
        print(len(topics))
    elif arguments.verbose:
        for title, word, counts in (
            ("Published topics:", "publisher", [(name, types, count) for name, types, count, _ in topics]),
            ("Subscribed topics:", "subscriber", [(name, types, count) for name, types, _, count in topics]),
        ):
            print(title)
            for name, types, count in counts:
                if count:
                    print(f" * {name} [{', '.join(types)}] {count} {word}{'s' if count > 1 else ''}")
            print()
    else:
        for name, types, _, _ in topics:
            print(f"{name} [{', '.join(types)}]" if arguments.show_types else name)


def _add_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic_name", help="name of the topic, such as /chatter")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="print node, type hash, gid and QoS of each endpoint"
    )
    parser.set_defaults(function=_info)


def _info(arguments: argparse.Namespace) -> str | None:
    with common.graph() as graph:
        publishers = graph.endpoints(arguments.topic_name, EntityKind.PUBLISHER)
        subscriptions = graph.endpoints(arguments.topic_name, EntityKind.SUBSCRIPTION)
    found = names_and_types([*publishers, *subscriptions])
    if not found:
        return f"Unknown topic '{arguments.topic_name}'"
    types = found[0][1]
    end = "\n\n" if arguments.verbose else "\n"
    print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
    for title, entities in (("Publisher count", publishers), ("Subscription count", subscriptions)):
        print(f"{title}: {len(entities)}", end=end)
        if arguments.verbose:
            from rclpy.topic_endpoint_info import TopicEndpointInfo  # noqa: PLC0415  the short form starts without

            for entity in entities:
                print(TopicEndpointInfo._from_entity(entity), end=end)
    return None


def _add_type(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic_name", help="name of the topic")
    parser.set_defaults(function=_type)


def _type(arguments: argparse.Namespace) -> int:
    for name, types, _, _ in _topics(include_hidden=True):
        if name == arguments.topic_name:
            print("\n".join(types))
            return 0
    return 1


def _add_find(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic_type", help="type, such as std_msgs/msg/String")
    parser.set_defaults(function=_find)


def _find(arguments: argparse.Namespace) -> None:
    for name, types, _, _ in _topics(include_hidden=False):
        if arguments.topic_type in types:
            print(name)
