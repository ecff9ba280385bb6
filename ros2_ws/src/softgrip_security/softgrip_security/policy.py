# SPDX-License-Identifier: Apache-2.0
"""Read access.yaml: the grants of each identity, with all names in full."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import yaml

from softgrip_security.errors import SecurityError

#: The policy that the package ships.
SHIPPED = Path(__file__).parent / "data" / "access.yaml"
#: The identity of the router, which carries nothing: peers only learn from it where the others are.
ROUTER = "router"
EVERY_TOPIC = "*"
_NODE = "{node}"
_PUBLISHED = "{published}"
_VERSION = 1
_NAME = re.compile(r"(?:/|~/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
_IDENTITY = re.compile(r"[a-z][a-z0-9_]*")
_NODE_PATTERN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\*?")
_NAMESPACE = re.compile(r"/|(?:/[A-Za-z_][A-Za-z0-9_]*)+")


class Grant(StrEnum):
    """What an identity may be allowed to do with a name."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    SERVE = "serve"
    CALL = "call"
    SERVE_ACTION = "serve_action"
    CALL_ACTION = "call_action"


#: The five endpoints of an action beside its name (design.ros2.org, actions).
ACTION_SERVICES = ("send_goal", "cancel_goal", "get_result")
ACTION_TOPICS = ("feedback", "status")


@dataclass(frozen=True)
class PolicyIdentity:
    """Who one certificate stands for.

    Attributes:
        name: its name in the policy; the last part of its enclave.
        node_names: names of its nodes; a trailing * stands for any end.
        grants: fully qualified names by grant; EVERY_TOPIC among the subscriptions stands for all topics.
        is_tool: whether a person holds it, not a node of the cell.
    """

    name: str
    node_names: tuple[str, ...]
    grants: Mapping[Grant, tuple[str, ...]] = field(default_factory=dict)
    is_tool: bool = False

    @property
    def enclave(self) -> str:
        """Return the enclave (SROS2), which is also the common name of the certificate."""
        return f"/softgrip/{self.name}"

    def names(self, grant: Grant) -> tuple[str, ...]:
        """Return the fully qualified names that it may do this with."""
        return self.grants.get(grant, ())

    def topics(self, grant: Grant) -> tuple[str, ...]:
        """Return topics to PUBLISH or to SUBSCRIBE, with those of its actions."""
        action = Grant.SERVE_ACTION if grant is Grant.PUBLISH else Grant.CALL_ACTION
        return _sorted([*self.names(grant), *_parts(self.names(action), ACTION_TOPICS)])

    def services(self, grant: Grant) -> tuple[str, ...]:
        """Return services to SERVE or to CALL, with those of its actions."""
        action = Grant.SERVE_ACTION if grant is Grant.SERVE else Grant.CALL_ACTION
        return _sorted([*self.names(grant), *_parts(self.names(action), ACTION_SERVICES)])


@dataclass(frozen=True)
class Policy:
    """All identities of a cell, in its namespace."""

    identities: tuple[PolicyIdentity, ...]
    namespace: str = "/"

    def identity(self, name: str) -> PolicyIdentity:
        """Return one identity.

        Raises:
            SecurityError: there is none of this name.
        """
        for one in self.identities:
            if one.name == name:
                return one
        known = ", ".join(one.name for one in self.identities)
        raise SecurityError(f"identity: expected one of {known}; found {name!r}")


def read_policy(path: Path = SHIPPED, namespace: str = "/") -> Policy:
    """Return the policy of a file.

    Args:
        path: access.yaml, or a file of its form.
        namespace: of the cell; relative names are below it.

    Raises:
        SecurityError: the file cannot be read or is not of that form.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SecurityError(f"{path}: expected a policy in YAML, found: {error}") from error
    try:
        return _Reader(document, namespace).policy()
    except SecurityError as error:
        raise SecurityError(f"{path}: {error}") from error


class _Reader:
    """Turns the document into a policy; each method checks what it reads."""

    def __init__(self, document: object, namespace: str) -> None:
        self._document = _mapping(document, "the file", ("version", "withheld", "groups", "nodes", "tools"))
        if self._document.get("version") != _VERSION:
            raise SecurityError(f"version: expected {_VERSION}, found {self._document.get('version')!r}")
        if not _NAMESPACE.fullmatch(namespace):
            raise SecurityError(f"namespace: expected / or a name such as /cell_1, found {namespace!r}")
        self._namespace = namespace
        self._groups = _mapping(self._document.get("groups", {}), "groups")
        self._nodes = _mapping(self._document.get("nodes", {}), "nodes")
        self._tools = _mapping(self._document.get("tools", {}), "tools")
        self._node_names = [self._full(one) for name, body in self._nodes.items() for one in _node_names(name, body)]

    def policy(self) -> Policy:
        found = [self._identity(name, body, is_tool=False) for name, body in self._nodes.items()]
        found += [self._identity(name, body, is_tool=True) for name, body in self._tools.items()]
        names = [one.name for one in found]
        if repeated := {name for name in names if names.count(name) > 1 or name == ROUTER}:
            raise SecurityError(f"identities: expected different names, none of them 'router'; found {repeated} again")
        withheld = {self._full(name) for name in _names(self._document.get("withheld", []), "withheld")}
        published = [topic for one in found if not one.is_tool for topic in one.topics(Grant.PUBLISH)]
        open_topics = [topic for topic in published if topic not in withheld]
        return Policy(tuple(_with_published(one, open_topics) for one in found), self._namespace)

    def _identity(self, name: object, body: object, *, is_tool: bool) -> PolicyIdentity:
        if not isinstance(name, str) or not _IDENTITY.fullmatch(name):
            raise SecurityError(f"identity: expected a name of a-z, 0-9 and _, found {name!r}")
        body = _mapping(body, name, ("groups", "named", *Grant))
        named = _strings(body.get("named", []), f"{name}: named")  # beside its own name
        if wrong := [one for one in named if not _NODE_PATTERN.fullmatch(one)]:
            raise SecurityError(f"{name}: named: expected node names, at most with * at the end; found {wrong}")
        own = [] if is_tool else [name, f"{name}_*"]
        grants = self._grants(body, name, ())
        full = {
            grant: _sorted(full for one in names for full in self._expand(one, [name, *named]))
            for grant, names in grants.items()
        }
        return PolicyIdentity(name, (*own, *named), full, is_tool)

    def _grants(self, body: Mapping[str, object], where: str, inside: tuple[str, ...]) -> dict[Grant, list[str]]:
        """Return what a body and its groups grant, as written."""
        found = {grant: _names(body.get(grant, []), f"{where}: {grant}") for grant in Grant}
        for group in _strings(body.get("groups", []), f"{where}: groups"):
            if group not in self._groups or group in inside:
                known = ", ".join(sorted(set(self._groups) - set(inside)))
                raise SecurityError(f"{where}: groups: expected one of {known}; found {group!r}")
            below = _mapping(self._groups[group], f"groups: {group}", ("groups", *Grant))
            for grant, names in self._grants(below, f"groups: {group}", (*inside, group)).items():
                found[grant] += names
        elsewhere = {name for grant in Grant if grant is not Grant.SUBSCRIBE for name in found[grant]}
        if several := elsewhere & {EVERY_TOPIC, _PUBLISHED}:
            raise SecurityError(f"{where}: expected names, found {several}, which only subscribe may have")
        return found

    def _expand(self, name: str, nodes: Iterable[str]) -> Iterable[str]:
        if name.startswith(f"{_NODE}/"):
            return [f"{node}{name.removeprefix(_NODE)}" for node in self._node_names]
        if name in {EVERY_TOPIC, _PUBLISHED}:
            return [name]
        if name.startswith("~"):
            return [f"{self._full(node)}{name[1:]}" for node in nodes if not node.endswith("*")]
        return [self._full(name)]

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._namespace.rstrip('/')}/{name}"


def _node_names(name: object, body: object) -> list[str]:
    """Return the names of an identity's nodes that are known in full."""
    named = body.get("named", []) if isinstance(body, dict) else []
    return [str(name), *(str(one) for one in named if not str(one).endswith("*"))]


def _with_published(identity: PolicyIdentity, topics: Iterable[str]) -> PolicyIdentity:
    """Return the identity with {published} among its subscriptions filled in."""
    subscribed = identity.names(Grant.SUBSCRIBE)
    if _PUBLISHED not in subscribed:
        return identity
    names = _sorted([*(name for name in subscribed if name != _PUBLISHED), *topics])
    return PolicyIdentity(
        identity.name, identity.node_names, {**identity.grants, Grant.SUBSCRIBE: names}, is_tool=identity.is_tool
    )


def _parts(actions: Iterable[str], parts: Iterable[str]) -> list[str]:
    return [f"{action}/_action/{part}" for action in actions for part in parts]


def _sorted(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted(set(names)))


def _mapping(value: object, where: str, keys: Iterable[str] | None = None) -> Mapping[str, object]:
    if not isinstance(value, dict):
        raise SecurityError(f"{where}: expected a mapping, found {type(value).__name__}")
    if keys is not None and (unknown := set(value) - set(keys)):
        raise SecurityError(f"{where}: expected only {', '.join(keys)}; found {sorted(map(str, unknown))}")
    return value


def _strings(value: object, where: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise SecurityError(f"{where}: expected a list of names, found {value!r}")
    return list(value)


def _names(value: object, where: str) -> list[str]:
    names = _strings(value, where)
    for name in names:
        plain = name.removeprefix(f"{_NODE}/")
        if name not in {EVERY_TOPIC, _PUBLISHED} and not _NAME.fullmatch(plain):
            raise SecurityError(f"{where}: expected names of topics, services or actions, found {name!r}")
    return names
