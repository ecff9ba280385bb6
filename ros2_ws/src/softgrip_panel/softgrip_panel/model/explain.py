# SPDX-License-Identifier: Apache-2.0
"""What a stop and its reset will do under the present policy, and what stands behind a warning of /diagnostics.

Lines are (key of the text, values) for pages to show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from softgrip_driver.faults import FAULTS, Recovery
from softgrip_model.finger.wear import LEARNING
from softgrip_panel.model.alarms import AlarmFact, AlarmLevel
from softgrip_panel.model.facts import CellView, ComponentHealth, ResidualView, SafetyView, StopPolicyView, TendonView
from softgrip_panel.model.swap import HANDS_OUT, RESTARTED

Line = tuple[str, dict[str, Any]]

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
        cause, remedy: for the person at the page.
        must_last_s: it has to last so long before it is an alarm [s].
    """

    node: str
    component: str
    text: str
    cause: str
    remedy: str
    must_last_s: float = 0.0


_WARNINGS: Final = (
    _Warning("", "executor", "callbacks were run",
             "the cell's computer is busy, or one task of this node takes long",
             "end other programs on it; where it stays, look at this node's log", must_last_s=5.0),
    _Warning("", "executor", "a callback failed",
             "this node was sent something that it could not work with",
             "read its log; start the node again if it goes on, and report it with the log"),
    _Warning("", "input ", "gone",
             "the node that publishes it has ended, hangs or is cut off", "start that node again"),
    _Warning("", "node ", "gone", "it has ended, hangs or is cut off", "start it again if that was not meant"),
    _Warning("marker_tracker", "finger ", "",
             "markers of this finger have been hidden, out of the picture or badly lit for some seconds",
             "take away what hides them; check light, focus, markers and the profile of the finger"),
    _Warning("marker_tracker", "frames", "no frame",
             "the camera sends nothing", "look at the camera's own alarm, its plug and its log", must_last_s=10.0),
    _Warning("marker_tracker", "calibration", "",
             "without a calibration no finger is measured", "page Set-up: find the lens, then each finger's plane"),
    _Warning("gdfe_simulator", "finger ", "",
             "the computer is too busy for the shapes asked for, or there is none for this pulled length",
             "nothing decides by this shape; ask for fewer hexahedra or a lower rate_hz, or home the tendons",
             must_last_s=10.0),
    _Warning("kinematics_predictor", "finger ", "",
             "what the markers show and what the model predicts have parted over several closings",
             "do what it says; page Fingers shows by how much, page Swap mounts another finger"),
    _Warning("recorder", "bag", "not recording", "no bag is being written", "page Bags: start one"),
)  # fmt: skip


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
        _Warning("", "", "", "", ""),
    )
    if found.level == _ERROR:
        return AlarmFact(found.name, found.message, AlarmLevel.ERROR, known.cause, known.remedy)
    return AlarmFact(
        found.name, found.message, AlarmLevel.WARNING, known.cause, known.remedy, must_last_s=known.must_last_s
    )


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
    title = f"drives locked by {safety.lock_owner}"
    if safety.lock_owner.partition(":")[0] != MANAGER:
        remedy = "who locked them ends it (tendon/unlock with the token that tendon/lock gave); go and ask first"
        return "lock", AlarmFact("safety/state", title, AlarmLevel.WARNING, safety.lock_reason, remedy)
    if cell is not None and cell.mode == "SWAPPING" and HANDS_OUT not in cell.reason and RESTARTED not in cell.reason:
        return "lock/swap", AlarmFact(
            "safety/state", title, AlarmLevel.WARNING, safety.lock_reason, must_last_s=math.inf
        )
    remedy = "a swap has ended in its midst: take the hands out of the cell, then say so on page Swap"
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
