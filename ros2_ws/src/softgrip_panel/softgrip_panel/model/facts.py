# SPDX-License-Identifier: Apache-2.0
"""What messages say, as values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class MountedView:
    """One slot: which finger is in it, and whether the check has seen it ("verified", "to be verified", ...)."""

    slot: str
    serial: str
    profile: str
    state: str


@dataclass(frozen=True)
class CellView:
    """cell/state."""

    mode: str = "UNKNOWN"
    finger_set: str = ""
    mounted: tuple[MountedView, ...] = ()
    product: str = ""
    picks: int = 0
    gripped: int = 0
    empty: int = 0
    slipped: int = 0
    tendon_faults: int = 0
    aborted: int = 0
    swaps: int = 0
    mean_swap_s: float = 0.0
    availability: float = 1.0
    fault: str = ""
    reason: str = ""

    @property
    def counts(self) -> tuple[int, ...]:
        """How many grasps ended in each way."""
        return self.gripped, self.empty, self.slipped, self.tendon_faults, self.aborted

    @property
    def quality(self) -> float:
        """Share of the picks that ended GRIPPED; NaN before the first."""
        return self.gripped / self.picks if self.picks else math.nan


@dataclass(frozen=True)
class SafetyView:
    """safety/state."""

    estop: bool = False
    estop_reason: str = ""
    locked: bool = False
    lock_owner: str = ""
    lock_reason: str = ""


@dataclass(frozen=True)
class TendonView:
    """One tendon of tendon/status."""

    name: str
    state: str
    homed: bool
    fault: str = ""
    reason: str = ""


@dataclass(frozen=True)
class TensionView:
    """One tendon of tendon/state, beside what the free motion would need; NaN where nobody knows."""

    name: str
    pulled_length_m: float
    tension_n: float
    free_tension_n: float = math.nan

    @property
    def contact_tension_n(self) -> float:
        """Tension minus predicted free-motion tension [N]."""
        return self.tension_n - self.free_tension_n


@dataclass(frozen=True)
class StopPolicyView:
    """What an emergency stop does: parameters of the driver; "" = not read yet."""

    estop_policy: str = ""
    tension_hold_n: float = math.nan


@dataclass(frozen=True)
class OwnerView:
    """Who may command a tendon."""

    tendon: str
    owner: str
    requested_by: str = ""


@dataclass(frozen=True)
class ComponentHealth:
    """One status of /diagnostics: level 0 good, 1 warning, 2 error, 3 stale; its figures by name."""

    name: str
    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ProductView:
    """One product of the catalogue; marks and expected success by finger set."""

    id: str
    name: str
    grasp: str
    mass_kg: float
    table_marks: Mapping[str, str]
    expected_success: Mapping[str, float]
    grasps: Mapping[str, int]


@dataclass(frozen=True)
class FingerRecordView:
    """One printed finger; the check is (pulled length [m], tension [N]) of its last empty closing."""

    serial: str
    profile: str
    finger: str
    printed: str
    material: str
    cable: str
    state: str
    cycles: int
    cycle_limit: int
    calibrated: str
    objection: str
    check: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FingerDecision:
    """What the verdict of a grasp knew of one finger."""

    finger: str
    state: str
    contact_tension_n: float
    threshold_n: float


@dataclass(frozen=True)
class CountedView:
    """One grasp of the cell's database, whoever ordered it.

    Attributes:
        at_s: of its end, by the cell's clock, in seconds since the Unix epoch.
        serials: of the fingers that grasped, slot order; empty = not written down.
        decided_stamp_s: of the tendon/state that decided, by the cell's clock [s]; NaN = none did.
        fingers: what the verdict knew of each.
    """

    at_s: float
    product: str
    finger_set: str
    outcome: str
    reason: str
    duration_s: float
    serials: tuple[str, ...] = ()
    decided_stamp_s: float = math.nan
    fingers: tuple[FingerDecision, ...] = ()

    @property
    def key(self) -> tuple[float, str]:
        """The same in every listing; a NaN among the figures is none."""
        return self.at_s, self.product


@dataclass(frozen=True)
class FingerView:
    """Joints of one finger, predicted or measured, base to tip [rad]."""

    name: str
    joint_angles_rad: tuple[float, ...]


@dataclass(frozen=True)
class ResidualView:
    """finger/residual of one finger."""

    finger: str
    tip_error_m: float
    tip_error_percent: float
    cusum_friction: float
    cusum_stiffness: float
    verdict: str
    reason: str
