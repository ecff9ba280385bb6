# SPDX-License-Identifier: Apache-2.0
"""What a stop and its reset will do under the present policy, and what stands behind a warning of /diagnostics.

Lines are (key of the text, values) for pages to show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from softgrip_driver.faults import FAULTS, Recovery
from softgrip_model.finger.wear import LEARNING
from softgrip_panel.model.alarms import AlarmFact, AlarmLevel
from softgrip_panel.model.facts import CellView, ComponentHealth, ResidualView, SafetyView, StopPolicyView, TendonView
from softgrip_panel.model.swap import HANDS_OUT, RESTARTED
from softgrip_panel.texts import say

Line = tuple[str, dict[str, object]]

#: The node that locks the drives while a person's hands are inside for a swap.
MANAGER: Final = "grasp_mix_manager"
#: Its lock outside a swap is an alarm after so long [s]: safety/state and cell/state do not come at one instant.
LOCK_LASTS_S: Final = 1.0
#: Modes in which a product may be between the fingers.
_HOLDING: Final = frozenset({"GRASPING", "HOLDING", "UNKNOWN"})
#: Levels of /diagnostics.
_WARN, _ERROR = 1, 2


@dataclass(frozen=True)
class _Warning:
    """A warning that is known.

    Attributes:
        node, component, text: "" = any; a component and a text begin so.
        key: of its cause and its remedy among the texts ("warnings.KEY.cause"); "" = it has none.
        must_last_s: it has to last so long before it is an alarm [s].
    """

    node: str
    component: str
    text: str
    key: str
    must_last_s: float = 0.0


_WARNINGS: Final = (
    _Warning("", "executor", "callbacks were run", "busy", must_last_s=5.0),
    _Warning("", "executor", "a callback failed", "callback"),
    _Warning("", "input ", "gone", "input_gone"),
    _Warning("", "node ", "gone", "node_gone"),
    _Warning("marker_tracker", "finger ", "", "markers"),
    _Warning("marker_tracker", "frames", "no frame", "no_frame", must_last_s=10.0),
    _Warning("marker_tracker", "calibration", "", "no_calibration"),
    _Warning("gdfe_simulator", "finger ", "", "shapes", must_last_s=10.0),
    _Warning("kinematics_predictor", "finger ", "", "wear"),
    _Warning("recorder", "bag", "not recording", "not_recording"),
)


def explain_health(found: ComponentHealth) -> AlarmFact:
    """Return what a component at fault is as an alarm; an error waits for nothing."""
    node, _, component = found.name.partition(": ")
    known = next(
        (
            row
            for row in _WARNINGS
            if row.node in ("", node.rpartition("/")[2])
            and component.startswith(row.component)
            and found.message.startswith(row.text)
        ),
        _Warning("", "", "", ""),
    )
    cause, remedy = (say(f"warnings.{known.key}.{one}") if known.key else "" for one in ("cause", "remedy"))
    if found.level == _ERROR:
        return AlarmFact(found.name, found.message, AlarmLevel.ERROR, cause, remedy)
    return AlarmFact(found.name, found.message, AlarmLevel.WARNING, cause, remedy, must_last_s=known.must_last_s)


def explain_residual(residual: ResidualView, cell: CellView | None) -> tuple[str, bool]:
    """Return the key of what is said of a finger instead of its verdict, and whether it is good.

    A finger is judged by empty closings alone: while something is held, where its tip is says nothing of the finger,
    and an OK of before is none of now. What wants a person's act is said at all times, with the empty key.
    """
    if residual.verdict not in {"OK", "UNSET"}:
        return "", False
    if cell is not None and cell.mode in _HOLDING:
        return "fingers.not_judged", False
    if residual.verdict == "UNSET" or residual.reason.startswith(LEARNING):
        return "fingers.learning", False
    return "", True


def explain_lock(safety: SafetyView, cell: CellView | None) -> tuple[str, AlarmFact]:
    """Return a lock of the drives with its key: a running swap's own is never an alarm, anybody else's is one.

    Args:
        safety: with a lock.
        cell: that may be swapping; after a swap that ended in its midst the mode stays, and the reason tells.
    """
    title = say("alarm.locked", owner=safety.lock_owner)
    if safety.lock_owner.partition(":")[0] != MANAGER:
        remedy = say("alarm.locked_remedy")
        return "lock", AlarmFact("safety/state", title, AlarmLevel.WARNING, safety.lock_reason, remedy)
    if cell is not None and cell.mode == "SWAPPING" and HANDS_OUT not in cell.reason and RESTARTED not in cell.reason:
        return "lock/swap", AlarmFact(
            "safety/state", title, AlarmLevel.WARNING, safety.lock_reason, must_last_s=math.inf
        )
    remedy = say("alarm.hands_inside_remedy")
    return "lock", AlarmFact(
        "safety/state", title, AlarmLevel.WARNING, safety.lock_reason, remedy, must_last_s=LOCK_LASTS_S
    )


def explain_stop(policy: StopPolicyView) -> Line:
    """Return what an emergency stop does."""
    if policy.estop_policy == "let_go":
        return "estop.will_let_go", {}
    if policy.estop_policy == "hold" and math.isfinite(policy.tension_hold_n):
        return "estop.will_hold", {"tension": policy.tension_hold_n}
    return "estop.will_unknown", {}


def explain_reset(safety: SafetyView | None, tendons: Sequence[TendonView]) -> list[Line]:
    """Return what a reset does, line by line."""
    if safety is None or not safety.estop:
        return [("reset.none", {})]
    lines: list[Line] = [("reset.will", {"reason": safety.estop_reason or "-"})]
    unhomed = [
        tendon.name
        for tendon in tendons
        if not tendon.homed or (tendon.fault in FAULTS and FAULTS[tendon.fault].recovery is Recovery.HOME)
    ]
    if unhomed:
        lines.append(("reset.will_home", {"tendons": ", ".join(unhomed)}))
    if safety.locked:
        lines.append(("reset.will_locked", {"owner": safety.lock_owner}))
    return lines
