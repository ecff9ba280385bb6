# SPDX-License-Identifier: Apache-2.0
"""Everything that pages show, in one place: the node writes it, pages read it, from different threads."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from softgrip_driver.faults import FAULTS
from softgrip_panel.model.alarms import AlarmBook, AlarmFact
from softgrip_panel.model.bench import BenchView
from softgrip_panel.model.control import ControlDesk
from softgrip_panel.model.explain import explain_health, explain_lock
from softgrip_panel.model.facts import (
    CellView,
    ComponentHealth,
    CountedView,
    FingerRecordView,
    FingerView,
    OwnerView,
    ProductView,
    ResidualView,
    SafetyView,
    StopPolicyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.friction import FrictionModelView, FrictionRefusals, RigProgress
from softgrip_panel.model.grasps import GraspHistory
from softgrip_panel.model.residuals import ResidualHistory, WatchLimits
from softgrip_panel.model.swap import SwapFollower
from softgrip_panel.model.weights import WeightCheck
from softgrip_panel.texts import say

#: Without tendon/status for so long the driver is called silent [s].
SILENCE_S = 2.0
#: At its start the panel waits so long for the driver before it calls it silent [s].
START_S = 15.0
#: The driver's node, the component of its bus, and what each of its servos says on /diagnostics.
_DRIVER, _BUS, _ZERO = "tendon_driver", "bus", "zero [mm]"
#: So many notices are kept for whoever opens a page.
MAX_NOTICES = 50


@dataclass(frozen=True)
class Notice:
    """What somebody did and what came of it; `at_s` in seconds since the Unix epoch."""

    number: int
    at_s: float
    who: str
    act: str
    subject: str
    success: bool
    message: str


class PanelState:
    """The state.

    Args:
        now_s: seconds since the Unix epoch.
        monotonic_s: for silence [s].
    """

    def __init__(self, now_s: Callable[[], float], monotonic_s: Callable[[], float]) -> None:
        self.now_s = now_s
        self.monotonic_s = monotonic_s
        self._lock = threading.RLock()
        self.control = ControlDesk(monotonic_s)
        self.alarms = AlarmBook(now_s)
        self.swap = SwapFollower()
        self.grasps = GraspHistory(now_s)
        self.cell: CellView | None = None
        self.safety: SafetyView | None = None
        self.policy = StopPolicyView()
        self.tendons: tuple[TendonView, ...] = ()
        self.tensions: tuple[TensionView, ...] = ()
        self.owners: tuple[OwnerView, ...] = ()
        self.products: tuple[str, ...] = ()
        self.catalogue: tuple[ProductView, ...] = ()
        self.fingers: tuple[FingerRecordView, ...] = ()
        self.counted: tuple[CountedView, ...] = ()
        self.predicted: tuple[FingerView, ...] = ()
        self.measured: tuple[FingerView, ...] = ()
        self.rig = RigProgress()
        self.friction_models: tuple[FrictionModelView, ...] = ()
        self.friction_active = ""
        self.refusals = FrictionRefusals()
        self.residuals: dict[str, ResidualView] = {}
        self.residual_history = ResidualHistory()
        self.watch_limits = WatchLimits()
        self.bench = BenchView()
        self.weights = WeightCheck()
        self.nodes: tuple[str, ...] = ()
        self.is_emulated = False
        self.notices: deque[Notice] = deque(maxlen=MAX_NOTICES)
        self._numbers = 0
        self._heard_s = monotonic_s() + START_S - SILENCE_S
        self._health: dict[str, ComponentHealth] = {}

    @contextmanager
    def locked(self) -> Iterator[PanelState]:
        """Read or change several things that belong together."""
        with self._lock:
            yield self

    def observe_cell(self, cell: CellView) -> None:
        """Take cell/state; what is at fault with the driver itself is said by its own alarms."""
        with self._lock:
            before, self.cell = self.cell, cell
            self.grasps.observe_mode(before.mode if before else "", cell)
            facts = {}
            if cell.fault and not any(tendon.fault for tendon in self.tendons):
                facts["cell/fault"] = AlarmFact("cell/state", cell.fault, cause=cell.reason)
            self.alarms.observe("cell/state", facts)
            self._observe_lock()

    def observe_safety(self, safety: SafetyView) -> None:
        """Take safety/state."""
        with self._lock:
            self.safety = safety
            row = FAULTS["estop"]
            facts = {}
            if safety.estop:
                facts["estop"] = AlarmFact("safety/state", row.meaning, cause=safety.estop_reason, remedy=row.remedy)
            self.alarms.observe("safety/state", facts)
            self._observe_lock()

    def _observe_lock(self) -> None:
        """Whose lock it is, is known by safety/state and cell/state together."""
        facts = {}
        if self.safety is not None and self.safety.locked:
            key, fact = explain_lock(self.safety, self.cell)
            facts[key] = fact
        self.alarms.observe("lock", facts)

    def observe_tendons(self, tendons: Sequence[TendonView]) -> None:
        """Take tendon/status; the fault table of the driver says what a fault means and what to do."""
        with self._lock:
            self._heard_s = self.monotonic_s()
            self.tendons = tuple(tendons)
            self.alarms.observe("tendon/status", dict(_tendon_alarm(one) for one in tendons if _is_alarm(one)))
            self.alarms.observe("silence", {})

    def observe_health(self, statuses: Sequence[ComponentHealth]) -> None:
        """Take a /diagnostics; components at fault are alarms until they say otherwise."""
        with self._lock:
            for status in statuses:
                self._health[status.name] = status
            self._observe_bench(statuses)
            facts = {f"health/{one.name}": explain_health(one) for one in self._health.values() if one.level in (1, 2)}
            self.alarms.observe("/diagnostics", facts)

    def _observe_bench(self, statuses: Sequence[ComponentHealth]) -> None:
        """Take what the driver says of its bus and its servos."""
        own = {}
        for one in statuses:
            node, _, component = one.name.partition(": ")
            if node.rpartition("/")[2] == _DRIVER:
                own[component] = one.values
        if _BUS in own:
            servos = {name: values for name, values in own.items() if _ZERO in values}
            self.bench = replace(self.bench, bus=own[_BUS], servos=servos, reports=self.bench.reports + 1)

    def observe_tensions(self, tensions: Sequence[TensionView], stamp_s: float = math.nan) -> None:
        """Take the newest tendon/state beside its prediction.

        Args:
            tensions: of every tendon.
            stamp_s: of the message, by the cell's clock [s].
        """
        with self._lock:
            self.tensions = tuple(tensions)
            self.grasps.observe_tensions(self.tensions, stamp_s)

    def observe_counted(self, counted: Sequence[CountedView]) -> None:
        """Take the grasps of the cell's database, newest first."""
        with self._lock:
            self.counted = tuple(counted)
            self.grasps.observe_counted(self.counted)

    def observe_residual(self, residual: ResidualView) -> None:
        """Take finger/residual of one finger."""
        with self._lock:
            self.residuals[residual.finger] = residual
            self.residual_history.observe(residual, self.monotonic_s())

    def advance(self) -> None:
        """Let time pass: what falls silent is an alarm, and alarms live on."""
        with self._lock:
            silent_s = self.monotonic_s() - self._heard_s
            if silent_s > SILENCE_S:
                fact = AlarmFact(
                    "tendon/status",
                    say("alarm.silent"),
                    cause=say("alarm.silent_cause", silence=SILENCE_S),
                    remedy=say("alarm.silent_remedy"),
                )
                self.alarms.observe("silence", {"silence": fact})
            self.alarms.advance()

    @property
    def finger_sets(self) -> tuple[str, ...]:
        """Every finger set of the cell's catalogue, a user's own too, in its order; empty while it is not known."""
        return tuple(dict.fromkeys(name for product in self.catalogue for name in product.table_marks))

    @property
    def is_stale(self) -> bool:
        """Whether the driver is not heard: what is shown may be old."""
        return self.monotonic_s() - self._heard_s > SILENCE_S

    def add_notice(self, who: str, act: str, subject: str, *, success: bool, message: str) -> None:
        """Let every page see what somebody did."""
        with self._lock:
            self._numbers += 1
            self.notices.append(Notice(self._numbers, self.now_s(), who, act, subject, success, message))


def _is_alarm(tendon: TendonView) -> bool:
    # the stop of the whole cell is one alarm, not one for each tendon
    return bool(tendon.fault) and tendon.fault != "estop"


def _tendon_alarm(tendon: TendonView) -> tuple[str, AlarmFact]:
    row = FAULTS.get(tendon.fault)
    title = f"{tendon.name}: {row.meaning if row else tendon.fault}"
    remedy = row.remedy if row else ""
    return f"tendon/{tendon.name}/{tendon.fault}", AlarmFact(
        f"tendon {tendon.name}", title, cause=tendon.reason, remedy=remedy
    )
