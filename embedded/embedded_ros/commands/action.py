# SPDX-License-Identifier: Apache-2.0
"""``ros2 action``."""

from __future__ import annotations

import argparse
from typing import Any

from embedded_ros.commands import common
from embedded_ros.wire import EntityKind

_SEND_GOAL = "/_action/send_goal"
_CANCEL_DEADLINE_S = 5.0
_STATUS = {1: "ACCEPTED", 2: "EXECUTING", 3: "CANCELING", 4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 action", description="Look at actions and send goals.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    listing = verbs.add_parser("list", help="output a list of action names")
    listing.add_argument("-t", "--show-types", action="store_true", help="additionally show the action type")
    listing.add_argument("-c", "--count-actions", action="store_true", help="only display the number of actions")
    info = verbs.add_parser("info", help="print information about an action")
    info.add_argument("action_name", help="name of the action")
    info.add_argument("-t", "--show-types", action="store_true", help="additionally show the action type")
    info.add_argument("-c", "--count", action="store_true", help="only display the numbers")
    send = verbs.add_parser("send_goal", help="send an action goal")
    send.add_argument("action_name", help="name of the action")
    send.add_argument("action_type", help="type, such as example_interfaces/action/Fibonacci")
    send.add_argument("goal", nargs="?", default="{}", help="goal as a YAML dictionary")
    send.add_argument(
        "-t", "--timeout", type=int, metavar="N", help="seconds to wait for the server, and for the result"
    )
    send.add_argument("-f", "--feedback", action="store_true", help="echo feedback messages for the goal")
    for verb in verbs.choices.values():
        common.add_hidden(verb)
    arguments = parser.parse_args(argv)
    return {"list": _list, "info": _info, "send_goal": _send_goal}[arguments.verb](arguments)


def _list(arguments: argparse.Namespace) -> None:
    with common.graph() as graph:
        found: dict[str, set[str]] = {}
        for entity in graph.snapshot(EntityKind.SERVICE, EntityKind.CLIENT):
            if entity.name.endswith(_SEND_GOAL):
                kind = entity.ros_type.removesuffix("_SendGoal")
                found.setdefault(entity.name.removesuffix(_SEND_GOAL), set()).add(kind)
    if arguments.count_actions:
        print(len(found))
        return
    for name, types in sorted(found.items()):
        print(f"{name} [{', '.join(sorted(types))}]" if arguments.show_types else name)


def _info(arguments: argparse.Namespace) -> None:
    with common.graph() as graph:
        name = common.absolute(arguments.action_name) + _SEND_GOAL
        clients = graph.endpoints(name, EntityKind.CLIENT)
        servers = graph.endpoints(name, EntityKind.SERVICE)
    print(f"Action: {arguments.action_name}")
    for title, entities in (("Action clients", clients), ("Action servers", servers)):
        print(f"{title}: {len(entities)}")
        if not arguments.count:
            for entity in entities:
                kind = f" [{entity.ros_type.removesuffix('_SendGoal')}]" if arguments.show_types else ""
                print(f"    {entity.full_node_name}{kind}")


def _send_goal(arguments: argparse.Namespace) -> str | None:
    from rclpy.action import ActionClient  # noqa: PLC0415  as above

    from embedded_ros.registry import registry  # noqa: PLC0415  verbs on the graph start without it
    from embedded_ros.text_form import fill, parse_values, to_yaml  # noqa: PLC0415  as above

    kind = registry().interface(arguments.action_type)
    if not hasattr(kind, "Goal"):
        return "The passed action type is invalid"
    goal = kind.Goal()
    fill(goal, parse_values(arguments.goal))
    with common.node("send_goal") as node:
        client: ActionClient[Any, Any, Any] = ActionClient(node, kind, arguments.action_name)
        print("Waiting for an action server to become available...", flush=True)
        if not client.wait_for_server(arguments.timeout):
            print(f"Action server is not available after waiting {arguments.timeout} seconds.")
            client.destroy()
            return None
        print(f"Sending goal:\n     {to_yaml(goal)}", flush=True)

        def show(feedback: Any) -> None:
            print(f"Feedback:\n    {to_yaml(feedback.feedback)}", flush=True)

        try:
            return _follow(node, client, goal, show if arguments.feedback else None, arguments.timeout)
        finally:
            client.destroy()


def _follow(node: Any, client: Any, goal: Any, feedback: Any, timeout_s: int | None) -> str | None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it

    from embedded_ros.text_form import to_yaml  # noqa: PLC0415  as above

    sent = client.send_goal_async(goal, feedback)
    rclpy.spin_until_future_complete(node, sent)
    handle = sent.result()
    if handle is None:
        return f"Exception while sending goal: {sent.exception()!r}"
    if not handle.accepted:
        print("Goal was rejected.")
        return None
    print(f"Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n", flush=True)
    future = handle.get_result_async()
    try:
        rclpy.spin_until_future_complete(node, future, timeout_sec=timeout_s)
    except KeyboardInterrupt:
        if problem := _cancel(node, handle):
            return problem
        rclpy.spin_until_future_complete(node, future)  # the canceled goal has a result, too
    if not future.done():
        print(f"Timed out waiting for result after {timeout_s} seconds.")
        return None
    if future.result() is None:
        return f"Exception while getting result: {future.exception()!r}"
    print(f"Result:\n    {to_yaml(future.result().result)}")
    print(f"Goal finished with status: {_STATUS.get(future.result().status, 'UNKNOWN')}")
    return None


def _cancel(node: Any, handle: Any) -> str | None:
    """Cancel a goal after Ctrl-C."""
    import rclpy  # noqa: PLC0415  as above

    print("Canceling goal...", flush=True)
    canceled = handle.cancel_goal_async()
    rclpy.spin_until_future_complete(node, canceled, timeout_sec=_CANCEL_DEADLINE_S)
    if not canceled.done() or not canceled.result().goals_canceling:
        return "Failed to cancel goal"
    print("Goal canceled.", flush=True)
    return None
