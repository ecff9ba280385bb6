# SPDX-License-Identifier: Apache-2.0
"""Node grasp_mix_manager: the cell's rules as services and actions."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from rclpy.node import Node
from sensor_msgs.msg import JointState

from softgrip_cell.catalogue_file import SHIPPED as SHIPPED_CATALOGUE
from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.cell import Cell, Clocks, Mode
from softgrip_cell.errors import CellError
from softgrip_cell.gates import DriverFacts, FrictionLimits
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.nodes import convert
from softgrip_cell.nodes.driver_link import DriverLink
from softgrip_cell.nodes.grasp_server import GraspServer
from softgrip_cell.nodes.parameters import PARAMETERS, check_settings, grasp_settings
from softgrip_cell.nodes.swap_server import SwapServer
from softgrip_cell.observation import Pair, Pairing, Silence
from softgrip_cell.passports import SHIPPED as SHIPPED_PASSPORTS
from softgrip_cell.passports import read_passports
from softgrip_cell.planner import Order
from softgrip_cell.storage import Database, Journal, Library
from softgrip_interfaces.msg import CellState, FingerStates, FrictionModel, PredictionResidual, TendonStatusArray
from softgrip_interfaces.srv import PlanMix, SelectProduct
from softgrip_nodekit import (
    LATCHED,
    SENSOR,
    Diagnostics,
    Doors,
    Health,
    StartupError,
    TracedDoors,
    run,
    to_time_message,
)

#: Who the audit names for what the node does by itself.
WHO = "grasp_mix_manager"

#: Silence of the driver after which it counts as gone, and how often that is looked at [s].
SILENCE_S = 1.0
LOOK_S = 0.1

#: After its start the driver may take so long before its silence is an error [s].
START_S = 10.0

Value = TypeVar("Value")


class GraspMixManager(Node):
    """Knows products and fingers, plans, guides swaps, grasps, and says how it went."""

    def __init__(self, doors: Callable[[Node], Doors] = TracedDoors) -> None:
        super().__init__(WHO)
        self._doors = doors(self)
        values = PARAMETERS.declare(self)
        self._slots: list[str] = values["slots"]
        if values["thumb"] not in self._slots or len(set(self._slots)) != len(self._slots):
            raise StartupError(
                f"parameter 'slots': expected different names with '{values['thumb']}', found {self._slots}"
            )
        self._grasp_settings: GraspSettings = grasp_settings(values)
        self._status: TendonStatusArray | None = None
        self._status_silence, self._state_silence = (Silence(round(SILENCE_S / LOOK_S)) for _ in range(2))
        self._friction: FrictionModel | None = None
        self._pairing = Pairing()
        self._published: Any = None
        self._to_release = False
        self._diagnostics = Diagnostics(self, watch_nodes=True)
        self._database = self._start(lambda: Database(values["database_url"], exclusive=True))
        try:
            self._cell = self._start(lambda: self._open_cell(values))
        except StartupError:
            self._database.close()
            raise
        self._started_at_s = self._doors.monotonic_s()
        # A swap that was cut off may have left fingers half closed, with nothing between them.
        self._to_release = self._cell.cut_off is not None and self._cell.cut_off.kind == "swap"
        self._driver = DriverLink(self._doors, self._slots, values["open_speed_m_per_s"])
        self._grasp = GraspServer(self._doors, self._cell, self._driver, self._grasp_settings)
        self._swap = SwapServer(
            self._doors, self._cell, self._driver, check_settings(values), self._slots, values["swap_limit_s"]
        )
        self._state_publisher = self.create_publisher(CellState, "cell/state", LATCHED)
        self._doors.service(SelectProduct, "cell/select_product", self._on_select)
        self._doors.service(PlanMix, "cell/plan_mix", self._on_plan)
        self._doors.subscription(JointState, "tendon/state", self._on_tendon_state, SENSOR)
        self._doors.subscription(TendonStatusArray, "tendon/status", self._on_tendon_status, SENSOR)
        self._doors.subscription(FingerStates, "finger/predicted", self._on_predicted, SENSOR)
        self._doors.subscription(FingerStates, "finger/measured", self._on_measured, SENSOR)
        self._doors.subscription(PredictionResidual, "finger/residual", self._on_residual, SENSOR)
        self._doors.subscription(FrictionModel, "friction/active", self._on_friction, LATCHED)
        self._doors.timer(LOOK_S, self._watch)
        self._publish_state()

    def close(self) -> None:
        """Let go of the cell: whoever grasps or swaps is told, the driver holds or releases by its own rules."""
        self._grasp.abort("grasp_mix_manager is shutting down")
        self._driver.hold()
        self._database.close()

    def _open_cell(self, values: dict[str, Any]) -> Cell:
        """Fill an empty database from the shipped files and take up what the last run left."""
        library = Library(self._database, self._doors.now_ns)
        if library.is_empty():
            catalogue = read_catalogue(Path(values["catalogue"]) if values["catalogue"] else SHIPPED_CATALOGUE)
            passports = read_passports(Path(values["passports"]) if values["passports"] else SHIPPED_PASSPORTS)
            library.import_catalogue(catalogue, WHO)
            library.import_passports(passports.values(), WHO)
        limits = FrictionLimits(values["friction_age_limit_s"], values["friction_range_factor"])
        self._doors.state(self._database.save, self._database.load)
        journal = Journal(self._database, self._slots, self._doors.now_ns)
        clocks = Clocks(now_ns=self._doors.now_ns, monotonic_s=self._doors.monotonic_s)
        cell = Cell(library, journal, self._slots.index(values["thumb"]), limits, clocks)
        cell.update_friction(self._friction_facts)
        return cell

    @staticmethod
    def _start(make: Callable[[], Value]) -> Value:
        try:
            return make()
        except CellError as error:
            raise StartupError(str(error)) from error

    def _friction_facts(self) -> Any:
        if self._friction is None:
            return None
        return convert.friction_facts(self._friction, self._doors.now_ns())

    def _on_tendon_state(self, message: JointState) -> None:
        sample = convert.tendon_sample(message, self._slots)
        if sample is None:
            expected = ", ".join(self._slots)
            self._diagnostics.set(
                "tendons", Health.ERROR, f"tendon/state: expected numbers for {expected}, found others"
            )
            return
        self._state_silence.hear()
        self._cell.observe_sample(sample, 2.0 * self._grasp_settings.open_m)
        self._grasp.observe_sample(sample)
        self._swap.observe_sample(sample)
        self._take(self._pairing.add_sample(sample))

    def _on_predicted(self, message: FingerStates) -> None:
        profiles = [slot.profile for slot in self._cell.slots()]
        self._take(self._pairing.add_prediction(convert.free_motion(message, self._slots, profiles)))

    def _take(self, pair: Pair | None) -> None:
        if pair is not None:
            self._grasp.observe(pair)
            self._swap.observe(pair)
            self._publish_state()

    def _on_measured(self, message: FingerStates) -> None:
        tips = convert.seen_tips(message)
        self._grasp.see(tips)
        self._swap.see(tips)

    def _on_residual(self, message: PredictionResidual) -> None:
        if message.verdict == PredictionResidual.WORN:
            self._cell.wear(message.finger, message.reason)
            self._publish_state()

    def _on_tendon_status(self, message: TendonStatusArray) -> None:
        self._status = message
        self._status_silence.hear()
        faults = convert.tendon_faults(message, self._slots)
        self._grasp.observe_faults(faults, convert.nanoseconds(message.header.stamp))
        self._swap.observe_faults(faults)
        self._update_driver()

    def _on_friction(self, message: FrictionModel) -> None:
        self._friction = message

    def _update_driver(self) -> None:
        fresh = not (self._status_silence.reached or self._state_silence.reached)
        facts: DriverFacts = convert.driver_facts(self._status, self._slots, fresh=fresh)
        self._cell.update_driver(facts)
        self._publish_state()

    def _watch(self) -> None:
        """What no message tells: silence, and a person who does not come back."""
        if self._to_release and not self._driver.missing():
            self._to_release = False
            self._driver.release(self._released_after_restart)
        self._swap.watch_clock()
        self._status_silence.look()
        self._state_silence.look()
        self._update_driver()
        if self._status is None and self._doors.monotonic_s() - self._started_at_s < START_S:
            self._diagnostics.set("tendons", Health.STALE, "waiting for the first tendon/state and tendon/status")
        elif self._state_silence.reached:
            self._grasp.abort(f"expected tendon/state, found none for {SILENCE_S:g} s")
            self._diagnostics.set("tendons", Health.ERROR, "no tendon/state; start or check tendon_driver")
        else:
            self._diagnostics.set("tendons", Health.OK, "tendon/state is coming in")
        mode = self._cell.mode
        health = {Mode.FAULT: Health.ERROR, Mode.ESTOP: Health.ERROR, Mode.UNKNOWN: Health.WARN}.get(mode, Health.OK)
        state = self._cell.state()
        self._diagnostics.set("cell", health, state["fault"] or state["reason"] or mode.name.lower(), state)

    def _released_after_restart(self, success: bool, message: str) -> None:
        said = "done" if success else message
        self.get_logger().info(f"a swap was cut off by the last end of this node; tendon/release: {said}")

    def _on_select(self, request: Any, response: Any) -> Any:
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

    def _on_plan(self, request: Any, response: Any) -> Any:
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
            stamp = to_time_message(self._doors.now_ns())
            self._state_publisher.publish(convert.cell_state(stamp, int(self._cell.mode), self._cell.slots(), numbers))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(GraspMixManager, args)


if __name__ == "__main__":
    sys.exit(main())
