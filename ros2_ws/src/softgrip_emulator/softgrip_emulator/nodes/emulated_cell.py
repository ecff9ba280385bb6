# SPDX-License-Identifier: Apache-2.0
"""The emulated cell as a node: makes the wires, offers a person's hands as services, publishes the truth."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from builtin_interfaces.msg import Time
from rclpy._rclpy_pybind11 import RCLError
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature

from softgrip_emulator.camera.exposure_sample import CameraSettings
from softgrip_emulator.cell import EmulatedCell
from softgrip_emulator.dynamixel.table import BAUD_OF_REGISTER
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.faults import read_plan
from softgrip_emulator.nodes import convert
from softgrip_emulator.plant.cell import ServoPlace, Supply
from softgrip_emulator.rig.emulated import LINE_GAUGES
from softgrip_emulator.servos import available_models, factory_settings, load_ratings
from softgrip_emulator.thermometer import OFFSET_STDDEV_K, PERIOD_S
from softgrip_emulator.wire.folder import default_wire_folder
from softgrip_interfaces.msg import EmulatorTruth
from softgrip_interfaces.srv import InjectFault, MountFingers, PlaceObject, SetRig
from softgrip_model.profile import ProfileError, load_profiles
from softgrip_nodekit import (
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    Rank,
    answer,
    claim_name,
    realtime_parameter,
    run,
    startup_errors,
    to_time_message,
)
from softgrip_time.units import to_ns

PARAMETERS = ParameterTable(
    Parameter(
        "wire_dir",
        "",
        "folder where servos, stand, gauge and the camera's files appear; empty = this user's own softgrip",
    ),
    Parameter(
        "seed", 1, "of everything the emulated cell draws: fingers, friction, products, camera", "", 0, 2**31 - 1
    ),
    Parameter("time_scale", 1.0, "how much faster than the cell's time the friction rig lives", "", 0.1, 1000.0),
    Parameter(
        "speed",
        1.0,
        "cell seconds a second at most; 0 = as fast as all participants keep up (docs/emulator.md)",
        "",
        0.0,
        1000.0,
    ),
    Parameter(
        "expected",
        [""],
        "nodes that take part in the cell's time; without one of them it goes no faster than the computer's",
    ),
    Parameter("profiles_directory", "", "folder of finger profiles; empty = those of softgrip_bringup"),
    Parameter("fingers", ["index", "middle", "thumb"], "slots, each with a servo"),
    Parameter(
        "mounted_profiles", ["power", "power", "power"], "profile of the finger in each slot at start, '' = empty"
    ),
    Parameter("mounted_serials", ["PW-I-01", "PW-M-01", "PW-T-01"], "serial of the finger in each slot at start"),
    Parameter("servo_ids", [1, 2, 3], "ID of the servo of each slot", "", 0, 252),
    Parameter("servo_model", "xl330_m288", "model of all servos", choices=tuple(available_models())),
    Parameter("servo_baud", 1_000_000, "speed the servos listen at", "bit/s", choices=tuple(BAUD_OF_REGISTER.values())),
    Parameter(
        "factory_fresh",
        False,
        "servos as they come (ID 1; Dynamixel at 57600 baud, Feetech at 1 Mbaud), each off the cable until "
        "servo_unplugged of its slot is cleared",
    ),
    Parameter(
        "spool_directions", [1, 1, 1], "of each slot, -1: the tendon comes off the other side of its spool", "", -1, 1
    ),
    Parameter(
        "adapter_latency_s",
        0.0,
        "latency timer of the servos' USB adapter, 0.016 as it comes; 0 = none",
        "s",
        0.0,
        0.255,
    ),
    Parameter("servo_return_delay_us", 500, "return delay set in the servos", "us", 0, 508),
    Parameter(
        "servo_current_limit",
        "supply",
        "which current Goal Current limits in XL330 and XC330, whose maker does not say",
        choices=("supply", "winding"),
    ),
    Parameter("spool_radius_m", 0.010, "of every spool as designed; the true ones scatter by 0.3 %", "m", 0.002, 0.05),
    Parameter("supply_v", 0.0, "supply of the servos; 0 = nominal for the model", "V", 0.0, 24.0),
    Parameter("camera_width", 640, "of the camera's frames", "px", 160, 1920),
    Parameter("camera_height", 480, "of the camera's frames", "px", 120, 1080),
    Parameter("camera_fps", 30.0, "frames a second", "Hz", 1.0, 120.0),
    Parameter("camera_port", 0, "TCP port of the stream on 127.0.0.1, 0 = a free one (see camera.url)", "", 0, 65535),
    Parameter("jpeg_quality", 88, "of the stream", "%", 10, 100),
    Parameter("camera_realtime_priority", 0, "of the camera's process; 0 = as any other", "", 0, 99),
    Parameter("rig_stage", "mark10", "stage of the friction rig", choices=("mark10", "grbl", "grblhal")),
    Parameter(
        "rig_gauge", "gcl2", "its force gauge: gcl2, or one that speaks in lines", choices=("gcl2", *LINE_GAUGES)
    ),
    Parameter(
        "gauge_on", "", "slot whose tendon the force gauge hangs in, to calibrate its servo; empty = the rig's cable"
    ),
    Parameter("fault_plan", "", "YAML file with faults at times or at random; empty = none"),
    Parameter("truth_rate", 30.0, "of emulator/truth, in the cell's time", "Hz", 0.1, 200.0),
    realtime_parameter(Rank.EMULATED_HARDWARE),
)


_CLOCK_PERIOD_S: Final = 0.02
"""Least time of the cell between two messages on /clock."""
_CLOCK_REST_PERIOD_S: Final = 0.06
"""The same while no driver works: half of the lag that followers have then."""
_CLOCK_REPEATED_S: Final = 0.1
"""A time that stands is published again after this, by the computer's clock, for nodes that have just started."""
_SWITCH_INTERVAL_S: Final = 0.0005
_LEAVE_S: Final = 3.0
"""So long [s] other programs may take to leave the wires; `ros2 launch` sends its second signal after 5 s."""


class EmulatedCellNode(CellNode):
    """Translates between services and an `EmulatedCell`."""

    def __init__(self) -> None:
        super().__init__("emulated_cell")
        values = PARAMETERS.declare(self)
        self._cell: EmulatedCell | None = None
        self._name_lock = claim_name(self)  # before the wires of another cell are touched
        self._clock_publisher = self.create_publisher(Clock, "/clock", SENSOR)
        self._published_s = self._published_at = -1.0
        self._truth = self.create_publisher(EmulatorTruth, "emulator/truth", SENSOR)
        self._truth_period_s = 1.0 / values["truth_rate"]
        self._truth_due_s = 0.0
        self._temperature = self.create_publisher(Temperature, "cell/temperature", SENSOR)
        self._temperature_due_s = 0.0
        self._cell = cell = _open_cell(values, self._on_tick)
        self._diagnostics = Diagnostics(self, "emulated")
        # The wires exist by now: whoever waits for these services may open them at once.
        self.create_service(MountFingers, "emulator/mount", self._on_mount)
        self.create_service(PlaceObject, "emulator/place_object", self._on_place)
        self.create_service(InjectFault, "emulator/inject_fault", self._on_fault)
        self.create_service(SetRig, "emulator/set_rig", self._on_rig)
        self.create_timer(1.0, self._report)
        self.get_logger().info(f"wires in {cell.wire_dir}, camera at {cell.stream_url}")

    @property
    def cell(self) -> EmulatedCell:
        """The cell; there is one from construction to `close`."""
        assert self._cell is not None
        return self._cell

    def _on_mount(self, request: MountFingers.Request, response: MountFingers.Response) -> MountFingers.Response:
        return answer(response, lambda: self._mount(request), EmulatorError)

    def _mount(self, request: MountFingers.Request) -> str:
        self.cell.plant.mount(request.fingers, request.serials, request.profiles)
        mounted = [f"{f.serial} ({f.profile})" if f else "empty" for f in self.cell.plant.mounted]
        return "mounted: " + ", ".join(mounted)

    def _on_place(self, request: PlaceObject.Request, response: PlaceObject.Response) -> PlaceObject.Response:
        return answer(response, lambda: self._place(request), EmulatorError)

    def _place(self, request: PlaceObject.Request) -> str:
        self.cell.plant.place(request.product, request.offset)
        return f"{request.product} between the fingers" if request.product else "nothing between the fingers"

    def _on_fault(self, request: InjectFault.Request, response: InjectFault.Response) -> InjectFault.Response:
        answer(response, lambda: self._inject(request), EmulatorError)
        response.active = list(self.cell.faults.active)
        return response

    def _inject(self, request: InjectFault.Request) -> str:
        arguments = convert.to_fault_arguments(request.arguments)
        self.cell.faults.inject(request.fault, request.target, request.duration, arguments)
        return f"{request.fault}: done"

    def _on_rig(self, request: SetRig.Request, response: SetRig.Response) -> SetRig.Response:
        return answer(response, lambda: self._set_rig(request), EmulatorError)

    def _set_rig(self, request: SetRig.Request) -> str:
        self.cell.rig.set(request.angle, request.load)
        return f"angle {request.angle:.3f} rad, load {request.load:.3f} kg"

    def _publish_truth(self) -> None:
        self._truth.publish(convert.to_truth_message(self.cell.truth(), self._stamp()))

    def _on_tick(self) -> None:
        """Publish the time and the truth; in the thread that drives it."""
        cell = self._cell
        if cell is None or not self.context.ok():
            return
        try:
            self._publish_due(cell)
        except RCLError:
            if self.context.ok():  # else a signal has just ended it
                raise

    def _publish_due(self, cell: EmulatedCell) -> None:
        now_s, computer_s = cell.clock.now_s(), time.monotonic()
        period_s = _CLOCK_REST_PERIOD_S if cell.time_server.participants.is_resting else _CLOCK_PERIOD_S
        if now_s - self._published_s > 0.999 * period_s or computer_s - self._published_at > _CLOCK_REPEATED_S:
            self._published_s, self._published_at = now_s, computer_s
            self._clock_publisher.publish(Clock(clock=self._stamp()))
        if now_s >= self._truth_due_s:
            self._truth_due_s = max(self._truth_due_s + self._truth_period_s, now_s)
            self._publish_truth()
        if now_s >= self._temperature_due_s:
            self._temperature_due_s = now_s + PERIOD_S
            self._publish_temperature()

    def _publish_temperature(self) -> None:
        message = Temperature(temperature=self.cell.thermometer.read_c(), variance=OFFSET_STDDEV_K**2)
        message.header.stamp, message.header.frame_id = self._stamp(), "room"
        self._temperature.publish(message)

    def _stamp(self) -> Time:
        return to_time_message(to_ns(self.cell.epoch_time_s()))

    def _report(self) -> None:
        values = {
            "packets": self.cell.chain.packets_seen,
            "frames": self.cell.camera.frames_taken,
            "faults": ", ".join(self.cell.faults.active) or "none",
        }
        self._diagnostics.set("plant", Health.OK, "lives", values)
        self._report_time()
        if self.cell.camera.running:
            self._diagnostics.set("camera", Health.OK, "takes frames while somebody looks")
        else:
            message = "the camera's process ended: expected it to run as long as the cell; start the cell again"
            self._diagnostics.set("camera", Health.ERROR, message)

    def _report_time(self) -> None:
        server = self.cell.time_server
        participants = list(server.participants.all)
        given_up = sorted({one.label for one in participants if one.is_given_up})
        values = {"now_s": f"{self.cell.clock.now_s():.1f}"}
        values |= {f"held by {label} [s]": f"{duration_s:.1f}" for label, duration_s in dict(server.held_s).items()}
        if given_up:
            message = f"goes on without {', '.join(given_up)}: silent for {server.participants.give_up_s:g} s"
            self._diagnostics.set("time", Health.WARN, message, values)
        else:
            names = ", ".join(sorted({one.join.name for one in participants}))
            self._diagnostics.set("time", Health.OK, f"waits for {names}" if names else "the computer's", values)

    def close(self) -> None:
        """Take the wires away, once the programs that use them have left: one Ctrl-C ends them all at once."""
        if self._cell is not None:
            self._cell.await_hosts(_LEAVE_S)
            self._cell.close()
        self._name_lock.close()


@startup_errors(EmulatorError, ProfileError, OSError)
def _open_cell(values: dict[str, Any], on_tick: Callable[[], None]) -> EmulatedCell:
    cell = EmulatedCell(
        load_profiles(values["profiles_directory"]),
        Path(values["wire_dir"]) if values["wire_dir"] else default_wire_folder(),
        seed=values["seed"],
        rig_time_scale=values["time_scale"],
        speed=values["speed"],
        expected=[name for name in values["expected"] if name],
        on_tick=on_tick,
        chain=_chain(values),
        supply=_supply(values),
        camera=CameraSettings(
            values["camera_width"],
            values["camera_height"],
            values["camera_fps"],
            values["camera_port"],
            values["jpeg_quality"],
            values["camera_realtime_priority"],
        ),
        gauge_on=values["gauge_on"],
        stage=values["rig_stage"],
        gauge=values["rig_gauge"],
        adapter_latency_s=values["adapter_latency_s"],
    )
    cell.plant.mount(values["fingers"], values["mounted_serials"], values["mounted_profiles"])
    if values["factory_fresh"]:
        for slot in values["fingers"]:
            cell.faults.inject("servo_unplugged", slot)
    if values["fault_plan"]:
        cell.faults.follow(read_plan(Path(values["fault_plan"]).read_text(encoding="utf-8")))
    return cell.open()


def _chain(values: dict[str, Any]) -> list[ServoPlace]:
    slots = values["fingers"]
    for name in ("servo_ids", "spool_directions"):
        if len(slots) != len(values[name]):
            raise EmulatorError(f"parameter '{name}': expected one for each of {slots}, found {values[name]}")
    fresh = factory_settings(values["servo_model"]) if values["factory_fresh"] else None
    return [
        ServoPlace(
            slot,
            device_id if fresh is None else fresh[0],
            values["servo_model"],
            values["servo_baud"] if fresh is None else fresh[1],
            values["servo_return_delay_us"],
            values["spool_radius_m"],
            direction,
            limits_winding=values["servo_current_limit"] == "winding",
        )
        for slot, device_id, direction in zip(slots, values["servo_ids"], values["spool_directions"], strict=True)
    ]


def _supply(values: dict[str, Any]) -> Supply:
    return Supply(values["supply_v"] or load_ratings(values["servo_model"]).nominal_voltage_v)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    # The bus must answer within fractions of a millisecond while the plant computes.
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    sys.exit(run(EmulatedCellNode, args))


if __name__ == "__main__":
    main()
