# SPDX-License-Identifier: Apache-2.0
"""``ros2 param``."""

from __future__ import annotations

import argparse
import re
import sys
from typing import Any

import yaml

from embedded_ros.commands import common

_LABELS = {1: "Boolean value is:", 2: "Integer value is:", 3: "Double value is:", 4: "String value is:",
           5: "Byte values are:", 6: "Boolean values are:", 7: "Integer values are:", 8: "Double values are:",
           9: "String values are:"}  # fmt: skip
_TYPES = ("not set", "boolean", "integer", "double", "string", "byte array", "boolean array", "integer array",
          "double array", "string array")  # fmt: skip


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 param", description="Look at and set parameters of nodes.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    listing = verbs.add_parser("list", help="output a list of available parameters")
    listing.add_argument("node_name", nargs="?", help="name of the node; all when not given")
    listing.add_argument("--param-prefixes", nargs="+", default=[], help="only list parameters with these prefixes")
    listing.add_argument("--param-type", action="store_true", help="print parameter types with parameter names")
    listing.add_argument("--filter", help="only list parameters that match a regular expression")
    get = verbs.add_parser("get", help="get parameter")
    get.add_argument("node_name", help="name of the node")
    get.add_argument("parameter_name", help="name of the parameter")
    get.add_argument("--hide-type", action="store_true", help="hide the type information")
    put = verbs.add_parser("set", help="set parameter")
    put.add_argument("node_name", help="name of the node")
    put.add_argument("parameter_name", help="name of the parameter")
    put.add_argument("value", help="value as YAML, such as 1.5 or '[1, 2]'")
    describe = verbs.add_parser("describe", help="show descriptive information about declared parameters")
    describe.add_argument("node_name", help="name of the node")
    describe.add_argument("parameter_names", nargs="+", help="names of the parameters")
    dump = verbs.add_parser("dump", help="show all of the parameters of a node in a YAML file format")
    dump.add_argument("node_name", help="name of the node")
    load = verbs.add_parser("load", help="load parameter file for a node")
    load.add_argument("node_name", help="name of the node")
    load.add_argument("parameter_file", help="parameter file")
    load.add_argument("--no-use-wildcard", action="store_true", help="do not load parameters in the '/**' namespace")
    for verb in verbs.choices.values():
        common.add_hidden(verb)
        verb.add_argument(
            "--timeout", type=float, default=1.0, help="seconds to wait until the node is up (default: 1)"
        )
    arguments = parser.parse_args(argv)
    with common.node("param") as node:
        if arguments.node_name:
            arguments.node_name = common.absolute(arguments.node_name)
            if not node.wait_for_node(arguments.node_name, arguments.timeout):
                return "Node not found"
        functions = {"list": _list, "get": _get, "set": _set, "describe": _describe, "dump": _dump, "load": _load}
        return functions[arguments.verb](node, arguments)


def _ask(node: Any, target: str, kind: str, name: str, **fields: Any) -> Any:
    from rcl_interfaces import srv  # noqa: PLC0415  classes are made on first use

    service = getattr(srv, kind)
    return common.call(node, service, f"{target}/{name}", service.Request(**fields))


def _names(node: Any, target: str, prefixes: list[str]) -> list[str] | None:
    response = _ask(node, target, "ListParameters", "list_parameters", prefixes=prefixes)
    return None if response is None else sorted(response.result.names)


def _list(node: Any, arguments: argparse.Namespace) -> None:
    everyone = [name for name in node.get_fully_qualified_node_names()
                if arguments.include_hidden_nodes or not common.hidden(name)]  # fmt: skip
    for target in [arguments.node_name] if arguments.node_name else sorted(set(everyone)):
        names = _names(node, target, arguments.param_prefixes)
        if names is None:
            print(f"Wait for service timed out waiting for parameter services for node {target}")
            continue
        names = [name for name in names if not arguments.filter or re.match(arguments.filter, name)]
        if names and not arguments.node_name:
            print(f"{target}:")
        types = {}
        if arguments.param_type:
            response = _ask(node, target, "DescribeParameters", "describe_parameters", names=names)
            types = {item.name: _TYPES[item.type] for item in response.descriptors}
        for name in names:
            print(f"  {name} (type: {types[name]})" if arguments.param_type else f"  {name}")


def _values(node: Any, target: str, names: list[str]) -> list[Any] | None:
    response = _ask(node, target, "GetParameters", "get_parameters", names=names)
    return None if response is None else list(response.values)


def _get(node: Any, arguments: argparse.Namespace) -> str | None:
    from rclpy.parameter import parameter_value_to_python  # noqa: PLC0415  the help starts without it

    values = _values(node, arguments.node_name, [arguments.parameter_name])
    if values is None:
        return f"no answer from the parameter services of {arguments.node_name}"
    if not values:
        return "Parameter not set"
    value = parameter_value_to_python(values[0])
    if value is None:
        print("None" if arguments.hide_type else "Parameter not set.")
    elif arguments.hide_type:
        print(value)
    else:
        print(_LABELS[values[0].type], value)
    return None


def _set(node: Any, arguments: argparse.Namespace) -> str | None:
    from rcl_interfaces.msg import Parameter  # noqa: PLC0415  classes are made on first use
    from rclpy.parameter import get_parameter_value  # noqa: PLC0415  the help starts without it

    parameter = Parameter(name=arguments.parameter_name, value=get_parameter_value(arguments.value))
    response = _ask(node, arguments.node_name, "SetParameters", "set_parameters", parameters=[parameter])
    if response is None:
        return f"no answer from the parameter services of {arguments.node_name}"
    _report(response.results[0])
    return None


def _report(result: Any, name: str = "") -> None:
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        print(f"Set parameter {name + ' ' if name else ''}successful{reason}")
    else:
        print(f"Setting parameter {name + ' ' if name else ''}failed{reason}", file=sys.stderr)


def _describe(node: Any, arguments: argparse.Namespace) -> str | None:
    response = _ask(
        node, arguments.node_name, "DescribeParameters", "describe_parameters", names=arguments.parameter_names
    )
    if response is None:
        return f"no answer from the parameter services of {arguments.node_name}"
    for descriptor in response.descriptors:
        print("Parameter name:", descriptor.name)
        print("  Type:", _TYPES[descriptor.type])
        if descriptor.description:
            print("  Description:", descriptor.description)
        print("  Constraints:")
        if descriptor.read_only:
            print("    Read only: true")
        for limits in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
            print("    Min value:", limits.from_value)
            print("    Max value:", limits.to_value)
            if limits.step:
                print("    Step:", limits.step)
        if descriptor.additional_constraints:
            print("    Additional constraints:", descriptor.additional_constraints)
    return None


def _dump(node: Any, arguments: argparse.Namespace) -> str | None:
    from rclpy.parameter import parameter_value_to_python  # noqa: PLC0415  the help starts without it

    names = _names(node, arguments.node_name, [])
    values = None if names is None else _values(node, arguments.node_name, names)
    if names is None or values is None:
        return f"no answer from the parameter services of {arguments.node_name}"
    tree: dict[str, Any] = {}
    for name, value in zip(names, values, strict=False):
        *groups, last = name.split(".")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = parameter_value_to_python(value)
    print(yaml.dump({arguments.node_name: {"ros__parameters": tree}}, default_flow_style=False))
    return None


def _load(node: Any, arguments: argparse.Namespace) -> str | None:
    from rclpy.parameter import parameter_dict_from_yaml_file  # noqa: PLC0415  the help starts without it

    try:
        parameters = parameter_dict_from_yaml_file(
            arguments.parameter_file, not arguments.no_use_wildcard, target_nodes=[arguments.node_name]
        )
    except RuntimeError as error:
        return str(error)
    response = _ask(node, arguments.node_name, "SetParameters", "set_parameters", parameters=list(parameters.values()))
    if response is None:
        return f"no answer from the parameter services of {arguments.node_name}"
    for name, result in zip(parameters, response.results, strict=True):
        _report(result, name)
    return None
