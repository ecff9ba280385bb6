# SPDX-License-Identifier: Apache-2.0
"""Names of ROS 2: what is valid, how relative and private names expand, and remapping (design.ros2.org topic names)."""

from __future__ import annotations

import re
from dataclasses import dataclass

_MAX_NODE_NAME = 255
_MAX_TOPIC_NAME = 247


def topic_problem(name: str) -> tuple[str, int] | None:  # noqa: PLR0911  one rule each
    """Return what is wrong with a topic or service name as typed and at which index; None when it is valid."""
    if not name:
        return "topic name must not be empty string", 0
    if name.endswith("/"):
        return "topic name must not end with a forward slash", len(name) - 1
    if match := re.search(r"[^\w/~{}]", name, re.ASCII):
        return "topic name must not contain characters other than alphanumerics, '_', '~', '{', or '}'", match.start()
    if (index := name.find("~", 1)) > 0:
        return "topic name must not have tilde (~) unless it is the first character", index
    if name.startswith("~") and len(name) > 1 and name[1] != "/":
        return "topic name must not have a tilde (~) not followed by a forward slash (/)", 1
    if (found := _brace_problem(name)) is not None:
        return found
    if match := re.search(r"//", name):
        return "topic name must not contain repeated forward slashes", match.start()
    if match := re.search(r"(?:^|/)(\d)", name):
        return "topic name token must not start with a number", match.start(1)
    return None


def _brace_problem(name: str) -> tuple[str, int] | None:
    opened = -1
    for index, char in enumerate(name):
        if char == "{":
            if opened >= 0:
                return "substitution name must not contain characters other than alphanumerics or '_'", index
            opened = index
        elif char == "}":
            if opened < 0:
                return "topic name has unbalanced curly braces ({})", index
            inner = name[opened + 1 : index]
            if re.match(r"\d", inner):
                return "substitution name must not start with a number", opened + 1
            if not re.fullmatch(r"\w*", inner, re.ASCII):
                return "substitution name must not contain characters other than alphanumerics or '_'", opened + 1
            opened = -1
        elif opened >= 0 and char in "~/":
            return "substitution name must not contain characters other than alphanumerics or '_'", index
    return ("topic name has unbalanced curly braces ({})", opened) if opened >= 0 else None


def full_topic_problem(name: str) -> tuple[str, int] | None:
    """Return what is wrong with a fully qualified name; None when it is valid."""
    if (found := _absolute_problem(name, "topic name", "")) is not None:
        return found
    if len(name) > _MAX_TOPIC_NAME:
        return f"topic length should not exceed '{_MAX_TOPIC_NAME}'", _MAX_TOPIC_NAME
    return None


def namespace_problem(name: str) -> tuple[str, int] | None:
    """Return what is wrong with a namespace; None when it is valid."""
    return None if name == "/" else _absolute_problem(name, "namespace", ", unless only a '/'")


def _absolute_problem(name: str, noun: str, unless: str) -> tuple[str, int] | None:  # noqa: PLR0911  one rule each
    if not name:
        return f"{noun} must not be empty", 0
    if not name.startswith("/"):
        return f"{noun} must be absolute, it must lead with a '/'", 0
    if name.endswith("/"):
        return f"{noun} must not end with a '/'{unless}", len(name) - 1
    if match := re.search(r"[^\w/]", name, re.ASCII):
        return f"{noun} must not contain characters other than alphanumerics, '_', or '/'", match.start()
    if match := re.search(r"//", name):
        return f"{noun} must not contain repeated '/'", match.start() + 1
    if match := re.search(r"/(\d)", name):
        return f"{noun} must not have a token that starts with a number", match.start(1)
    return None


def node_problem(name: str) -> tuple[str, int] | None:
    """Return what is wrong with a node name; None when it is valid."""
    if not name:
        return "node name must not be empty", 0
    if match := re.search(r"\W", name, re.ASCII):
        return "node name must not contain characters other than alphanumerics or '_'", match.start()
    if name[0].isdigit():
        return "node name must not start with a number", 0
    if len(name) > _MAX_NODE_NAME:
        return f"node name length should not exceed '{_MAX_NODE_NAME}'", _MAX_NODE_NAME - 1
    return None


def expand(name: str, node_name: str, namespace: str) -> str:
    """Return the fully qualified form of a topic or service name; KeyError for an unknown substitution."""
    values = {"node": node_name, "ns": namespace.strip("/"), "namespace": namespace.strip("/")}
    name = re.sub(r"\{(\w*)\}", lambda match: values[match[1]], name)
    base = namespace.rstrip("/")
    if name.startswith("~"):
        return f"{base}/{node_name}{name[1:]}"
    return name if name.startswith("/") else f"{base}/{name}"


@dataclass(frozen=True)
class Remap:
    """One ``[node:]from:=to`` rule; ``kind`` is node, namespace, topic, service or any."""

    source: str
    target: str
    node: str = ""
    kind: str = "any"


def parse_remap(text: str) -> Remap:
    """Read a remap rule; ValueError with what was expected when it is none."""
    left, separator, target = text.partition(":=")
    if not separator or not left or not target:
        raise ValueError(f"expected 'from:=to' or 'node:from:=to', found {text!r}")
    kind = "any"
    node = ""
    if match := re.match(r"(\w+):(?!//)(.+)$", left):
        node, left = match[1], match[2]
    if match := re.match(r"(rostopic|rosservice)://(.+)$", left):
        kind, left = {"rostopic": "topic", "rosservice": "service"}[match[1]], match[2]
    if left in {"__node", "__name"}:
        if problem := node_problem(target):
            raise ValueError(f"{text!r}: {problem[0]}")
        return Remap(left, target, node, "node")
    if left == "__ns":
        if problem := namespace_problem(target):
            raise ValueError(f"{text!r}: {problem[0]}")
        return Remap(left, target, node, "namespace")
    for side in (left, target):
        if problem := topic_problem(side):
            raise ValueError(f"{text!r}: {problem[0]}")
    return Remap(left, target, node, kind)


def remap_name(full_name: str, kind: str, node_name: str, namespace: str, rules: list[Remap]) -> str:
    """Apply the first rule that matches a fully qualified topic or service name."""
    for rule in rules:
        concerned = rule.kind in {"any", kind} and rule.node in {"", node_name}
        if concerned and expand(rule.source, node_name, namespace) == full_name:
            return expand(rule.target, node_name, namespace)
    return full_name
