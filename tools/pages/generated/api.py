# SPDX-License-Identifier: Apache-2.0
"""Pages of the Python API: which modules are public, in the order in which a reader needs them."""

from __future__ import annotations

import importlib

#: Page -> (title, what for, modules).
PAGES = {
    "friction": (
        "softgrip_model.friction",
        "Friction laws, their fit and published models.",
        (
            "",
            ".laws",
            ".measurements",
            ".fit",
            ".published",
            ".record",
            ".calibration",
            ".csv_file",
            ".model_file",
            ".design",
        ),
    ),
    "finger": (
        "softgrip_model.finger",
        "A tendon-driven finger: equilibria, gradients, paths.",
        ("", ".wear", ".matching"),
    ),
    "gdfe": (
        "softgrip_model.gdfe",
        "Hyperelastic shapes of hexahedral meshes.",
        ("", ".march", ".materials", ".case_file", ".closing", ".mesh_file"),
    ),
    "profile": ("softgrip_model.profile", "Finger profiles.", ("",)),
    "design": (
        "softgrip_design",
        "From a demonstration to a finger.",
        ("", ".trajectory", ".target", ".design", ".objective", ".optimiser", ".output"),
    ),
    "description": ("softgrip_description", "The hand as URDF and MJCF.", ("", ".mjcf")),
    "vision": ("softgrip_vision", "Markers to joint angles.", ("", ".tracker", ".layout", ".calibration")),
    "cell": (
        "softgrip_cell",
        "Products, plans, grasp decisions.",
        (
            "",
            ".products",
            ".planner",
            ".catalogue_file",
            ".grasp.settings",
            ".grasp.sequence",
            ".nodes.controller_client",
        ),
    ),
    "bag": ("softgrip_bag", "Bags and archives.", ("", ".reader", ".archive", ".mcap_file", ".definition")),
    "panel": (
        "softgrip_panel",
        "What the operator's page shows and what a click means, without ROS and HTTP; who may.",
        ("", ".model.state", ".model.desk", ".model.work", ".model.grasps", ".model.alarms", ".model.roles"),
    ),
    "emulator": (
        "softgrip_emulator",
        "The emulated cell: its hardware on wires, faults, what is true of its fingers and its rig.",
        ("", ".cell", ".faults", ".plant.truth", ".rig"),
    ),
    "security": (
        "softgrip_security",
        "Who may do what, and the keys that prove who is who.",
        ("", ".policy", ".certificates", ".keystore", ".zenoh_access", ".sros2"),
    ),
    "gym": ("softgrip_gym", "Gymnasium environments of the emulated cell, and policies in the live one.", ("",)),
    "sweep": ("softgrip_sweep", "Many tasks at once, by processes or by Dask.", ("", ".intervals")),
    "testing": (
        "softgrip_testing",
        "For tests and benchmarks: the virtual cell, waiting, clocks, pictures of known truth.",
        ("", ".virtual_cell", ".virtual_grasps", ".virtual_rig", ".waiting", ".manual_clock", ".synthetic_images"),
    ),
    "demo": ("softgrip_demo", "One shift: its summary beside Table 4.2.", ("", ".summary", ".table42")),
    "driver": ("softgrip_driver", "Drives and their faults.", ("", ".faults", ".tendon.backend", ".tendon.limits")),
    "time": ("softgrip_time", "Time that code is given.", ("",)),
    "nodekit": ("softgrip_nodekit", "What every node shares.", ("",)),
}


def pages() -> dict[str, str]:
    """Return name -> text: an index and one page for each package."""
    made = {f"api/{name}.md": _page(*one) for name, one in PAGES.items()}
    rows = "\n".join(f"| [{title}]({name}.md) | {use} |" for name, (title, use, _) in PAGES.items())
    tree = "\n".join(PAGES)
    made["api/index.md"] = (
        "# Python API\n\nWhat programs may build on. Lengths, angles and forces are in the units that a name or\n"
        "docstring says: SI at the boundaries of packages, mm inside the finger kernel and GDFE.\n\n"
        f"| package | what for |\n|---|---|\n{rows}\n\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"
    )
    return made


def _page(package: str, _use: str, modules: tuple[str, ...]) -> str:
    parts = [f"# {package}\n"]
    for suffix in modules:
        name = package + suffix
        if suffix:
            parts.append(f"## {name}\n")
        listed = getattr(importlib.import_module(name), "__all__", ())
        members = f":members: {', '.join(listed)}\n" if listed else ""
        overview = "".join(f"   ~{name}.{one}\n" for one in listed if one[0].isalpha())
        if overview:
            parts.append(
                f"```{{eval-rst}}\n.. currentmodule:: None\n\n.. autosummary::\n   :nosignatures:\n\n{overview}```\n"
            )
        parts.append(f"```{{eval-rst}}\n.. automodule:: {name}\n{_indented(members)}```\n")
    return "\n".join(parts)


def _indented(options: str) -> str:
    return "".join(f"   {line}\n" for line in options.splitlines())
