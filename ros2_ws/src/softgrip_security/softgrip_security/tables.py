# SPDX-License-Identifier: Apache-2.0
"""Write a policy as tables for people: docs/security.md."""

from __future__ import annotations

from collections.abc import Iterable

from softgrip_security.policy import EVERY_TOPIC, Grant, Policy, PolicyIdentity

#: What every node has; left out of the tables.
_OF_EVERY_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "ping",
    "set_parameters",
    "set_parameters_atomically",
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
)
_TOPICS_OF_EVERY_NODE = ("/rosout", "/parameter_events", "/clock", "/diagnostics")
#: More names than this are a count.
_MAX_NAMES = 28


def policy_tables(policy: Policy) -> str:
    """Return one Markdown table for the nodes and one for the tools."""
    nodes = [one for one in policy.identities if not one.is_tool]
    tools = [one for one in policy.identities if one.is_tool]
    return f"{_table('node', nodes)}\n\n{_table('tool', tools)}\n"


def _table(title: str, identities: Iterable[PolicyIdentity]) -> str:
    lines = [f"| {title} | publishes | subscribes | serves | calls |", "|---|---|---|---|---|"]
    lines += [
        f"| {one.name} | {_cell(one, Grant.PUBLISH)} | {_cell(one, Grant.SUBSCRIBE)} "
        f"| {_cell(one, Grant.SERVE, Grant.SERVE_ACTION)} | {_cell(one, Grant.CALL, Grant.CALL_ACTION)} |"
        for one in identities
    ]
    return "\n".join(lines)


def _cell(identity: PolicyIdentity, plain: Grant, action: Grant | None = None) -> str:
    names = [name for name in identity.names(plain) if not _is_of_every_node(name)]
    if EVERY_TOPIC in names:
        return "every topic"
    texts = [name.strip("/") for name in names]
    if action is not None:
        texts += [f"{name.strip('/')} (action)" for name in identity.names(action)]
    if len(texts) > _MAX_NAMES:
        return f"{len(texts)} names"
    return ", ".join(texts)


def _is_of_every_node(name: str) -> bool:
    return name in _TOPICS_OF_EVERY_NODE or name.rpartition("/")[2] in _OF_EVERY_NODE
