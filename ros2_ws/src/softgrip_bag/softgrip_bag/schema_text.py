# SPDX-License-Identifier: Apache-2.0
"""The `ros2msg` schema text of a type: its definition followed by those of everything it contains.

Source: MCAP specification, appendix "Schema encodings", `ros2msg`; the same text that rosbag2_storage_mcap writes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from softgrip_bag.errors import BagError

#: (package, kind, name) -> text of the .msg file; kind is "msg", "srv" or "action".
FindInterface = Callable[[str, str, str], str]

SEPARATOR = "=" * 80
PRIMITIVES = frozenset(
    ["bool", "byte", "char", "float32", "float64", "string", "wstring"]
    + [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
)
_FIELD = re.compile(r"^\s*(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*(?P<rest>.*)$")


def schema_text(type_name: str, find: FindInterface) -> str:
    """Return the schema text of a type.

    Args:
        type_name: e.g. "sensor_msgs/msg/JointState".
        find: gives the text of an interface file.

    Raises:
        BagError: when a definition cannot be found.
    """
    package, kind, name = _split(type_name)
    own = _derived(package, kind, name, find)
    parts = [(own.get(name) or find(package, kind, name)).strip("\n")]
    done = {(package, name)}
    pending = list(referenced(parts[0], package))
    while pending:
        reference = pending.pop(0)
        if reference in done:
            continue
        done.add(reference)
        text = (own.get(reference[1]) or find(reference[0], "msg", reference[1])).strip("\n")
        scope = f"{reference[0]}/{kind}" if reference[1] in own else reference[0]
        parts.append(f"{SEPARATOR}\nMSG: {scope}/{reference[1]}\n{text}")
        pending += referenced(text, reference[0])
    return "\n".join(parts) + "\n"


def referenced(text: str, package: str) -> Iterator[tuple[str, str]]:
    """Yield (package, name) of every message type that a definition's fields name."""
    for line in text.splitlines():
        named = _message_type(line)
        if named is not None:
            scope, _, name = named.rpartition("/")
            yield (scope.split("/")[0] if scope else package), name


def _message_type(line: str) -> str | None:
    """The message type that a line's field has, as it is written there; None: a primitive, a constant, or no field."""
    match = _FIELD.match(line.split("#", 1)[0])
    if match is None or match["type"] in PRIMITIVES or match["rest"].lstrip().startswith("="):
        return None
    return match["type"]


def same_definition(one: str, other: str) -> bool:
    """Return whether two schema texts say the same, apart from comments, blanks and the order of their parts."""
    return _parts(one) == _parts(other)


def _parts(text: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for number, part in enumerate(re.split(r"(?m)^={80}$", text)):
        lines = [" ".join(line.split("#", 1)[0].replace("=", " = ").split()) for line in part.splitlines()]
        lines = [line for line in lines if line]
        name = lines.pop(0) if number and lines else ""
        found[name] = [line.replace(" = ", "=") for line in lines]
    return found


def _derived(package: str, kind: str, name: str, find: FindInterface) -> dict[str, str]:
    """Definitions that rosidl derives for an action's feedback and a service's events.

    Their names keep the kind. A field of theirs that names a type without its package means a message, and gets the
    package: readers look for a bare name among the types of the same kind.
    """
    base, _, suffix = name.rpartition("_")

    def halves() -> list[str]:
        return [_with_packages(half, package) for half in _halves(find(package, kind, base))]

    if kind == "action":
        if suffix != "FeedbackMessage":
            raise BagError(f"expected the feedback message of an action, found {package}/action/{name}")
        feedback = halves()[2]
        fields = f"unique_identifier_msgs/UUID goal_id\n{package}/action/{base}_Feedback feedback"
        return {name: fields, f"{base}_Feedback": feedback}
    if kind == "srv":
        if suffix != "Event":
            raise BagError(f"expected the events of a service, found {package}/srv/{name}")
        request, response = halves()[:2]
        fields = (
            "service_msgs/ServiceEventInfo info\n"
            f"{package}/srv/{base}_Request[<=1] request\n{package}/srv/{base}_Response[<=1] response"
        )
        return {name: fields, f"{base}_Request": request, f"{base}_Response": response}
    return {}


def _with_packages(text: str, package: str) -> str:
    bare = [(line, "/" not in (_message_type(line) or "/")) for line in text.split("\n")]
    return "\n".join(f"{package}/{line.lstrip()}" if is_bare else line for line, is_bare in bare)


def _halves(text: str) -> list[str]:
    """The parts of a service or action; an empty one is a blank line, so that it is told from a missing one."""
    return [part.strip("\n") or "\n" for part in re.split(r"(?m)^---\s*$", text)]


def _split(type_name: str) -> tuple[str, str, str]:
    parts = type_name.split("/")
    if len(parts) != 3:
        raise BagError(f"expected a type like 'std_msgs/msg/String', found {type_name!r}")
    return parts[0], parts[1], parts[2]
