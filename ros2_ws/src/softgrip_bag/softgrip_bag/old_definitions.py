# SPDX-License-Identifier: Apache-2.0
"""What softgrip's interfaces said before, and how it is said today.

* Enumerations: until release 0.1.0 was cut, 0 was the first outcome (USABLE, GRIPPED, ...). Now it is UNSET, so that a
  field nobody filled in says nothing. The numbers moved, the names did not: a bag recorded before is read by the
  definition that it carries, and each number becomes the number that its name has now. What had no name becomes UNSET.
* Phases and steps that were words became numbers: `ENUMERATIONS`, too.
* Parallel arrays became arrays of messages, and YAML in a text a message: `RESHAPED`.
* The steps of a trace are bytes whose definition no bag carries: `step_layouts` has it.

Fields that were added since have their default. Types that are not in these tables are refused when their definition
differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import yaml

from softgrip_bag.definition import Decoded, Definition
from softgrip_time.units import NANOSECONDS

UNSET = "UNSET"


def _names(**fields: str) -> Mapping[str, tuple[str, ...]]:
    return MappingProxyType({field: tuple(names.split()) for field, names in fields.items()})


_VERDICT = _names(verdict="USABLE REPEAT_POINTS DO_NOT_USE")
_SAMPLE = _names(verdict="ACCEPTED REPEAT REJECTED")

#: "package/Name" -> field -> names of its enumeration, in the order of their old numbers 0, 1, ... where it had numbers
ENUMERATIONS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "softgrip_interfaces/FrictionModel": _VERDICT,
        "softgrip_interfaces/FrictionSample": _SAMPLE,
        "softgrip_interfaces/PredictionResidual": _names(verdict="OK WATCH RECALIBRATE WORN"),
        "softgrip_interfaces/Grasp_Result": _names(outcome="GRIPPED EMPTY SLIPPED TENDON_FAULT ABORTED"),
        "softgrip_interfaces/Grasp_Feedback": _names(phase="APPROACH CLOSE HOLD LIFT"),
        "softgrip_interfaces/SwapFingers_Feedback": _names(
            step="RELEASE LOCK OPEN_PALM REMOVE INSERT CLOSE_PALM UNLOCK HOME VERIFY"
        ),
        "softgrip_interfaces/ConfirmStep_Request": _names(step="OPEN_PALM REMOVE INSERT CLOSE_PALM HANDS_OUT"),
        "softgrip_interfaces/SwapFingers_Result": _names(outcome="SUCCEEDED CANCELLED REFUSED FAILED"),
        "softgrip_interfaces/CalibrateFriction_Result": _names(outcome="SUCCEEDED CANCELLED FAILED"),
        "softgrip_interfaces/MoveTendon_Goal": _names(mode="LENGTH TENSION"),
        "softgrip_interfaces/MoveTendon_Result": _names(
            outcome="REACHED TENSION_LIMIT TIMEOUT CANCELLED FAULT REFUSED"
        ),
    }
)


Values = Mapping[str, Any]


def _part(kind: str, /, **values: Any) -> Decoded:
    return Decoded(Definition(f"softgrip_interfaces/{kind}"), values)


def _typed_markers(old: Values) -> Values:
    columns = ("u", "v", "x", "y", "stddev", "confidence", "occluded")
    rows = zip(old["names"], *(old[name] for name in columns), strict=True)
    return {"markers": [_part("Marker", **dict(zip(("name", *columns), row, strict=True))) for row in rows]}


def _typed_steps(old: Values) -> Values:
    steps, at = [], 0
    for number, stamp, time, monotonic, size in zip(
        old["name"], old["stamp"], old["wall"], old["monotonic"], old["size"], strict=True
    ):
        data = old["data"][at : at + size]
        name = old["names"][number]
        steps.append(_part("TraceStep", name=name, stamp=stamp, time=time, monotonic=monotonic, data=data))
        at += size
    return {"steps": steps}


#: Key of a grasp's evidence as it was written in YAML -> field of FingerEvidence.
EVIDENCE_KEYS = MappingProxyType(
    {
        "excess_n": "contact_tension",
        "contact_from_n": "threshold",
        "force_at_most_n": "max_force",
        "peak_excess_n": "peak_contact_tension",
        "tip_off_m": "tip_deviation",
    }
)


def _typed_evidence(old: Values) -> Values:
    if "decision" in old:
        return {}
    text = yaml.safe_load(old["evidence"]) or {}
    fingers: dict[str, dict[str, Any]] = {}
    for key, field in EVIDENCE_KEYS.items():
        for finger, value in (text.get(key) or {}).items():
            fingers.setdefault(finger, {"finger": finger, "tip_deviation": math.nan})[field] = float(value)
    seconds, nanoseconds = divmod(int(text.get("decided_stamp_ns", 0)), NANOSECONDS)
    stamp = Decoded(Definition("builtin_interfaces/Time"), {"sec": seconds, "nanosec": nanoseconds})
    evidence = [_part("FingerEvidence", **values) for values in fingers.values()]
    phases = ("unset", *(name.lower() for name in ENUMERATIONS["softgrip_interfaces/Grasp_Feedback"]["phase"]))
    phase = phases.index(text.get("phase", "unset"))
    return {"decision": _part("GraspEvidence", stamp=stamp, phase=phase, fingers=evidence)}


#: "package/Name" -> today's fields, from the fields of a definition that differs.
RESHAPED: Mapping[str, Callable[[Values], Values]] = MappingProxyType(
    {
        "softgrip_interfaces/FingerMarkers": _typed_markers,
        "softgrip_interfaces/NodeTrace": _typed_steps,
        "softgrip_interfaces/Grasp_Result": _typed_evidence,
    }
)
#: Types of topics that may differ from what is installed: those above, and what else got fields since.
READ_BY_NAME = (
    frozenset(ENUMERATIONS)
    | frozenset(RESHAPED)
    | {
        "softgrip_interfaces/CalibrateFriction_FeedbackMessage",
        "softgrip_interfaces/CellState",
        "softgrip_interfaces/FingerStates",
        "softgrip_interfaces/Grasp_FeedbackMessage",
        "softgrip_interfaces/SwapFingers_FeedbackMessage",
    }
)

_GRASP_FEEDBACK = """string phase
float64[] pulled_lengths
float64[] tensions
bool contact
"""
_GRASP_RESULT = """uint8 UNSET=0
uint8 GRIPPED=1
uint8 EMPTY=2
uint8 SLIPPED=3
uint8 TENDON_FAULT=4
uint8 ABORTED=5
uint8 outcome
string reason
string evidence
float64 latency
float64 duration
float64[] pulled_lengths
float64[] tensions
"""
_GRASP_RESULT_BEFORE_UNSET = """uint8 GRIPPED=0
uint8 EMPTY=1
uint8 SLIPPED=2
uint8 TENDON_FAULT=3
uint8 ABORTED=4
""" + _GRASP_RESULT[_GRASP_RESULT.index("uint8 outcome") :]
_SEPARATOR = "=" * 80
_GRASP_RESULT_WITH_BOTH = (
    _GRASP_RESULT.replace("string evidence\n", "string evidence\nsoftgrip_interfaces/GraspEvidence decision\n")
    + f"""{_SEPARATOR}
MSG: softgrip_interfaces/GraspEvidence
builtin_interfaces/Time stamp
uint8 phase
softgrip_interfaces/FingerEvidence[] fingers
{_SEPARATOR}
MSG: softgrip_interfaces/FingerEvidence
string finger
uint8 state
float64 contact_tension
float64 contact_tension_stddev
float64 threshold
float64 peak_contact_tension
float64 max_force
float64 tip_deviation
{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
)
_SWAP_FEEDBACK = """string step
string instruction
bool confirmation
float64 elapsed
string token
"""
_CONFIRM_STEP = """string step
string token
string[] serials
"""


@dataclass(frozen=True)
class TraceAge:
    """What the data of a trace's steps can be.

    Attributes:
        had_columns: the trace's batches had columns, and what grasps say text.
        had_worded_swaps: the steps of a swap were words.
        is_before_unset: the bag's enumerations began with their first outcome.
    """

    had_columns: bool = False
    had_worded_swaps: bool = False
    is_before_unset: bool = False


def step_layouts(name: str, age: TraceAge) -> tuple[str, Sequence[str]]:
    """Return type and possible definitions, latest first, of a step's data where both differ from today's.

    Args:
        name: of a step of a trace.
        age: of the trace.
    """
    word, _, what = name.partition(" ")
    if age.had_columns and what.endswith("/cell/grasp"):
        return _grasp_layouts(word, age)
    if age.had_worded_swaps and word == "feedback" and what.endswith("/cell/swap"):
        return "softgrip_interfaces/action/SwapFingers_Feedback", (_of_its_time(_SWAP_FEEDBACK, age),)
    if age.had_worded_swaps and word == "request" and what.endswith("/cell/confirm_step"):
        return "softgrip_interfaces/srv/ConfirmStep_Request", (_of_its_time(_CONFIRM_STEP, age),)
    return "", ()


def _grasp_layouts(word: str, age: TraceAge) -> tuple[str, Sequence[str]]:
    if word == "feedback":
        return "softgrip_interfaces/action/Grasp_Feedback", (_GRASP_FEEDBACK,)
    if word == "finished" and age.is_before_unset:
        return "softgrip_interfaces/action/Grasp_Result", (_GRASP_RESULT_BEFORE_UNSET,)
    if word == "finished":
        return "softgrip_interfaces/action/Grasp_Result", (_GRASP_RESULT_WITH_BOTH, _GRASP_RESULT)
    return "", ()


def _of_its_time(layout: str, age: TraceAge) -> str:
    """A swap has had a token since 0 is UNSET."""
    return layout.replace("string token\n", "") if age.is_before_unset else layout


def has_old_enumerations(type_name: str, schema: str) -> bool:
    """Return whether a type of a topic was recorded when its enumerations began with their first outcome.

    Args:
        type_name: e.g. "softgrip_interfaces/msg/FrictionModel".
        schema: the definition in the bag.
    """
    package, *_, name = type_name.split("/")
    return f"{package}/{name}" in ENUMERATIONS and bool(schema) and UNSET not in schema


def has_worded_swaps(type_name: str, schema: str) -> bool:
    """Return whether a topic is the feedback of swaps, and was recorded when it named their steps in words.

    Args:
        type_name: e.g. "softgrip_interfaces/action/SwapFingers_FeedbackMessage".
        schema: the definition in the bag.
    """
    return type_name.endswith("/SwapFingers_FeedbackMessage") and "string step" in schema
