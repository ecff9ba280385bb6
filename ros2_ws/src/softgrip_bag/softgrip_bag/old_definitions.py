# SPDX-License-Identifier: Apache-2.0
"""What softgrip's interfaces said before, and which of their enumerations are read by name.

Until release 0.1.0 was cut, 0 was the first outcome of each enumeration below (USABLE, GRIPPED, ...). Now it is UNSET,
so that a field nobody filled in says nothing. The numbers moved, the names did not: a bag recorded before is read by
the definition that it carries, and each number becomes the number that its name has now. A number that had no name
becomes UNSET. Fields that were added since have their default. Types that are not in this table are refused when their
definition differs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

UNSET = "UNSET"


def _names(**fields: str) -> Mapping[str, tuple[str, ...]]:
    return MappingProxyType({field: tuple(names.split()) for field, names in fields.items()})


_VERDICT = _names(verdict="USABLE REPEAT_POINTS DO_NOT_USE")
_SAMPLE = _names(verdict="ACCEPTED REPEAT REJECTED")

#: "package/Name" -> field -> names of its enumeration, in the order of their old numbers 0, 1, ...
ENUMERATIONS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "softgrip_interfaces/FrictionModel": _VERDICT,
        "softgrip_interfaces/FrictionSample": _SAMPLE,
        "softgrip_interfaces/PredictionResidual": _names(verdict="OK WATCH RECALIBRATE WORN"),
        "softgrip_interfaces/Grasp_Result": _names(outcome="GRIPPED EMPTY SLIPPED TENDON_FAULT ABORTED"),
        "softgrip_interfaces/SwapFingers_Result": _names(outcome="SUCCEEDED CANCELLED REFUSED FAILED"),
        "softgrip_interfaces/CalibrateFriction_Result": _names(outcome="SUCCEEDED CANCELLED FAILED"),
        "softgrip_interfaces/MoveTendon_Goal": _names(mode="LENGTH TENSION"),
        "softgrip_interfaces/MoveTendon_Result": _names(
            outcome="REACHED TENSION_LIMIT TIMEOUT CANCELLED FAULT REFUSED"
        ),
    }
)
#: Types of topics that may differ from what is installed: those above, and what else got fields since.
READ_BY_NAME = frozenset(ENUMERATIONS) | {
    "softgrip_interfaces/CalibrateFriction_FeedbackMessage",
    "softgrip_interfaces/FingerStates",
    "softgrip_interfaces/SwapFingers_FeedbackMessage",
}


def has_old_enumerations(type_name: str, schema: str) -> bool:
    """Return whether a type of a topic was recorded when its enumerations began with their first outcome.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/FrictionModel".
        schema: the definition in the bag.
    """
    package, *_, name = type_name.split("/")
    return f"{package}/{name}" in ENUMERATIONS and bool(schema) and UNSET not in schema


def old_name(type_name: str, field: str, value: int) -> str:
    """Return the name that a number had before, for bytes whose definition a bag does not carry (a node's trace)."""
    names = ENUMERATIONS[type_name][field]
    return names[value] if 0 <= value < len(names) else UNSET
