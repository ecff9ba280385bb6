# SPDX-License-Identifier: Apache-2.0
"""Topics, services and actions of the cell, and the messages that they carry.

Who makes what is read from the source of the nodes; the meaning is the table of docs/architecture.md.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from generated.markdown import ROOT, WORKSPACE, code, table
from softgrip_security.policy import EVERY_TOPIC, Grant, read_policy

#: What makes an endpoint -> its kind, and which positional argument is its name; the type stands before the name.
MAKERS = {
    "create_publisher": ("topic", 1),
    "create_subscription": ("topic", 1),
    "create_service": ("service", 1),
    "UrgentServer": ("service", 2),
    "create_client": ("service", 1),
    "ActionServer": ("action", 2),
    "create_action_server": ("action", 1),
    "ActionClient": ("action", 2),
}
OF_EVERY_NODE = ("/rosout", "/parameter_events", "/clock", "/diagnostics")
PRESETS = ("SENSOR", "RELIABLE", "LATCHED")


@dataclass
class Endpoint:
    """One topic, service or action."""

    kind: str
    name: str
    types: set[str] = field(default_factory=set)
    qos: set[str] = field(default_factory=set)


@functools.cache
def endpoints() -> dict[tuple[str, str], Endpoint]:
    """Return what the nodes make under a name that stands in their source, by kind and name."""
    found: dict[tuple[str, str], Endpoint] = {}
    for path in sorted(WORKSPACE.glob("*/*/nodes/*.py")):
        if "softgrip_testing" in path.parts:
            continue
        for kind, name, type_name, qos in _made(ast.parse(path.read_text(encoding="utf-8"))):
            one = found.setdefault((kind, name), Endpoint(kind, name))
            one.types.add(type_name)
            one.qos |= qos
    return found


def _made(tree: ast.Module) -> Iterator[tuple[str, str, str, set[str]]]:
    packages = {
        alias.asname or alias.name: (node.module or "").rpartition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        kind, position = MAKERS.get(called, ("", 0))
        if not kind or len(node.args) <= position:
            continue
        given, type_node = node.args[position], node.args[position - 1]
        if isinstance(given, ast.Constant) and isinstance(given.value, str) and isinstance(type_node, ast.Name):
            presets = {argument.id for argument in node.args if isinstance(argument, ast.Name)} & set(PRESETS)
            package = packages.get(type_node.id, "")
            yield kind, given.value, f"{package}/{type_node.id}" if package else type_node.id, presets


def meanings() -> dict[str, str]:
    """Return name -> meaning of the table in docs/architecture.md."""
    text = (
        (ROOT / "docs/architecture.md").read_text(encoding="utf-8").partition("## Interfaces")[2].partition("\n## ")[0]
    )
    found = {}
    for names, _, meaning in re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", text, re.MULTILINE):
        for name in names.split(","):
            found[name.strip()] = re.sub(r"\]\(([a-z_]+\.md)", r"](../../\1", meaning.strip())
    return found


def topics_page() -> str:
    """Return the page of topics, services and actions."""
    policy, meaning = read_policy(), meanings()
    nodes = [one for one in policy.identities if not one.is_tool]

    def who(grant: Grant, name: str) -> str:
        full = "/" + name.strip("/")
        return ", ".join(
            one.name for one in nodes if full in one.names(grant) or (full.startswith("/~") and grant is Grant.PUBLISH)
        )

    everybody = ", ".join(one.name for one in nodes if EVERY_TOPIC in one.names(Grant.SUBSCRIBE))
    rows: dict[str, list[list[str]]] = {"topic": [], "service": [], "action": []}
    for (kind, name), one in sorted(endpoints().items()):
        if name in OF_EVERY_NODE or name.startswith("~"):
            continue
        types = "<br>".join(sorted(one.types))
        if kind == "topic":
            qos = ", ".join(sorted(one.qos)).lower()
            row = [code(name), types, who(Grant.PUBLISH, name), who(Grant.SUBSCRIBE, name), qos, meaning.get(name, "")]
        else:
            serve, call = (Grant.SERVE, Grant.CALL) if kind == "service" else (Grant.SERVE_ACTION, Grant.CALL_ACTION)
            row = [code(name), types, who(serve, name), who(call, name), meaning.get(name, "")]
        rows[kind].append(row)
    parts = [
        "# Topics, services, actions\n",
        "Names are relative to the cell's namespace. Who publishes, subscribes, serves and calls is what the shipped",
        f"access policy allows; {everybody} may subscribe to every topic. Types: [messages](interfaces.md).\n",
        "## Topics\n",
        table(("name", "type", "published by", "subscribed by", "QoS preset", "meaning"), rows["topic"]),
        "\n## Services\n",
        table(("name", "type", "served by", "called by", "meaning"), rows["service"]),
        "\n## Actions\n",
        table(("name", "type", "served by", "called by", "meaning"), rows["action"]),
        "\n## What every node has\n",
        table(
            ("name", "type", "meaning"),
            [
                (code("~/ping"), "std_srvs/Trigger", "answered by its executor"),
                (
                    code("~/input_notes"),
                    "softgrip_interfaces/InputNote",
                    meaning.get("kinematics_predictor/input_notes", ""),
                ),
                (code("~/trace"), "softgrip_interfaces/NodeTrace", meaning.get("grasp_mix_manager/trace", "")),
                (code("/diagnostics"), "diagnostic_msgs/DiagnosticArray", meaning.get("/diagnostics", "")),
            ],
        ),
    ]
    return "\n".join(parts)


def types_page() -> str:
    """Return the page of message, service and action types."""
    parts = [
        "# Messages\n",
        "The types of softgrip_interfaces, from their own files. Every number has its unit in brackets.\n",
    ]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        parts.append(f"## {title}\n")
        for path in sorted((WORKSPACE / "softgrip_interfaces" / kind).glob(f"*.{kind}")):
            parts.append(f"### {path.stem}\n")
            parts.append(_fields(path.read_text(encoding="utf-8"), kind))
    return "\n".join(parts)


_SECTIONS = {"msg": ("",), "srv": ("request", "response"), "action": ("goal", "result", "feedback")}


def _fields(text: str, kind: str) -> str:
    made = []
    for title, section in zip(_SECTIONS[kind], re.split(r"^---$", text, flags=re.MULTILINE), strict=True):
        remarks, rows = _rows(section)
        if title:
            made.append(f"**{title.capitalize()}**\n")
        if remarks:
            made.append(f"{remarks}\n")
        made.append(table(("field", "type", "meaning"), rows) if rows else "no fields\n")
    return "\n".join(made)


def _rows(section: str) -> tuple[str, list[tuple[str, str, str]]]:
    remarks: list[str] = []
    rows: list[tuple[str, str, str]] = []
    for line in section.splitlines():
        declared, _, comment = line.partition("#")
        words = declared.split(None, 1)
        if len(words) == 2:
            rows.append((code(words[1].strip()), words[0], comment.strip()))
        elif comment and rows:  # a comment that goes on
            rows[-1] = (*rows[-1][:2], f"{rows[-1][2]} {comment.strip()}")
        elif comment:
            remarks.append(comment.strip())
    return " ".join(remarks), rows
