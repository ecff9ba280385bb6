# SPDX-License-Identifier: Apache-2.0
"""One shift: calibrate friction, work through the fifteen products, close every finger set once under the camera.

A set is closed before the camera when it has just been mounted; sets that the plan does without come first.

The node is the cell controller (services and actions of the cell only) and, on emulated hardware, the operator's
hands. It ends by itself and leaves ``shift.json`` for `ros2 run softgrip_demo report`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node

from softgrip_cell.errors import CellError
from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController
from softgrip_demo import film
from softgrip_demo.alignment import pair
from softgrip_demo.errors import ShiftError
from softgrip_demo.nodes import convert
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.operator import CellOperator
from softgrip_demo.nodes.watch import ShiftWatch
from softgrip_demo.products import expected_outcome, finger_design, product_names
from softgrip_demo.record import FrictionResult, GraspResult, ShiftClosing, ShiftFrame, ShiftRecord, ShiftStage
from softgrip_interfaces.srv import StopRecording
from softgrip_model.finger.matching import SPAN_NS
from softgrip_nodekit import Parameter, ParameterTable, StartupError, join_cell_time, make_executor
from softgrip_time.units import to_s
from softgrip_vision import calibration as vision
from softgrip_vision.calibration import PlaneMap

PARAMETERS = ParameterTable(
    Parameter("out", "out/demo", "folder for the record of the shift"),
    Parameter("seed", 1, "seed of the emulated cell, noted in the record", minimum=0),
    Parameter("watched_finger", "index", "the finger in front of the camera"),
    Parameter("finger_sets", ["hook", "pinch", "power"], "sets that are closed once"),
    Parameter("slots", ["index", "middle", "thumb"], "slots of the gripper"),
    Parameter("full_pull", 0.020, "pulled length at the end of a closing", "m", 0.001, 0.040),
    Parameter("closing_speed", 0.016, "speed of the watched closings", "m/s", 0.001, 0.1),
    Parameter("release_speed", 0.05, "speed of opening", "m/s", 0.001, 0.2),
    Parameter("start_timeout", 90.0, "time the cell has to come up", "s", 1.0, 600.0),
    Parameter(
        "expected_streams", ["tendon/state", "camera/image_raw/compressed"], "topics that say that the cell is up"
    ),
    Parameter("profile_dir", "", "folder of the finger profiles"),
    Parameter("calibration", "", "file with the camera's calibration"),
    Parameter("cable_radius", 0.000125, "of the cable on the rig", "m", 1e-5, 0.01),
    Parameter("surface_radius", 0.003, "of the printed surface on the rig", "m", 1e-4, 0.1),
    Parameter("film_product", "egg", "the product whose grasp is filmed"),
    Parameter("cross_check", False, "grasp every product with every finger set (Table 4.2), not only as planned"),
)


class Shift:
    """The sequence of one shift; every stage is timed."""

    def __init__(self, node: Node, executor: Executor, hands: Hands) -> None:
        self._values = PARAMETERS.declare(node)
        self._log = node.get_logger()
        self._link = CellLink(node, executor)
        self._hands = hands
        self._watch = ShiftWatch(node, self._values["watched_finger"])
        self._cell = CellController(node, wait=self._link.wait)
        self._operator = CellOperator(self._link, hands, self._cell, self._values["slots"])
        self._out = Path(self._values["out"])
        self._profiles = Path(self._values["profile_dir"])
        self._stage_wall_clock_s: dict[str, float] = {}
        self._film: tuple[ShiftFrame, ...] = ()
        self._mounted = ""
        self._swaps = 0

    def run(self) -> None:
        """Work through the shift and write its record.

        Raises:
            ShiftError: when the cell does not answer or refuses.
        """
        self._out.mkdir(parents=True, exist_ok=True)
        with self._stage("start"):
            self._wait_for_cell()
        with self._stage("friction"):
            friction = self._calibrate()
        closings, grasps = self._work_through(self._plan())
        with self._stage("bag"):
            bag = self._link.call(StopRecording, "recorder/stop", StopRecording.Request(), timeout=30.0)
        record = ShiftRecord(
            seed=self._values["seed"],
            friction=friction,
            closings=tuple(closings),
            grasps=tuple(grasps),
            swaps=self._swaps,
            film_product=self._values["film_product"],
            film=self._film,
            bag_path=bag.path,
            bag_messages=int(bag.messages),
            bag_topics=int(bag.topics),
            bag_dropped=int(bag.dropped),
            stages=tuple(ShiftStage(name, wall_clock_s) for name, wall_clock_s in self._stage_wall_clock_s.items()),
        )
        record.save(self._out / "shift.json")

    def _wait_for_cell(self) -> None:
        streams = set(self._values["expected_streams"])
        timeout = self._values["start_timeout"]
        try:
            # there is no time of the cell before it is up
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._link.until(lambda: streams <= self._watch.seen, timeout, "the cell's streams", steady)
        except ShiftError as error:
            missing = ", ".join(sorted(streams - self._watch.seen))
            raise ShiftError(f"no messages on {missing} within {timeout:g} s; see the log of the cell") from error

    def _calibrate(self) -> FrictionResult:
        result = self._operator.calibrate(self._values["cable_radius"], self._values["surface_radius"])
        friction = convert.friction_result(result)
        self._log.info(f"friction: {friction.verdict}, average error {100 * friction.average_error:.2f} %")
        return friction

    def _swap(self, finger_set: str) -> None:
        if finger_set != self._mounted:
            self._operator.swap(finger_set)
            self._mounted = finger_set
            self._swaps += 1

    def _closing(self, finger_set: str) -> ShiftClosing:
        """Mount a set and close it empty, 0 to full pull, in front of the camera."""
        self._swap(finger_set)
        # from then on predictions go by what the swap's closing has taught
        self._link.pause(to_s(SPAN_NS), "the cell's time to go on")
        self._watch.start_gathering()
        self._operator.move(self._values["full_pull"], self._values["closing_speed"])
        gathered = self._watch.end()
        self._operator.move(0.0, self._values["release_speed"])
        samples = pair(gathered.measured, gathered.predicted)
        if not samples:
            raise ShiftError(
                f"closing {finger_set}: expected frames with a measured and a predicted finger, found "
                f"{len(gathered.measured)} measured and {len(gathered.predicted)} predicted that do not meet in time"
            )
        self._log.info(f"closing {finger_set}: {len(samples)} frames, {len(gathered.shapes)} shapes")
        design = finger_design(self._profiles, finger_set, self._watch.finger)
        return ShiftClosing(finger_set, design.length_m, samples, convert.shape_view(gathered.shapes))

    def _grasp(self, product: str, finger_set: str) -> GraspResult:
        """Put a product down, have it grasped, take it away."""
        self._swap(finger_set)
        self._hands.place(product)
        filmed = product == self._values["film_product"] and not self._film
        if filmed:
            self._watch.start_gathering(film=True)
        result = self._cell.grasp(product, trial=True)
        latency = convert.outcome_latency(result, self._link.node.get_clock().now().nanoseconds)
        if filmed:
            self._film = self._develop(finger_set)
        self._cell.release()
        self._hands.place("")
        outcome = GRASP_OUTCOMES[result.outcome]
        self._log.info(f"{product} with {finger_set}: {outcome} ({result.reason})")
        return GraspResult(
            product=product,
            grasp=finger_set,
            outcome=outcome,
            expected=expected_outcome(product, finger_set),
            reason=result.reason,
            latency=latency,
        )

    def _develop(self, finger_set: str) -> tuple[ShiftFrame, ...]:
        gathered = self._watch.end()
        calibration = vision.load(Path(self._values["calibration"]))
        finger = self._watch.finger
        design = finger_design(self._profiles, finger_set, finger)
        return film.make(
            gathered.frames,
            gathered.predicted,
            design.link_lengths_m,
            PlaneMap(calibration.lens, calibration.plane(finger)),
            self._out,
        )

    def _plan(self) -> list[tuple[str, list[str]]]:
        """Return (finger set, products) in the order of work: as planned, or everything with everything."""
        products = product_names()
        if self._values["cross_check"]:
            return [(finger_set, products) for finger_set in self._values["finger_sets"]]
        plan = self._cell.plan(products, [1] * len(products))
        self._log.info(f"plan: {plan.swaps} swaps, sets that the mix can do without: {list(plan.redundant_sets)}")
        runs = groupby(plan.steps, key=lambda step: step.finger_set)
        return [(finger_set, [step.product for step in steps]) for finger_set, steps in runs]

    def _work_through(self, plan: Sequence[tuple[str, list[str]]]) -> tuple[list[ShiftClosing], list[GraspResult]]:
        planned = {finger_set for finger_set, _ in plan}
        unplanned = [finger_set for finger_set in self._values["finger_sets"] if finger_set not in planned]
        closings: dict[str, ShiftClosing] = {}
        grasps: list[GraspResult] = []
        for finger_set, products in [*((finger_set, list[str]()) for finger_set in unplanned), *plan]:
            if finger_set not in closings:
                with self._stage("closings"):
                    closings[finger_set] = self._closing(finger_set)
            if products:
                with self._stage("grasps"):
                    grasps += [self._grasp(product, finger_set) for product in products]
        return list(closings.values()), grasps

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        self._log.info(f"== {name}")
        start = time.monotonic()
        yield
        self._stage_wall_clock_s[name] = self._stage_wall_clock_s.get(name, 0.0) + time.monotonic() - start


def main(args: Sequence[str] | None = None) -> int:
    """Run one shift; exit code 0 when it reached its end."""
    rclpy.init(args=list(args) if args is not None else None)
    node = Node("shift")
    join_cell_time(node)
    executor = make_executor(node)
    executor.add_node(node)
    hands = Hands(node.get_namespace())
    try:
        Shift(node, executor, hands).run()
    except (ShiftError, CellError, StartupError) as error:
        print(f"[shift] {error}", file=sys.stderr, flush=True)  # noqa: T201  the log may be down
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    finally:
        hands.close()
        executor.shutdown(timeout_sec=2.0)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
