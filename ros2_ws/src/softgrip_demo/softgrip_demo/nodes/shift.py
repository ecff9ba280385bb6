# SPDX-License-Identifier: Apache-2.0
"""One shift: calibrate friction, close every finger set once under the camera, work through the fifteen products.

The node is the cell controller (services and actions of the cell only) and, on emulated hardware, the operator's
hands. It ends by itself and leaves ``shift.json`` for `ros2 run softgrip_demo report`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_demo.errors import ShiftError
from softgrip_demo.nodes import convert
from softgrip_demo.nodes.controller import Controller
from softgrip_demo.nodes.hands import Hands
from softgrip_demo.nodes.link import CellLink
from softgrip_demo.nodes.watch import Watch
from softgrip_demo.record import Closing, FrictionResult, GraspResult, ShiftRecord, Stage
from softgrip_interfaces.action import CalibrateFriction, MoveTendon
from softgrip_interfaces.srv import StopRecording
from softgrip_nodekit import Parameter, ParameterTable, StartupError

PARAMETERS = ParameterTable(
    Parameter("out", "out/demo", "folder for the record of the shift"),
    Parameter("seed", 1, "seed of the emulated cell, noted in the record", minimum=0),
    Parameter("watched_finger", "index", "the finger in front of the camera"),
    Parameter("finger_sets", ["power", "pinch", "hook"], "sets that are closed once, in this order"),
    Parameter("slots", ["index", "middle", "thumb"], "slots of the gripper"),
    Parameter("full_pull", 0.020, "pulled length at the end of a closing", "m", 0.001, 0.040),
    Parameter("closing_speed", 0.012, "speed of the watched closings", "m/s", 0.001, 0.1),
    Parameter("release_speed", 0.05, "speed of opening", "m/s", 0.001, 0.2),
    Parameter("start_timeout", 10.0, "time the cell has to come up", "s", 1.0, 120.0),
    Parameter("film_product", "egg", "the product whose grasp is filmed"),
    Parameter("cross_check", False, "grasp every product with every finger set (Table 4.2), not only as planned"),
)


class Shift:
    """The sequence of one shift; every stage is timed."""

    def __init__(self, node: Node, executor: Any) -> None:
        self._values = PARAMETERS.declare(node)
        self._log = node.get_logger()
        self._link = CellLink(node, executor)
        self._hands = Hands(self._link)
        self._watch = Watch(node, self._values["watched_finger"])
        self._controller = Controller(self._link, self._hands, self._values["slots"])
        self._out = Path(self._values["out"])
        self._stages: list[Stage] = []
        self._film: tuple[Any, ...] = ()

    def run(self) -> ShiftRecord:
        """Work through the shift.

        Raises:
            ShiftError: when the cell does not answer or refuses.
        """
        self._out.mkdir(parents=True, exist_ok=True)
        with self._stage("start"):
            self._wait_for_cell()
        with self._stage("friction"):
            friction = self._calibrate()
        with self._stage("closings"):
            self._link.call(Trigger, "tendon/home", Trigger.Request(), timeout=30.0)
            closings = [self._closing(name) for name in self._values["finger_sets"]]
        with self._stage("grasps"):
            grasps = self._grasps()
        with self._stage("bag"):
            bag = self._link.call(StopRecording, "recorder/stop", StopRecording.Request(), timeout=30.0)
        return ShiftRecord(
            seed=self._values["seed"],
            friction=friction,
            closings=tuple(closings),
            grasps=tuple(grasps),
            swaps=self._controller.swaps,
            film_product=self._values["film_product"],
            film=self._film,
            bag_path=bag.path,
            bag_messages=int(bag.messages),
            bag_topics=int(bag.topics),
            bag_dropped=int(bag.dropped),
            stages=tuple(self._stages),
        )

    def _wait_for_cell(self) -> None:
        streams = {"tendon/state", "finger/measured", "finger/predicted", "shape/predicted"}
        timeout = self._values["start_timeout"]
        self._link.until(lambda: streams <= self._watch.seen, timeout, f"messages on {', '.join(sorted(streams))}")

    def _calibrate(self) -> FrictionResult:
        """Nine points (Table 3.3), the operator setting angle and weight as the rig asks."""
        confirm = self._link.node.create_client(Trigger, "rig/confirm")
        asked: list[tuple[float, float]] = []

        def on_feedback(feedback: Any) -> None:
            if feedback.phase == feedback.SET_UP:
                asked.append((feedback.angle, feedback.load))
                self._log.info(f"rig: {feedback.instruction}")
                done = self._hands.set_rig_async(feedback.angle, feedback.load)
                done.add_done_callback(lambda _: confirm.call_async(Trigger.Request()))

        goal = CalibrateFriction.Goal(
            plan="9",
            law="matte",
            cable="PE braid 0.25 mm",
            surface="TPU, printed along the layers",
            cable_radius=convert.CABLE_RADIUS_M,
            surface_radius=convert.SURFACE_RADIUS_M,
            activate=True,
        )
        result = self._link.act(CalibrateFriction, "rig/calibrate", goal, feedback=on_feedback, timeout=120.0)
        if result.outcome != result.SUCCEEDED:
            raise ShiftError(f"friction calibration failed: {result.reason}")
        friction = convert.friction_result(result)
        self._log.info(f"friction: {friction.verdict}, average error {100 * friction.average_error:.2f} %")
        return friction

    def _closing(self, finger_set: str) -> Closing:
        """Mount a set and close it empty, 0 to full pull, in front of the camera."""
        self._controller.swap(finger_set)
        self._watch.begin()
        self._move(self._values["full_pull"], self._values["closing_speed"])
        gathered = self._watch.end()
        self._move(0.0, self._values["release_speed"])
        closing = convert.closing(finger_set, self._values["watched_finger"], gathered)
        if not closing.samples:
            raise ShiftError(
                f"closing {finger_set}: expected frames with a measured and a predicted finger, found "
                f"{len(gathered.measured)} measured and {len(gathered.predicted)} predicted that do not meet in time"
            )
        self._log.info(f"closing {finger_set}: {len(closing.samples)} frames, {len(gathered.shapes)} shapes")
        return closing

    def _grasps(self) -> list[GraspResult]:
        results = []
        for product, finger_set in self._work():
            self._controller.swap(finger_set)
            self._hands.place(product)
            filmed = product == self._values["film_product"] and not self._film
            if filmed:
                self._watch.begin(film=True)
            result = self._controller.grasp(product, finger_set)
            if filmed:
                self._film = convert.film(finger_set, self._watch.finger, self._watch.end(), self._out)
            self._controller.release()
            self._hands.place("")
            results.append(result)
            self._log.info(f"{product} with {finger_set}: {result.outcome} ({result.reason})")
        return results

    def _work(self) -> Iterator[tuple[str, str]]:
        if self._values["cross_check"]:
            for finger_set in self._values["finger_sets"]:
                for product in self._controller.products:
                    yield product, finger_set
        else:
            yield from self._controller.plan()

    def _move(self, pulled_length: float, speed: float) -> None:
        goal = MoveTendon.Goal(mode=MoveTendon.Goal.LENGTH, targets=[pulled_length], speed=speed)
        result = self._link.act(MoveTendon, "tendon/move", goal, timeout=30.0)
        if result.outcome not in {result.REACHED, result.TENSION_LIMIT}:
            raise ShiftError(f"tendon/move to {1000 * pulled_length:g} mm ended otherwise: {result.reason}")

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        self._log.info(f"== {name}")
        start = time.monotonic()
        yield
        self._stages.append(Stage(name, time.monotonic() - start))


def main(args: Sequence[str] | None = None) -> int:
    """Run one shift; exit code 0 when it reached its end."""
    rclpy.init(args=list(args) if args is not None else None)
    node = Node("shift")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        shift = Shift(node, executor)
        record = shift.run()
        record.save(Path(node.get_parameter("out").value) / "shift.json")
    except (ShiftError, StartupError) as error:
        print(f"[shift] {error}", file=sys.stderr, flush=True)  # noqa: T201  the log may be down
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    finally:
        executor.shutdown(timeout_sec=2.0)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
