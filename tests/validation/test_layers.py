# SPDX-License-Identifier: Apache-2.0
"""The layer rules of docs/architecture.md, checked by walking imports."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = ROOT / "ros2_ws" / "src"
PACKAGES = sorted(p.name for p in WORKSPACE.iterdir() if (p / "package.xml").exists())

ROS = ("rclpy", "rcl_interfaces", "builtin_interfaces", "ament_index_python")
EMBEDDED = ("embedded_ros",)

#: Pure code a package may import from other packages of the workspace.
MAY_IMPORT = {
    "softgrip_model": {"softgrip_time"},
    "softgrip_nodekit": {"softgrip_time"},
    "softgrip_time": set(),
    "softgrip_description": {"softgrip_model"},
    "softgrip_design": {"softgrip_description", "softgrip_model", "softgrip_time"},
    "softgrip_driver": {"softgrip_description", "softgrip_model", "softgrip_time"},
    "softgrip_emulator": {"softgrip_description", "softgrip_model", "softgrip_time"},
    "softgrip_vision": {"softgrip_description", "softgrip_model", "softgrip_time"},
    "softgrip_cell": {"softgrip_description", "softgrip_model", "softgrip_time"},
    "softgrip_bag": {"softgrip_model", "softgrip_time", "softgrip_vision"},
    "softgrip_bringup": set(),
    "softgrip_panel": {"softgrip_driver", "softgrip_model", "softgrip_time", "softgrip_vision"},
    "softgrip_cmake": set(),
    "softgrip_mcap_vendor": set(),
    "softgrip_security": set(),
    "softgrip_testing": {
        "softgrip_bag",
        "softgrip_cell",
        "softgrip_driver",
        "softgrip_emulator",
        "softgrip_model",
        "softgrip_time",
        "softgrip_vision",
    },
    "softgrip_gym": {"softgrip_cell", "softgrip_emulator", "softgrip_model", "softgrip_testing", "softgrip_time"},
    "softgrip_sweep": {"softgrip_bag", "softgrip_demo", "softgrip_design", "softgrip_model", "softgrip_testing"},
    "softgrip_demo": {
        "softgrip_bag",
        "softgrip_cell",
        "softgrip_description",
        "softgrip_design",
        "softgrip_driver",
        "softgrip_model",
        "softgrip_time",
        "softgrip_vision",
    },
}


#: Workbenches: no cell runs them, nothing imports them, and they may use what tests and benchmarks share.
WORKBENCHES = {"softgrip_gym", "softgrip_sweep"}


def is_message_package(name: str) -> bool:
    return name.endswith(("_msgs", "_srvs")) or name in {"softgrip_interfaces", *ROS}


def modules() -> list[Path]:
    return sorted(p for name in PACKAGES for p in (WORKSPACE / name / name).rglob("*.py") if "build" not in p.parts)


def imports(path: Path) -> list[tuple[int, str]]:
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.append((node.lineno, node.module))
    return found


def violations(path: Path) -> list[str]:
    package = path.relative_to(WORKSPACE).parts[0]
    in_nodes = "nodes" in path.relative_to(WORKSPACE).parts or package == "softgrip_nodekit"
    broken = []
    for line, module in imports(path):
        top, *rest = module.split(".")
        where = f"{path.relative_to(ROOT)}:{line}: imports {module}"
        if top in EMBEDDED:
            broken.append(f"{where}: nothing in ros2_ws may know embedded/")
        if (top == "rclpy" or is_message_package(top)) and not in_nodes:
            broken.append(f"{where}: only files under nodes/ may import ROS")
        if top == "softgrip_nodekit" and not in_nodes:
            broken.append(f"{where}: only files under nodes/ may import the node helpers")
        if top.startswith("softgrip_") and top not in {package, "softgrip_interfaces", "softgrip_nodekit"}:
            if top not in MAY_IMPORT.get(package, set()):
                broken.append(f"{where}: {package} may import only {sorted(MAY_IMPORT.get(package, set()))}")
            elif "nodes" in rest and package not in {"softgrip_demo", "softgrip_bag"}:
                broken.append(f"{where}: nodes of other packages are met on topics")
        if "nodes" in rest and top == package and not in_nodes:
            broken.append(f"{where}: pure code may not import nodes")
    return broken


def test_every_package_has_a_rule() -> None:
    assert set(PACKAGES) - {"softgrip_interfaces"} == set(MAY_IMPORT)


@pytest.mark.parametrize("package", [p for p in PACKAGES if p != "softgrip_interfaces"])
def test_layers_hold(package: str) -> None:
    files = [path for path in modules() if path.relative_to(WORKSPACE).parts[0] == package]
    broken = [text for path in files for text in violations(path)]
    assert not broken, "\n".join(broken)


def test_the_walk_sees_a_broken_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pure = tmp_path / "ros2_ws" / "src" / "softgrip_driver" / "softgrip_driver" / "bus.py"
    pure.parent.mkdir(parents=True)
    pure.write_text("import rclpy\nimport embedded_ros\nfrom softgrip_emulator.plant import Plant\n")
    monkeypatch.setitem(globals(), "WORKSPACE", tmp_path / "ros2_ws" / "src")
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    assert len(violations(pure)) == 3


def test_no_product_code_imports_what_is_for_tests() -> None:
    users = {
        f"{path.relative_to(WORKSPACE)}:{line}"
        for path in modules()
        for line, module in imports(path)
        if module.split(".")[0] == "softgrip_testing"
        and path.relative_to(WORKSPACE).parts[0] not in {"softgrip_testing", *WORKBENCHES}
    }
    assert users == set()


def test_nothing_imports_a_workbench() -> None:
    assert not any(WORKBENCHES & allowed for allowed in MAY_IMPORT.values())


def test_nothing_depends_on_bringup() -> None:
    dependents = [
        p
        for p in PACKAGES
        if p != "softgrip_bringup" and "softgrip_bringup</" in (WORKSPACE / p / "package.xml").read_text()
    ]
    assert dependents == []
