# SPDX-License-Identifier: Apache-2.0
"""Node grasp_mix_manager: the cell's rules as services and actions."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState

from softgrip_cell.catalogue_file import SHIPPED as SHIPPED_CATALOGUE
from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.cell import Cell, CellMode, Clocks
from softgrip_cell.errors import CellError, OccupiedError, SchemaError, StorageError
from softgrip_cell.finger_records import SHIPPED as SHIPPED_FINGER_RECORDS
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.gates import DriverFacts, FrictionFacts, FrictionLimits
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.drive_lock import DriveLock
from softgrip_cell.nodes.driver_link import DriverLink
from softgrip_cell.nodes.grasp_server import GraspServer
from softgrip_cell.nodes.parameters import PARAMETERS, agreements, check_settings, grasp_settings, motion_limits
from softgrip_cell.nodes.record_server import RecordServer
from softgrip_cell.nodes.swap_progress import SwapProgressLog
from softgrip_cell.nodes.swap_server import SwapServer
from softgrip_cell.nodes.tendon_lease import TendonLease
from softgrip_cell.observation import Observation, ObservationOrder, SeenTip, StreamSilence, TendonSample
from softgrip_cell.planner import Order
from softgrip_cell.storage import CellJournal, Database, Library
from softgrip_interfaces.msg import (
    CellState,
    FingerStates,
    FrictionModel,
    LeaseHeartbeat,
    PredictionResidual,
    SafetyState,
    SwapProgress,
    TendonOwners,
    TendonStatusArray,
)
from softgrip_interfaces.srv import PlanMix, SelectProduct
from softgrip_nodekit import (
    LATCHED,
    RELIABLE,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    RecordingIo,
    StartupError,
    nanoseconds,
    run,
    startup_errors,
    to_time_message,
)

#: Who the audit names for what the node does by itself.
WHO = "grasp_mix_manager"

#: How often silence and time limits are looked at; each look is a heartbeat of the lease as well [s].
LOOK_S = 0.1

#: What could not be written is tried again, and tendons that may hold something are asked for again, so often [s].
RETRY_S = 2.0

#: After its start the driver may take so long before its silence is an error [s]. It is counted in checks, since an
#: emulated cell's time begins after this node.
START_S = 10.0


class GraspMixManager(CellNode):
    """Knows products and fingers, plans, guides swaps, grasps, and says how it went."""

    def __init__(self, node_io: Callable[[Node], RecordingIo] = RecordingIo) -> None:
        super().__init__(WHO)
        self._node_io = node_io(self)
        values = PARAMETERS.declare(self)
        self._slots: list[str] = values["slots"]
        if values["thumb"] not in self._slots or len(set(self._slots)) != len(self._slots):
            raise StartupError(
                f"parameter 'slots': expected different names with '{values['thumb']}', found {self._slots}"
            )
        self._grasp_settings: GraspSettings = grasp_settings(values)
        self._status: TendonStatusArray | None = None
        self._silence_s: float = values["silence_s"]
        self._status_silence, self._state_silence = (StreamSilence(round(self._silence_s / LOOK_S)) for _ in range(2))
        self._start_checks_left = round(START_S / LOOK_S)
        self._dropped = 0  # tendon/state messages without a number for every slot
        self._next_retry_s = 0.0
        self._friction: FrictionModel | None = None
        self._order = ObservationOrder(values["allowed_lateness_s"])
        self._published: tuple[object, ...] | None = None
        self._diagnostics = Diagnostics(self, watch_nodes=True)
        with startup_errors(CellError):
            self._database = Database(values["database_url"], exclusive=True, deferred=True)
        try:
            with startup_errors(CellError):
                self._cell = self._open_cell(values)
        except StartupError:
            self._database.close()
            raise
        heartbeats = self.create_publisher(LeaseHeartbeat, "tendon/heartbeat", RELIABLE)
        self._lease = TendonLease(
            self._node_io, heartbeats.publish, WHO, self._slots, values["lease_s"], self._on_lease_lost
        )
        self._driver = DriverLink(self._node_io, self._slots, self._lease, motion_limits(values))
        self._grasp = GraspServer(self._node_io, self._cell, self._driver, self._grasp_settings)
        progress_publisher = self.create_publisher(SwapProgress, "cell/swap_progress", LATCHED)
        self._swap_progress = SwapProgressLog(self._cell, progress_publisher.publish, self._node_io.now_ns)
        lock, check, limit_s = DriveLock(self._node_io, WHO), check_settings(values), values["swap_limit_s"]
        self._swap = SwapServer(
            self._node_io, self._cell, self._driver, lock, self._swap_progress, check, self._slots, limit_s
        )
        RecordServer(self._node_io, self._cell, self._library, self._journal, self._publish_state)
        self._state_publisher = self.create_publisher(CellState, "cell/state", LATCHED)
        self._node_io.create_service(SelectProduct, "cell/select_product", self._on_select)
        self._node_io.create_service(PlanMix, "cell/plan_mix", self._on_plan)
        self._node_io.create_subscription(JointState, "tendon/state", self._on_tendon_state, SENSOR)
        self._node_io.create_subscription(TendonStatusArray, "tendon/status", self._on_tendon_status, SENSOR)
        self._node_io.create_subscription(SafetyState, "safety/state", self._on_safety, LATCHED)
        self._node_io.create_subscription(TendonOwners, "tendon/owners", self._lease.observe_owners, LATCHED)
        self._node_io.create_subscription(FingerStates, "finger/predicted", self._on_predicted, SENSOR)
        self._node_io.create_subscription(FingerStates, "finger/measured", self._on_measured, SENSOR)
        self._node_io.create_subscription(PredictionResidual, "finger/residual", self._on_residual, SENSOR)
        self._node_io.create_subscription(FrictionModel, "friction/active", self._on_friction, LATCHED)
        self._node_io.create_timer(LOOK_S, self._watch)
        self._publish_state()

    def close(self) -> None:
        """Let go of the cell: a grasp or swap ends, the driver holds or releases by its own rules."""
        with closing(self._database):
            self._grasp.abort("grasp_mix_manager is shutting down")
            self._driver.hold()
            self._lease.release()

    def _open_cell(self, values: dict[str, Any]) -> Cell:
        """Fill an empty database from the shipped files and take up what the last run left."""
        library = self._library = Library(self._database, self._node_io.now_ns)

        def prepare() -> None:
            self._database.open()
            if library.is_empty():
                catalogue = read_catalogue(Path(values["catalogue"]) if values["catalogue"] else SHIPPED_CATALOGUE)
                finger_records = read_finger_records(
                    Path(values["finger_records"]) if values["finger_records"] else SHIPPED_FINGER_RECORDS
                )
                library.import_catalogue(catalogue, WHO)
                library.import_finger_records(finger_records.values(), WHO)

        try:
            prepare()
        except (OccupiedError, SchemaError):
            raise  # another manager or another release: nothing to wait for
        except StorageError as error:
            self.get_logger().error(f"{error}; the cell is at fault until it can be used")
        limits = FrictionLimits(values["friction_age_limit_s"], values["friction_range_factor"])
        self._node_io.start(self._save, self._load)
        journal = self._journal = CellJournal(self._database, self._slots, self._node_io.now_ns)
        clocks = Clocks(now_ns=self._node_io.now_ns, monotonic_s=self._node_io.monotonic_s)
        thumb = self._slots.index(values["thumb"])
        cell = Cell(library, journal, thumb, limits, clocks, agreements(values), prepare)
        cell.update_friction(self._friction_facts)
        return cell

    def _save(self) -> bytes:
        """Return what the cell remembers; nothing where the database cannot be read."""
        try:
            return self._database.save()
        except StorageError:
            return b""

    def _load(self, saved: bytes) -> None:
        if saved:
            self._database.load(saved)

    def _friction_facts(self) -> FrictionFacts | None:
        if self._friction is None:
            return None
        return convert.friction_facts(self._friction, self._node_io.now_ns())

    def _on_tendon_state(self, message: JointState) -> None:
        sample = convert.tendon_sample(message, self._slots)
        if sample is None:
            self._dropped += 1
            expected = ", ".join(self._slots)
            text = f"tendon/state: expected numbers for {expected}, found others in {self._dropped} messages"
            self._diagnostics.set("tendons", Health.ERROR, text)
            return
        self._state_silence.hear()
        self._observe(self._order.add_sample(sample))

    def _on_predicted(self, message: FingerStates) -> None:
        profiles = [slot.profile for slot in self._cell.slots()]
        self._observe(self._order.add_prediction(convert.free_motion(message, self._slots, profiles)))

    def _on_measured(self, message: FingerStates) -> None:
        self._observe(self._order.add_tips(convert.seen_tips(message)))

    def _observe(self, observations: Sequence[Observation]) -> None:
        """Let the cell, a grasp and a swap see what was observed; what is urgent (a fault, a stop) is not ordered."""
        for observation in observations:
            if isinstance(observation, TendonSample):
                self._cell.observe_sample(observation, 2.0 * self._grasp_settings.open_m)
                self._grasp.observe_sample(observation)
                self._swap.observe_sample(observation)
            elif isinstance(observation, SeenTip):
                self._grasp.observe_tip(observation)
                self._swap.observe_tips([observation])
            else:
                self._grasp.observe(observation)
                self._swap.observe(observation)
                self._publish_state()

    def _on_residual(self, message: PredictionResidual) -> None:
        worn = message.verdict == PredictionResidual.WORN
        self._cell.observe_residual(message.finger, worn=worn, reason=message.reason)
        self._publish_state()

    def _on_tendon_status(self, message: TendonStatusArray) -> None:
        self._status = message
        self._status_silence.hear()
        faults = convert.tendon_faults(message, self._slots)
        self._grasp.observe_faults(faults, nanoseconds(message.header.stamp))
        self._swap.observe_faults(faults)
        self._update_driver()

    def _on_safety(self, message: SafetyState) -> None:
        safety = convert.safety_facts(message)
        self._cell.update_safety(safety)
        self._swap.observe_safety(safety)
        if safety.estop:
            self._grasp.abort(f"the emergency stop is latched: {safety.estop_reason}")
        elif safety.locked:
            self._grasp.abort(safety.lock_text)
        self._publish_state()

    def _on_lease_lost(self, reason: str) -> None:
        self.get_logger().warning(reason)
        self._grasp.abort(reason)
        self._swap.lose(reason)

    def _on_friction(self, message: FrictionModel) -> None:
        self._friction = message

    def _update_driver(self) -> None:
        fresh = not (self._status_silence.reached or self._state_silence.reached)
        facts: DriverFacts = convert.driver_facts(self._status, self._slots, fresh=fresh)
        self._cell.update_driver(facts)
        self._publish_state()

    def _watch(self) -> None:
        """What no message tells: silence, a person who does not come back, a disk that can be written again."""
        self._lease.send_heartbeat()
        self._start_checks_left = max(0, self._start_checks_left - 1)
        self._status_silence.pass_period()
        self._state_silence.pass_period()
        self._watch_silence()
        self._swap.watch_clock()
        is_due = self._node_io.monotonic_s() >= self._next_retry_s
        if is_due:
            self._next_retry_s = self._node_io.monotonic_s() + RETRY_S
            self._cell.retry_writes()
        self._care_for_lease(is_due)
        self._update_driver()
        self._report_cell()

    def _watch_silence(self) -> None:
        """End what moves when the driver is not heard any more: nobody knows where the fingers are."""
        streams = {"tendon/state": self._state_silence, "tendon/status": self._status_silence}
        silent = [topic for topic, silence in streams.items() if silence.reached]
        if not silent:
            text = "tendon/state is coming in"
            if self._dropped:
                text += f"; {self._dropped} messages without a number for every slot were dropped"
            self._diagnostics.set("tendons", Health.OK, text, {"late_inputs": self._order.late})
        elif self._start_checks_left and not any(streams[topic].was_heard for topic in silent):
            self._diagnostics.set("tendons", Health.STALE, f"waiting for the first {' and '.join(silent)}")
        else:
            reason = f"expected {' and '.join(silent)}, found none for {self._silence_s:g} s"
            if self._dropped:
                reason += f" ({self._dropped} without a number for every slot were dropped)"
            self._grasp.abort(f"{reason}; the fingers hold where they are")
            self._swap.fall_silent(reason)
            self._diagnostics.set("tendons", Health.ERROR, f"{reason}; start or check tendon_driver")

    def _care_for_lease(self, is_due: bool) -> None:
        """Own the tendons while the cell works or holds something, unless somebody asks for what is only held."""
        if self._grasp.active or self._swap.active:
            return
        if self._lease.is_requested:
            self._lease.hand_over()
        elif not self._cell.may_hold:
            if not convert.is_moving(self._status, self._slots):  # the end of a lease stops what moves
                self._lease.release()
        elif is_due and not self._lease.token and not self._lease.is_left:
            # What is held is held on by the driver while its owner is alive, also after a restart of this node.
            self._lease.acquire(lambda _why_not: None)

    def _report_cell(self) -> None:
        mode = self._cell.mode
        health = {CellMode.FAULT: Health.ERROR, CellMode.ESTOP: Health.ERROR, CellMode.UNKNOWN: Health.WARN}.get(
            mode, Health.OK
        )
        if self._cell.lock is not None and not self._swap.active:
            health = max(health, Health.WARN)
        state = self._cell.state()
        text = str(state["fault"] or state["reason"] or mode.name.lower())
        self._diagnostics.set("cell", health, text, state)

    def _on_select(self, request: SelectProduct.Request, response: SelectProduct.Response) -> SelectProduct.Response:
        try:
            choice = self._cell.select(request.product)
        except CellError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message, response.reason = True, choice.reason, choice.reason
        response.grasp = choice.product.grasp.value
        response.finger_set = choice.finger_set.id
        response.profile = choice.finger_set.profile
        response.swap_needed = choice.swap_needed
        recipe = choice.product.recipe_for(choice.finger_set.id)
        response.force_limit = recipe.force_limit_n
        response.pull_limit = recipe.pull_limit_m
        self._publish_state()
        return response

    def _on_plan(self, request: PlanMix.Request, response: PlanMix.Response) -> PlanMix.Response:
        if len(request.products) != len(request.quantities):
            response.success = False
            response.message = (
                f"expected as many quantities as products, found {len(request.quantities)} and {len(request.products)}"
            )
            return response
        orders = [Order(p, int(q)) for p, q in zip(request.products, request.quantities, strict=True)]
        try:
            plan = self._cell.plan(orders, keep_order=request.keep_order)
        except CellError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = f"{len(plan.steps)} orders with {plan.swaps} swaps"
        response.steps = [convert.plan_step(step) for step in plan.steps]
        response.swaps = plan.swaps
        response.predicted_time = plan.predicted_time_s
        response.expected_success = plan.expected_success
        response.redundant_sets = list(plan.redundant_sets)
        return response

    def _publish_state(self) -> None:
        """Publish cell/state when something other than the mere passing of time has changed."""
        numbers = self._cell.state()
        compared = (self._cell.mode, self._cell.slots(), {k: v for k, v in numbers.items() if k != "availability"})
        if compared != self._published:
            self._published = compared
            stamp = to_time_message(self._node_io.now_ns())
            self._state_publisher.publish(convert.cell_state(stamp, int(self._cell.mode), self._cell.slots(), numbers))
        self._swap_progress.publish_changes()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(GraspMixManager, args)


if __name__ == "__main__":
    sys.exit(main())
