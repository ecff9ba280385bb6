# SPDX-License-Identifier: Apache-2.0
"""Faults: what the driver names and does, and what the emulated cell can be made to do."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from generated.markdown import code, table
from softgrip_driver.faults import FAULTS
from softgrip_emulator.faults import BUS_FAULTS, CAMERA_FAULTS
from softgrip_emulator.rig.emulated import EmulatedRig


def page() -> str:
    """Return the page."""
    named = table(
        ("fault", "what happened", "the driver does", "ends with", "do this"),
        (
            (
                code(one.name),
                one.meaning,
                one.reaction.value + ("; the others open" if one.opens_others else ""),
                one.recovery.value,
                one.remedy,
            )
            for one in FAULTS.values()
        ),
    )
    return "\n".join(
        [
            "# Faults\n",
            "## Faults of a drive\n",
            "As `TendonStatus.fault` names them. The table is the driver's own; `make faults` causes every row.\n",
            named,
            "\n## Faults to inject\n",
            "`emulator/inject_fault` of the emulated cell takes these names; arguments are rcl_interfaces/Parameter.\n",
            "`clear` ends them.\n",
            "### Servos, bus and tendons\n",
            _causes(BUS_FAULTS),
            "\n### Camera\n",
            _causes(CAMERA_FAULTS),
            "\n### Friction rig\n",
            _rig_faults(),
        ]
    )


def _causes(causes: Mapping[str, Any]) -> str:
    return table(("fault", "on", "arguments and their defaults"), (_cause(*one) for one in causes.items()))


def _cause(name: str, cause: Any) -> tuple[str, str, str]:
    arguments = inspect.signature(cause).parameters
    given = ", ".join(f"`{key}: {one.default:g}`" for key, one in arguments.items() if key not in {"cell", "slot"})
    return code(name), "one drive" if "slot" in arguments else "all", given


def _rig_faults() -> str:
    kinds = {"mark10, gcl2": EmulatedRig(), "grbl, an amplifier": EmulatedRig(stage="grbl", gauge="bogde_basic")}
    names = sorted({name for rig in kinds.values() for name in rig.faults})
    return table(
        ("fault", "of stage and gauge"),
        (
            (
                code(name),
                "; ".join(kind for kind, rig in kinds.items() if name in rig.faults)
                if not _of_all(name, kinds)
                else "any",
            )
            for name in names
        ),
    )


def _of_all(name: str, kinds: Mapping[str, EmulatedRig]) -> bool:
    return all(name in rig.faults for rig in kinds.values())
