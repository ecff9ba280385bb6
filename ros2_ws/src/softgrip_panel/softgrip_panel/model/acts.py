# SPDX-License-Identifier: Apache-2.0
"""Acts as values: what a click calls, who may do it, and the `ros2` command that does the same.

A page makes an act (`estop()`, `grasp("egg")`) and hands it to the node; nothing else of the panel reaches the cell.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import yaml

from softgrip_panel.model.parameters import ParameterKind
from softgrip_panel.model.roles import Role


class CallKind(StrEnum):
    """How ROS is asked."""

    SERVICE = "service"
    ACTION = "action"


@dataclass(frozen=True)
class RosCall:
    """A service or action with its request.

    Attributes:
        kind: service or action.
        name: relative to the cell's namespace.
        type_name: as `ros2` writes it, such as "std_srvs/srv/Trigger".
        request: field values.
    """

    kind: CallKind
    name: str
    type_name: str
    request: Mapping[str, object] = field(default_factory=dict)

    def command_line(self, namespace: str = "/") -> str:
        """Return the `ros2` command that does the same."""
        full = f"{namespace.rstrip('/')}/{self.name}"
        request = yaml.safe_dump(dict(self.request), default_flow_style=True, sort_keys=False, width=10_000).strip()
        verb = ["service", "call"] if self.kind is CallKind.SERVICE else ["action", "send_goal", "--feedback"]
        return shlex.join(["ros2", *verb, full, self.type_name, request])


@dataclass(frozen=True)
class Act:
    """What a person wants done.

    Attributes:
        name: of the act, for texts ("act.NAME") and the record.
        call: what does it.
        role: at least needed.
        needs_control: only the owner of control may; stopping and letting go are everybody's.
        subject: what it is about, for the record.
        timeout_s: longest wait for the answer [s].
        is_secret: its request holds a token, which no page and no record shows.
        is_urgent: waits for no disk, and is asked again while no answer comes; must be the same when it is done twice.
    """

    name: str
    call: RosCall
    role: Role = Role.OPERATE
    needs_control: bool = True
    subject: str = ""
    timeout_s: float = 10.0
    is_secret: bool = False
    is_urgent: bool = False


@dataclass(frozen=True)
class ActResult:
    """What came of it: the cell's own words, and how long it took [s]."""

    success: bool
    message: str
    took_s: float = 0.0
    answer: Any = None


def _service(name: str, type_name: str, **request: object) -> RosCall:
    return RosCall(CallKind.SERVICE, name, type_name, request)


def _action(name: str, type_name: str, **goal: object) -> RosCall:
    return RosCall(CallKind.ACTION, name, type_name, goal)


_TRIGGER = "std_srvs/srv/Trigger"
_INTERFACES = "softgrip_interfaces"
#: Of lifecycle_msgs/msg/Transition.
_TRANSITIONS = {"configure": 1, "cleanup": 2, "activate": 3, "deactivate": 4}
#: Of MoveTendon.
_LENGTH, _TENSION = 1, 2
#: Of ConfirmStep; 0 is none of them, and refused.
_CONFIRMED = {"open_palm": 3, "remove": 4, "insert": 5, "close_palm": 6, "hands_out": 10}


def estop() -> Act:
    """Stop: whoever sees the page may. A request is lost where its link ends, so it is repeated."""
    call = _service("estop", _TRIGGER)
    return Act("estop", call, Role.LOOK, needs_control=False, timeout_s=5.0, is_urgent=True)


def estop_reset() -> Act:
    """End the emergency stop."""
    return Act("estop_reset", _service("estop_reset", _TRIGGER))


def release() -> Act:
    """Let go slowly of what is held; a person may always ask for it."""
    return Act("release", _service("tendon/release", _TRIGGER), needs_control=False)


def home() -> Act:
    """Find the zero of every tendon."""
    return Act("home", _service("tendon/home", _TRIGGER), timeout_s=60.0)


def grasp(product: str, *, confirm_lift: bool = True, trial: bool = False) -> Act:
    """Grasp a product and hold it."""
    call = _action("cell/grasp", f"{_INTERFACES}/action/Grasp", product=product, confirm_lift=confirm_lift, trial=trial)
    return Act("grasp", call, subject=product, timeout_s=120.0)


def select(product: str) -> Act:
    """Ask how a product is to be grasped."""
    call = _service("cell/select_product", f"{_INTERFACES}/srv/SelectProduct", product=product)
    return Act("select", call, needs_control=False, subject=product)


def plan(products: Sequence[str], quantities: Sequence[int], *, keep_order: bool) -> Act:
    """Ask for the order of work."""
    call = _service(
        "cell/plan_mix",
        f"{_INTERFACES}/srv/PlanMix",
        products=list(products),
        quantities=list(quantities),
        keep_order=keep_order,
    )
    return Act("plan", call, Role.LOOK, needs_control=False, subject=f"{sum(quantities)} products")


def swap(finger_set: str, serials: Sequence[str] = ()) -> Act:
    """Swap fingers, step by step."""
    call = _action("cell/swap", f"{_INTERFACES}/action/SwapFingers", finger_set=finger_set, serials=list(serials))
    return Act("swap", call, subject=finger_set, timeout_s=600.0)


def confirm_step(step: str, token: str, serials: Sequence[str] = ()) -> Act:
    """Confirm that a step of the swap is done."""
    call = _service(
        "cell/confirm_step",
        f"{_INTERFACES}/srv/ConfirmStep",
        step=_CONFIRMED.get(step, 0),
        token=token,
        serials=list(serials),
    )
    return Act("confirm_step", call, subject=" ".join((step, *serials)), is_secret=True)


def retire_finger(serial: str, who: str, reason: str) -> Act:
    """Take a finger out of use for good."""
    call = _service("cell/retire_finger", f"{_INTERFACES}/srv/RetireFinger", serial=serial, who=who, reason=reason)
    return Act("retire_finger", call, Role.ENGINEER, needs_control=False, subject=serial)


def calibrate(
    plan: str, cable: str, surface: str, cable_radius_m: float, surface_radius_m: float, *, resume: bool
) -> Act:
    """Measure friction point by point; nothing becomes active by it."""
    call = _action(
        "rig/calibrate",
        f"{_INTERFACES}/action/CalibrateFriction",
        plan=plan,
        cable=cable,
        surface=surface,
        cable_radius=cable_radius_m,
        surface_radius=surface_radius_m,
        resume=resume,
        activate=False,
    )
    return Act("calibrate", call, subject=f"plan {plan}", timeout_s=4 * 3600.0)


def confirm_rig() -> Act:
    """Confirm that angle and weight are set."""
    return Act("confirm_rig", _service("rig/confirm", _TRIGGER))


def activate_friction(model: str, reason: str) -> Act:
    """Make a friction model the active one; the reason goes into the record."""
    call = _service("friction/activate", f"{_INTERFACES}/srv/ActivateFrictionModel", id=model)
    return Act("activate_friction", call, subject=f"{model}: {reason}")


def refuse_friction(model: str, who: str, reason: str) -> Act:
    """Refuse a friction model: it stays as it is, and who refused it and why goes into the audit table."""
    call = _service(
        "cell/write_audit",
        f"{_INTERFACES}/srv/WriteAudit",
        who=who,
        action="refuse friction model",
        subject=model,
        detail=reason,
    )
    return Act("refuse_friction", call, subject=f"{model}: {reason}")


def set_rig(angle_rad: float, load_kg: float) -> Act:
    """Emulated cell only: set the wrap angle and hang a weight."""
    call = _service("emulator/set_rig", f"{_INTERFACES}/srv/SetRig", angle=angle_rad, load=load_kg)
    return Act("set_rig", call, subject=f"{angle_rad:.2f} rad, {load_kg:.2f} kg")


def start_recording() -> Act:
    """Begin a bag."""
    return Act("start_recording", _service("recorder/start", f"{_INTERFACES}/srv/StartRecording", path=""))


def stop_recording() -> Act:
    """End the bag."""
    return Act("stop_recording", _service("recorder/stop", f"{_INTERFACES}/srv/StopRecording"), timeout_s=30.0)


def split_recording() -> Act:
    """Go on in a new file."""
    return Act("split_recording", _service("recorder/split", f"{_INTERFACES}/srv/SplitRecording"), timeout_s=30.0)


def snapshot(seconds: float = 0.0) -> Act:
    """Write the last seconds to a bag of their own."""
    call = _service("recorder/snapshot", f"{_INTERFACES}/srv/SnapshotRecording", path="", seconds=seconds)
    return Act("snapshot", call, needs_control=False, timeout_s=30.0)


def place_object(product: str) -> Act:
    """Emulated cell only: put a product between the fingers; an empty name takes it away."""
    call = _service("emulator/place_object", f"{_INTERFACES}/srv/PlaceObject", product=product, offset=0.0)
    return Act("place_object", call, subject=product)


def mount_fingers(fingers: Sequence[str], serials: Sequence[str], profiles: Sequence[str]) -> Act:
    """Emulated cell only: put fingers into the slots; empty serials leave them empty."""
    call = _service(
        "emulator/mount",
        f"{_INTERFACES}/srv/MountFingers",
        fingers=list(fingers),
        serials=list(serials),
        profiles=list(profiles),
    )
    return Act("mount_fingers", call, subject=" ".join(filter(None, serials)))


def set_driver(transition: str) -> Act:
    """Make a transition of the driver's lifecycle: cleanup closes the bus, activate takes hold of the tendons."""
    call = _service(
        "tendon_driver/change_state",
        "lifecycle_msgs/srv/ChangeState",
        transition={"id": _TRANSITIONS[transition], "label": transition},
    )
    return Act("set_driver", call, Role.ENGINEER, subject=transition, timeout_s=90.0)


def pull(tension_n: float, speed_m_s: float) -> Act:
    """Pull all tendons to a tension and hold it."""
    return _move("pull", _TENSION, tension_n, speed_m_s, 0.0, f"{tension_n:g} N")


def slacken(speed_m_s: float, tension_limit_n: float) -> Act:
    """Pay all tendons out to their zero."""
    return _move("slacken", _LENGTH, 0.0, speed_m_s, tension_limit_n, "")


def _move(name: str, mode: int, target: float, speed_m_s: float, tension_limit_n: float, subject: str) -> Act:
    call = _action(
        "tendon/move",
        f"{_INTERFACES}/action/MoveTendon",
        mode=mode,
        targets=[target],
        speed=speed_m_s,
        tension_limit=tension_limit_n,
    )
    return Act(name, call, Role.ENGINEER, subject=subject, timeout_s=60.0)


def set_parameter(node: str, name: str, kind: ParameterKind, value: object) -> Act:
    """Set a parameter of a node while it runs."""
    setting = {"name": name, "value": {"type": int(kind), kind.field: value}}
    call = _service(f"{node}/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=[setting])
    return Act("set_parameter", call, Role.ENGINEER, subject=f"{node} {name} {value}")


def set_camera_info(
    width: int, height: int, matrix: Sequence[float], distortion: Sequence[float], distortion_model: str
) -> Act:
    """Give the camera a lens, as cameracalibrator does."""
    k = [float(one) for one in matrix]
    info = {
        "width": width,
        "height": height,
        "distortion_model": distortion_model,
        "d": [float(one) for one in distortion],
        "k": k,
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    }
    call = _service("camera/set_camera_info", "sensor_msgs/srv/SetCameraInfo", camera_info=info)
    return Act("set_camera_info", call, Role.ENGINEER, subject=f"{width}x{height}")


#: One of each, for the documentation and for the tests of access: what the panel may ever call.
EXAMPLES: tuple[Act, ...] = (
    estop(),
    estop_reset(),
    release(),
    home(),
    select("egg"),
    grasp("egg"),
    plan(["egg", "grape"], [10, 5], keep_order=False),
    swap("power"),
    confirm_step("insert", "0f2c", ["PW-I-01", "PW-M-01", "PW-T-01"]),
    retire_finger("PW-I-01", "Ada", "tore at joint 1"),
    calibrate("9", "PE braid 0.25 mm", "TPU", 0.000125, 0.003, resume=False),
    confirm_rig(),
    activate_friction("braid-tpu", "fresh cable"),
    refuse_friction("braid-tpu", "Ada", "the cable was old"),
    set_rig(1.57, 0.5),
    start_recording(),
    stop_recording(),
    split_recording(),
    snapshot(30.0),
    place_object("egg"),
    mount_fingers(["index", "middle", "thumb"], ["PW-I-01", "PW-M-01", "PW-T-01"], ["power", "power", "power"]),
    set_driver("cleanup"),
    pull(5.0, 0.02),
    slacken(0.02, 5.0),
    set_parameter("camera", "jpeg_quality", ParameterKind.INTEGER, 80),
    set_camera_info(640, 480, [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0], [0.0] * 5, "plumb_bob"),
)
