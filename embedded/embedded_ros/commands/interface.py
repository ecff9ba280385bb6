# SPDX-License-Identifier: Apache-2.0
"""``ros2 interface``."""

from __future__ import annotations

import argparse
import math
import re
from typing import TYPE_CHECKING

from embedded_ros.errors import UnknownInterfaceError

if TYPE_CHECKING:
    from embedded_ros.registry import Registry

_TITLES = {"msg": "Messages:", "srv": "Services:", "action": "Actions:"}


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    from embedded_ros.registry import registry  # noqa: PLC0415  the overview of commands starts without it

    parser = argparse.ArgumentParser(prog="ros2 interface", description="Show message, service and action definitions.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    show = verbs.add_parser("show", help="output the interface definition")
    show.add_argument("type", help="interface, such as sensor_msgs/msg/JointState")
    comments = show.add_mutually_exclusive_group()
    comments.add_argument("--all-comments", action="store_true", help="show the comments of nested messages as well")
    comments.add_argument("--no-comments", action="store_true", help="show no comments")
    listing = verbs.add_parser("list", help="list all interface types available")
    for kind in _TITLES:
        listing.add_argument(f"-{kind[0]}", f"--only-{kind}s", dest=kind, action="store_true", help=f"only {kind}")
    package = verbs.add_parser("package", help="output a list of available interface types within one package")
    package.add_argument("package_name", help="name of the package")
    verbs.add_parser("packages", help="output a list of packages that provide interfaces")
    proto = verbs.add_parser("proto", help="output an interface prototype")
    proto.add_argument("type", help="interface, such as std_srvs/srv/SetBool")
    arguments = parser.parse_args(argv)
    known = registry()
    if arguments.verb == "show":
        known.interface(arguments.type)  # says what does not parse
        deepest = -1 if arguments.no_comments else math.inf if arguments.all_comments else 0
        print("\n".join(_lines(known, arguments.type, 0, comments_to=deepest)))
    elif arguments.verb == "packages":
        print("\n".join(sorted(known.packages())))
    elif arguments.verb == "package":
        print("\n".join(f"{arguments.package_name}/{kind}/{name}" for kind in _TITLES
                        for name in known.names(arguments.package_name, kind)))  # fmt: skip
    elif arguments.verb == "list":
        requested = [kind for kind in _TITLES if getattr(arguments, kind)] or list(_TITLES)
        for kind in requested:
            print(_TITLES[kind])
            for name in sorted(known.packages()):
                for item in known.names(name, kind):
                    print(f"    {name}/{kind}/{item}")
    else:
        return _proto(known, arguments.type)
    return None


def _lines(known: Registry, full_name: str, depth: int, *, comments_to: float) -> list[str]:
    """Return the text with nested messages indented under the fields that use them, with comments down to a depth."""
    from embedded_ros.interface_text import parse_type  # noqa: PLC0415  as above
    from embedded_ros.registry import split_name  # noqa: PLC0415  as above

    package, kind, name = split_name(full_name, known)
    result = []
    for line in known.path(f"{package}/{kind}/{name}").read_text(encoding="utf-8").splitlines():
        text = line.rstrip() if depth <= comments_to else re.sub(r"\s*#.*$", "", line)
        if not text.strip() and depth > comments_to:
            continue
        result.append("\t" * depth + text if text else "")
        match = re.match(r"([\w/<=]+(?:\[[^\]]*\])?)\s+[a-z]\w*", re.sub(r"\s*#.*$", "", line))
        if match:
            field = parse_type(match[1], package, full_name)
            if not field.primitive:
                result += _lines(known, field.base, depth + 1, comments_to=comments_to)
    return result


def _proto(known: Registry, full_name: str) -> str | None:
    from embedded_ros.text_form import to_yaml  # noqa: PLC0415  the rest starts without it

    kind = known.interface(full_name)
    for part in ("Request", "Goal"):
        kind = getattr(kind, part, kind)
    try:
        print(f'"{to_yaml(kind())}"')
    except NotImplementedError as error:
        raise UnknownInterfaceError(str(error)) from error
    return None
