# SPDX-License-Identifier: Apache-2.0
"""Write the parameter files of softgrip_bringup/config from the nodes' own tables: value, unit, bounds, description.

Run after a table has changed: ``python tools/parameters.py``. tests/validation/test_parameters.py fails until then.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any

CONFIG = Path(__file__).resolve().parents[1] / "ros2_ws/src/softgrip_bringup/config"

#: Node name -> where its table is.
TABLES = {
    "camera": "softgrip_vision.nodes.camera",
    "emulated_cell": "softgrip_emulator.nodes.emulated_cell",
    "friction_rig": "softgrip_driver.nodes.rig_parameters",
    "gdfe_simulator": "softgrip_model.nodes.gdfe_simulator",
    "grasp_mix_manager": "softgrip_cell.nodes.parameters",
    "gripper_command": "softgrip_cell.nodes.gripper_command",
    "hand_description": "softgrip_description.nodes.hand_description",
    "kinematics_predictor": "softgrip_model.nodes.kinematics_predictor",
    "marker_tracker": "softgrip_vision.nodes.marker_tracker",
    "panel": "softgrip_panel.nodes.panel",
    "recorder": "softgrip_bag.nodes.recorder",
    "tendon_driver": "softgrip_driver.nodes.tendon_parameters",
}


def yaml_value(value: Any) -> str:
    """Return a parameter value as YAML of the same type."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = repr(value)
        mantissa, e, exponent = text.partition("e")
        return text if not e else f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(yaml_value(item) for item in value) + "]"
    return repr(value)


def comment(row: Any) -> str:
    """Return unit, bounds and description of a row."""
    bounds = ""
    if row.minimum is not None or row.maximum is not None:
        low = "" if row.minimum is None else f"{row.minimum:g}"
        high = "" if row.maximum is None else f"{row.maximum:g}"
        bounds = f" {low}..{high}"
    unit = f"[{row.unit or '-'}]"
    choices = f" one of {', '.join(str(choice) for choice in row.choices)};" if row.choices else ""
    return f"{unit}{bounds}{choices} {row.description}"


def text(node: str, table: Any) -> str:
    """Return a node's parameter file."""
    lines = [
        "# SPDX-License-Identifier: Apache-2.0",
        f"# Parameters of {node}, written by tools/parameters.py from the node's table: value, [unit] bounds, meaning.",
        f"/**/{node}:",  # in any namespace
        "  ros__parameters:",
    ]
    for row in table.rows:
        lines += [f"    # {comment(row)}", f"    {row.name}: {yaml_value(row.default)}"]
    return "\n".join(lines) + "\n"


def files() -> dict[Path, str]:
    """Return path -> content of every parameter file."""
    return {
        CONFIG / f"{node}.yaml": text(node, importlib.import_module(module).PARAMETERS)
        for node, module in TABLES.items()
    }


def main() -> int:
    """Write the files."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for path, content in files().items():
        path.write_text(content)
        print(path.relative_to(CONFIG.parents[3]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
