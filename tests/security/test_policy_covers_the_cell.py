# SPDX-License-Identifier: Apache-2.0
"""The policy has a place for every interface: of the documentation's table, and of what the nodes' source makes."""

from __future__ import annotations

import ast
import configparser
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from softgrip_panel.model.acts import EXAMPLES, Act, CallKind
from softgrip_security.policy import Grant, Policy, PolicyIdentity
from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = ROOT / "ros2_ws" / "src"
ARCHITECTURE = ROOT / "docs" / "architecture.md"

#: Processes that others wrote.
OF_OTHERS = {"thermometer"}
#: What makes an endpoint, what it is, and which positional argument is its name.
MAKERS = {
    "create_publisher": (Grant.PUBLISH, 1),
    "create_subscription": (Grant.SUBSCRIBE, 1),
    "subscription": (Grant.SUBSCRIBE, 1),
    "create_service": (Grant.SERVE, 1),
    "service": (Grant.SERVE, 1),
    "UrgentServer": (Grant.SERVE, 2),
    "create_client": (Grant.CALL, 1),
    "client": (Grant.CALL, 1),
    "call": (Grant.CALL, 1),
    "ActionServer": (Grant.SERVE_ACTION, 2),
    "action_server": (Grant.SERVE_ACTION, 1),
    "ActionClient": (Grant.CALL_ACTION, 2),
    "action_client": (Grant.CALL_ACTION, 1),
    "act": (Grant.CALL_ACTION, 1),
}
NAME = re.compile(r"(?:~/|/)?[a-z_]+(?:/[a-z_]+)*")


def executables() -> dict[str, Path]:
    """Return the module of each executable of the workspace that is a node."""
    found = {}
    for path in sorted(WORKSPACE.glob("*/setup.cfg")):
        setup = configparser.ConfigParser()
        setup.read(path)
        scripts = setup.get("options.entry_points", "console_scripts", fallback="")
        for line in filter(None, map(str.strip, scripts.splitlines())):
            name, module = (part.strip() for part in line.split("="))
            # an executable of bringup is a module of another package
            file = WORKSPACE / module.partition(".")[0] / (module.partition(":")[0].replace(".", "/") + ".py")
            if file.parent.name == "nodes":
                found[name] = file
    return found


def own_modules(start: Path) -> set[Path]:
    """Return a node's module and those below nodes/ that it imports, also of other packages."""
    found, waiting = set(), [start]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("softgrip_"):
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in names:
                file = WORKSPACE / name.split(".")[0] / (name.replace(".", "/") + ".py")
                if ".nodes" in name and file.is_file():
                    waiting.append(file)
    return found


def endpoints(path: Path) -> Iterator[tuple[Grant, str, str]]:
    """Yield what a module makes under a name that stands in it: grant, name, where."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            grant, position = MAKERS.get(called, (None, 0))
            if grant is not None and len(node.args) > position:
                name = node.args[position]
                if isinstance(name, ast.Constant) and isinstance(name.value, str) and NAME.fullmatch(name.value):
                    yield grant, name.value, f"{path.relative_to(ROOT)}:{node.lineno}"


def is_granted(identity: PolicyIdentity, grant: Grant, name: str) -> bool:
    full = name.replace("~", f"/{identity.name}", 1) if name.startswith("~") else f"/{name.strip('/')}"
    return full in identity.names(grant) or "*" in identity.names(grant)


def test_every_node_has_an_identity(policy: Policy) -> None:
    assert {*executables(), *OF_OTHERS} == {one.name for one in policy.identities if not one.is_tool}


@pytest.mark.parametrize("node", sorted(executables()))
def test_what_a_node_makes_is_granted(policy: Policy, node: str) -> None:
    made = [found for path in sorted(own_modules(executables()[node])) for found in endpoints(path)]
    assert made, "found no endpoint at all: has the way that nodes make them changed?"
    missing = [
        f"{where}: {grant} {name}" for grant, name, where in made if not is_granted(policy.identity(node), grant, name)
    ]
    assert missing == [], "add them to softgrip_security/data/access.yaml, or do without"


@pytest.mark.parametrize("act", EXAMPLES, ids=lambda act: act.name)
def test_what_a_click_at_the_panel_calls_is_granted_to_it(policy: Policy, act: Act) -> None:
    grant = Grant.CALL if act.call.kind is CallKind.SERVICE else Grant.CALL_ACTION
    assert is_granted(policy.identity("panel"), grant, act.call.name)


def documented() -> list[str]:
    table = ARCHITECTURE.read_text().partition("## Interfaces")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| ([a-z/][^|]*) \|", table, re.MULTILINE)
    return [name.strip() for row in rows if row.strip() != "name" for name in row.split(",") if "..." not in name]


@pytest.mark.parametrize("name", documented())
def test_every_documented_interface_is_offered_by_somebody(policy: Policy, name: str) -> None:
    offers = (Grant.PUBLISH, Grant.SERVE, Grant.SERVE_ACTION, Grant.SUBSCRIBE)
    full = f"/{name.strip('/')}"
    assert [one.name for one in policy.identities for grant in offers if full in one.names(grant)]


def test_the_tables_of_the_documentation_are_those_of_the_policy() -> None:
    module = load_script(ROOT / "tools" / "docs" / "security.py")
    assert module.PAGE.read_text() == module.page(), "out of date: run tools/docs/security.py"
