# SPDX-License-Identifier: Apache-2.0
"""What a stop and its reset will do under the present policy: (key of the text, values) for pages to show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from softgrip_driver.faults import FAULTS, Recovery
from softgrip_panel.model.facts import SafetyView, StopPolicyView, TendonView

Line = tuple[str, dict[str, Any]]


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
