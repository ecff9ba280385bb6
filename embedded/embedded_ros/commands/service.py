# SPDX-License-Identifier: Apache-2.0
"""``ros2 service``."""

from __future__ import annotations

import argparse
import time

from embedded_ros.commands import common
from embedded_ros.graph import names_and_types
from embedded_ros.wire import EntityKind


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 service", description="Look at and call services.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    listing = verbs.add_parser("list", help="output a list of available services")
    listing.add_argument("-t", "--show-types", action="store_true", help="additionally show the service type")
    listing.add_argument("-c", "--count-services", action="store_true", help="only display the number of services")
    listing.add_argument("--include-hidden-services", action="store_true", help="consider hidden services as well")
    kind = verbs.add_parser("type", help="output a service's type")
    kind.add_argument("service_name", help="name of the service")
    find = verbs.add_parser("find", help="output a list of services of a given type")
    find.add_argument("service_type", help="type, such as std_srvs/srv/Trigger")
    calling = verbs.add_parser("call", help="call a service")
    calling.add_argument("service_name", help="name of the service")
    calling.add_argument("service_type", help="type, such as std_srvs/srv/Trigger")
    calling.add_argument("values", nargs="?", default="{}", help="request as a YAML dictionary")
    calling.add_argument("-r", "--rate", type=float, metavar="N", help="repeat the call at this rate in Hz")
    for verb in verbs.choices.values():
        common.add_hidden(verb)
    arguments = parser.parse_args(argv)
    return {"list": _list, "type": _type, "find": _find, "call": _call}[arguments.verb](arguments)


def _services(*, include_hidden: bool) -> list[tuple[str, list[str]]]:
    with common.graph() as graph:
        found = names_and_types(graph.snapshot(EntityKind.SERVICE))
    return [(name, types) for name, types in found if include_hidden or not common.hidden(name)]


def _list(arguments: argparse.Namespace) -> None:
    services = _services(include_hidden=arguments.include_hidden_services)
    if arguments.count_services:
        print(len(services))
        return
    for name, types in services:
        print(f"{name} [{', '.join(types)}]" if arguments.show_types else name)


def _type(arguments: argparse.Namespace) -> int:
    for name, types in _services(include_hidden=True):
        if name == arguments.service_name:
            print("\n".join(types))
            return 0
    return 1


def _find(arguments: argparse.Namespace) -> None:
    for name, types in _services(include_hidden=False):
        if arguments.service_type in types:
            print(name)


def _call(arguments: argparse.Namespace) -> str | None:
    import rclpy  # noqa: PLC0415  verbs on the graph start without it

    from embedded_ros.registry import registry  # noqa: PLC0415  as above
    from embedded_ros.text_form import fill, parse_values  # noqa: PLC0415  as above

    if arguments.rate is not None and arguments.rate <= 0:
        return "rate must be greater than zero"
    kind = registry().interface(arguments.service_type)
    if not hasattr(kind, "Request"):
        return "The passed type is not a service"
    request = kind.Request()
    fill(request, parse_values(arguments.values))
    with common.node("requester") as node:
        client = node.create_client(kind, arguments.service_name)
        if not client.service_is_ready():
            print("waiting for service to become available...", flush=True)
            client.wait_for_service()
        while rclpy.ok():
            print(f"requester: making request: {request!r}\n", flush=True)
            started = time.monotonic()
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future)
            if future.result() is None:
                return f"Exception while calling service: {future.exception()!r}"
            print(f"response:\n{future.result()!r}\n", flush=True)
            if arguments.rate is None:
                break
            time.sleep(max(0.0, started + 1.0 / arguments.rate - time.monotonic()))
    return None
