# SPDX-License-Identifier: Apache-2.0
"""Node panel: the operator's web page, a client of the cell's topics, services and actions."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, JointState

from softgrip_interfaces.msg import (
    CellState,
    FingerMarkers,
    FingerStates,
    PredictedShape,
    PredictionResidual,
    RigProgress,
    SafetyState,
    SwapProgress,
    TendonOwners,
    TendonStatusArray,
)
from softgrip_interfaces.srv import ListFingers, ListFrictionModels, ListGrasps, ListProducts, PlaceObject, WriteAudit
from softgrip_nodekit import (
    LATCHED,
    RELIABLE,
    SENSOR,
    CellNode,
    Diagnostics,
    Health,
    Parameter,
    ParameterTable,
    StartupError,
    run,
    seconds,
    startup_errors,
    steady_timer,
)
from softgrip_panel.access.accounts import Accounts
from softgrip_panel.access.origin import OriginRule, is_loopback
from softgrip_panel.access.record import ActRecord
from softgrip_panel.access.sessions import LoginBrake, Sessions
from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.bags import BagFolder, BagJobs
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import StopPolicyView
from softgrip_panel.model.frames import PanelPicture
from softgrip_panel.model.overlay import ChainOverlay
from softgrip_panel.model.residuals import WatchLimits
from softgrip_panel.model.shapes import FaceOwners
from softgrip_panel.model.state import PanelState
from softgrip_panel.model.work import Worker, WorkRun
from softgrip_panel.nodes import convert
from softgrip_panel.nodes.cell_calls import RosCalls
from softgrip_panel.nodes.parameter_reader import RosParameters
from softgrip_panel.texts import Texts, speak
from softgrip_time.units import to_s

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.task import Future

    from softgrip_interfaces.action import SwapFingers
    from softgrip_panel.web.server import WebServer
    from softgrip_panel.web.site import PanelSite

Request = TypeVar("Request")
Response = TypeVar("Response")

#: How often streams are looked at while a page is open or a grasp goes on, and slow things always [s].
SAMPLE_S, LOOK_S = 0.1, 1.0
#: What the panel asks the driver about itself, in the order of `_on_driver`.
DRIVER_PARAMETERS = ("estop_policy", "tension_hold_n", "port", "baud", "tendons", "servo_ids", "servo_models")
#: What the panel asks the predictor about what it decides by, in the order of `WatchLimits.of`.
WATCH_PARAMETERS = ("watch", "watch_limit", "worn_limit", "cusum_limit")
#: Every so many looks the cell's lists are read again while a page is open.
LISTS_EVERY = 4

PARAMETERS = ParameterTable(
    Parameter("host", "127.0.0.1", "name or address to listen on; another than the loopback wants users and TLS"),
    Parameter("port", 0, "port to listen on; 0 = the first free one from 8480 on", "", 0, 65535),
    Parameter("host_names", [""], "names under which browsers reach the panel, besides the loopback's"),
    Parameter(
        "users_file", "", "who may log in, written by `users`; empty = whoever sits at this machine, with a name"
    ),
    Parameter("tls_certificate", "", "PEM file with the certificate; empty = no TLS"),
    Parameter("tls_key", "", "PEM file with the certificate's key"),
    Parameter(
        "state_dir",
        "",
        "folder for the record of acts, the order list and a swap under way; empty = kept nowhere",
    ),
    Parameter("bags_dir", "", "folder of the recorder's bags on this machine; empty = none are listed"),
    Parameter("language", "en", "catalogue of texts"),
    Parameter("watched_finger", "index", "the finger in front of the camera"),
    Parameter("profiles_directory", "", "folder of finger profiles; empty = no prediction is drawn into the picture"),
    Parameter("calibration_file", "", "the camera's calibration; empty = no prediction is drawn into the picture"),
)


class PanelNode(CellNode):
    """Translates between the cell and the page model; decides nothing."""

    def __init__(self) -> None:
        super().__init__("panel")
        values = self._values = PARAMETERS.declare(self)
        _check_access(values)
        self._state = PanelState(time.time, time.monotonic)
        folder = Path(values["state_dir"]) if values["state_dir"] else None
        if folder is not None:
            self._state.swap.keep_in(folder / "swap.json")
            self._state.refusals.keep_in(folder / "friction.json")
        self._record = ActRecord(folder / "acts.jsonl" if folder else None, time.time)
        self._calls = RosCalls(self, self._on_accepted, self._on_feedback, self._read_result)
        for act in acts.EXAMPLES:
            self._calls.prepare_cancel(act)
        self._parameter_reader = RosParameters(self)
        self._newest: dict[str, tuple[type[object], bytes]] = {}
        self._pictures = self._shapes = 0
        self._predicted: FingerStates | None = None
        self._overlay = ChainOverlay(values["watched_finger"], values["profiles_directory"], values["calibration_file"])
        self._site, self._server, address = self._open_site(values)
        self._diagnostics = Diagnostics(self)  # only now: loading the pages takes a second
        self._subscribe()
        self._driver_client = self.create_client(GetParameters, "tendon_driver/get_parameters")
        self._watch_client = self.create_client(GetParameters, "kinematics_predictor/get_parameters")
        self._phase_client = self.create_client(GetState, "tendon_driver/get_state")
        self._product_client = self.create_client(ListProducts, "cell/list_products")
        self._finger_client = self.create_client(ListFingers, "cell/list_fingers")
        self._grasp_client = self.create_client(ListGrasps, "cell/list_grasps")
        self._friction_client = self.create_client(ListFrictionModels, "friction/list")
        self._lists_due = 0
        self._counts_asked: tuple[int, ...] | None = None
        self._audit_client = self.create_client(WriteAudit, "cell/write_audit")
        self._place_client = self.create_client(PlaceObject, "emulator/place_object")
        steady_timer(self, SAMPLE_S, self._sample)
        steady_timer(self, LOOK_S, self._look)
        self._server.start()
        self.get_logger().info(f"the page is at {address}")

    def close(self) -> None:
        """Close the pages; the cell goes on as it is."""
        self._server.close()

    def _open_site(self, values: dict[str, Any]) -> tuple[PanelSite, WebServer, str]:
        try:
            # an extra: a cell without it runs all the same
            from softgrip_panel.web.pages.every import add_pages  # noqa: PLC0415
            from softgrip_panel.web.server import WebServer, listen  # noqa: PLC0415
            from softgrip_panel.web.site import PanelSite  # noqa: PLC0415
        except ModuleNotFoundError as error:
            raise StartupError(
                f"the page needs NiceGUI, found no module '{error.name}': type `make panel-setup`, "
                "or start the cell with panel:=false; it runs without the page"
            ) from error
        with startup_errors(PanelError):
            texts = Texts(values["language"])
            speak(texts)
            accounts = Accounts(Path(values["users_file"]).expanduser() if values["users_file"] else None)
            bound = listen(values["host"], values["port"])
        port = bound.getsockname()[1]
        tls = (Path(values["tls_certificate"]), Path(values["tls_key"])) if values["tls_certificate"] else None
        names = frozenset(filter(None, (*values["host_names"], values["host"])))
        rule = OriginRule(port, tls is not None, names)
        sessions = Sessions(time.monotonic, self._state.control.forget)
        desk = ActDesk(self._state, self._calls, self._record)
        run = self._run = WorkRun(time.monotonic)
        if values["state_dir"]:
            run.keep_in(Path(values["state_dir"]) / "work.json")
        if run.problem:
            self.get_logger().warning(run.problem)
        site = PanelSite(
            desk, Worker(desk, run), texts, accounts, sessions, LoginBrake(time.monotonic), rule,
            BagJobs(BagFolder(Path(values["bags_dir"]) if values["bags_dir"] else None)), self.get_namespace(),
            log=self.get_logger().warning,
        )  # fmt: skip
        desk.on_done = self._write_audit
        site.parameters = self._parameter_reader
        site.lens.folder = Path(values["state_dir"]) / "views" if values["state_dir"] else None
        site.calibration_file, site.watched_finger = values["calibration_file"], values["watched_finger"]
        site.owners = FaceOwners(Path(values["profiles_directory"]) if values["profiles_directory"] else None)
        host = values["host"] if is_loopback(values["host"]) else next(iter(sorted(names)))
        address = f"{'https' if tls else 'http'}://{host}:{port}/"
        try:
            return site, WebServer(site.app(add_pages), bound, tls), address
        except OSError as error:
            raise StartupError(f"TLS: expected a certificate and its key, found: {error}") from error

    def _subscribe(self) -> None:
        state = self._state
        self.create_subscription(CellState, "cell/state", self._on_cell, LATCHED)
        self.create_subscription(
            SafetyState, "safety/state", lambda message: state.observe_safety(convert.safety_view(message)), LATCHED
        )
        self.create_subscription(TendonOwners, "tendon/owners", self._on_owners, LATCHED)
        self.create_subscription(SwapProgress, "cell/swap_progress", self._on_swap_progress, LATCHED)
        self.create_subscription(RigProgress, "rig/progress", self._on_rig_progress, LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)
        for kind, topic in (
            (JointState, "tendon/state"),
            (TendonStatusArray, "tendon/status"),
            (FingerStates, "finger/predicted"),
            (FingerStates, "finger/measured"),
            (PredictedShape, "shape/predicted"),
            (PredictionResidual, "finger/residual"),
            (FingerMarkers, "finger/markers"),
            (CompressedImage, "camera/image_raw/compressed"),
        ):
            self._keep_newest(kind, topic)

    def _keep_newest(self, kind: type[object], topic: str) -> None:
        """Keep the newest message of a stream as bytes: most of them nobody looks at."""

        def keep(data: bytes) -> None:
            self._newest[topic] = (kind, data)

        self.create_subscription(kind, topic, keep, SENSOR, raw=True)

    def _take(self, topic: str) -> Any:
        """Return the newest message of a stream, None where none has come since the last look."""
        found = self._newest.pop(topic, None)
        return None if found is None else deserialize_message(found[1], found[0])

    def _on_cell(self, message: CellState) -> None:
        with self._state.locked() as state:
            view = convert.cell_view(message)
            state.observe_cell(view)
            state.swap.observe_mode(view.mode, view.reason)
            self._overlay.mount({one.slot: one.profile for one in view.mounted})

    def _on_owners(self, message: TendonOwners) -> None:
        self._state.owners = convert.owner_views(message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._state.observe_health([one for one in convert.health_views(message) if self._is_of_this_cell(one.name)])

    def _is_of_this_cell(self, name: str) -> bool:
        namespace = self.get_namespace().strip("/")
        return name.startswith(f"{namespace}/") if namespace else True

    def _sample(self) -> None:
        """Look at the streams: at what moves fingers always, at pictures while somebody sees them."""
        status = self._take("tendon/status")
        if status is not None:
            self._state.observe_tendons(convert.tendon_views(status))
        self._state.advance()
        cell = self._state.cell
        is_grasping = cell is not None and cell.mode == "GRASPING"
        if not self._site.viewers and not is_grasping:
            return
        tendons, predicted = self._take("tendon/state"), self._take("finger/predicted")
        if predicted is not None:
            self._overlay.predict({
                one.finger: (one.joint_angles, (one.tip.x, one.tip.y)) for one in predicted.fingers
            })  # fmt: skip
            self._predicted = predicted
            self._state.predicted = convert.finger_views(predicted)
        if tendons is not None:
            self._state.observe_tensions(convert.tension_views(tendons, self._predicted), seconds(tendons.header.stamp))
        self._sample_fingers()
        self._sample_picture()

    def _sample_fingers(self) -> None:
        measured, residual, shape = (
            self._take(topic) for topic in ("finger/measured", "finger/residual", "shape/predicted")
        )
        if measured is not None:
            self._state.measured = convert.finger_views(measured)
        if residual is not None:
            self._state.observe_residual(convert.residual_view(residual))
        if shape is not None:
            self._shapes += 1
            self._site.shape = convert.shape_view(shape, self._shapes)
            mounted = self._state.cell.mounted if self._state.cell else ()
            self._site.shape_profile = next((one.profile for one in mounted if one.slot == shape.finger), "power")

    def _sample_picture(self) -> None:
        markers = self._take("finger/markers")
        if markers is not None:
            self._overlay.measure(markers.finger, [(one.u, one.v) for one in markers.markers])
        image = self._take("camera/image_raw/compressed")
        if image is None:
            return
        self._pictures += 1
        jpeg = bytes(image.data)
        self._state.grasps.observe_picture(jpeg)
        self._site.picture = PanelPicture(self._pictures, jpeg, lines=self._overlay.lines())

    def _look(self) -> None:
        """Ask for what changes seldom; say whether the page can be reached."""
        self._state.is_emulated = self._place_client.service_is_ready()
        if not self._state.policy.estop_policy:
            self._ask(self._driver_client, GetParameters.Request(names=list(DRIVER_PARAMETERS)), self._on_driver)
        if self._site.viewers and not self._state.watch_limits.kind:
            self._ask(self._watch_client, GetParameters.Request(names=list(WATCH_PARAMETERS)), self._on_watch)
        if self._site.viewers:
            self._ask(self._phase_client, GetState.Request(), self._on_phase)
        self._lists_due -= 1
        if self._lists_due <= 0 and (self._site.viewers or not self._state.products):
            self._lists_due = LISTS_EVERY
            self._state.nodes = self._parameter_reader.nodes()
            self._ask(self._product_client, ListProducts.Request(), self._on_products)
            self._ask(self._finger_client, ListFingers.Request(), self._on_fingers)
            self._ask(self._friction_client, ListFrictionModels.Request(), self._on_friction)
            self._ask_grasps()
        problem = self._record.problem or self._run.problem
        health = Health.WARN if problem else Health.OK
        self._diagnostics.set("page", health, problem or "serves", {"pages": self._site.viewers})

    def _ask_grasps(self) -> None:
        """Ask for the counted grasps when there may be another one: the list is long."""
        counts = self._state.cell.counts if self._state.cell else None
        if counts is not None and counts == self._counts_asked and self._state.counted:
            return
        self._counts_asked = counts
        self._ask(self._grasp_client, ListGrasps.Request(limit=200), self._on_grasps)

    def _on_driver(self, future: Future[GetParameters.Response]) -> None:
        values = future.result().values
        if len(values) == len(DRIVER_PARAMETERS):
            policy, hold, port, baud, tendons, ids, models = values
            self._state.policy = StopPolicyView(policy.string_value, hold.double_value)
            self._state.bench = replace(
                self._state.bench,
                port=port.string_value,
                baud=int(baud.integer_value),
                tendons=tuple(tendons.string_array_value),
                servo_ids=tuple(int(one) for one in ids.integer_array_value),
                servo_models=tuple(models.string_array_value),
            )

    def _on_watch(self, future: Future[GetParameters.Response]) -> None:
        values = future.result().values
        if len(values) == len(WATCH_PARAMETERS):
            watch, *limits = values
            self._state.watch_limits = WatchLimits.of(watch.string_value, *(one.double_value for one in limits))

    def _on_phase(self, future: Future[GetState.Response]) -> None:
        with self._state.locked() as state:
            state.bench = replace(state.bench, phase=future.result().current_state.label)

    def _on_products(self, future: Future[ListProducts.Response]) -> None:
        response = future.result()
        if response.success:
            self._state.catalogue = convert.product_views(response)
            self._state.products = tuple(one.id for one in self._state.catalogue)

    def _on_fingers(self, future: Future[ListFingers.Response]) -> None:
        response = future.result()
        if response.success:
            self._state.fingers = convert.finger_record_views(response)

    def _on_grasps(self, future: Future[ListGrasps.Response]) -> None:
        response = future.result()
        if response.success:
            self._state.observe_counted(convert.counted_views(response))

    def _on_friction(self, future: Future[ListFrictionModels.Response]) -> None:
        response = future.result()
        if response.success:
            self._state.friction_models = convert.friction_model_views(response)
            self._state.friction_active = response.active

    def _on_rig_progress(self, message: RigProgress) -> None:
        self._state.rig = convert.rig_progress(message)

    def _on_swap_progress(self, message: SwapProgress) -> None:
        ahead_s = time.time() - to_s(self.get_clock().now().nanoseconds)
        with self._state.locked() as state:
            state.swap.observe_progress(convert.swap_progress(message, ahead_s))

    @staticmethod
    def _ask(
        client: Client[Request, Response], request: Request, on_answer: Callable[[Future[Response]], None]
    ) -> None:
        """Call a service that is there."""
        if client.service_is_ready():
            client.call_async(request).add_done_callback(on_answer)

    def _write_audit(self, who: str, act: str, subject: str, detail: str) -> None:
        """Write an act into the cell's audit table, too; the panel's own record has it in any case."""
        if self._audit_client.service_is_ready():
            self._audit_client.call_async(WriteAudit.Request(who=who, action=act, subject=subject, detail=detail))

    def _on_accepted(self, act: str, goal: SwapFingers.Goal, goal_id: bytes, who: str) -> None:
        if act == "swap":
            with self._state.locked() as state:
                state.swap.begin_swap(goal.finger_set, who, time.time(), goal_id.hex())

    def _on_feedback(self, act: str, feedback: Any, _who: str) -> None:
        if act == "swap":
            with self._state.locked() as state:
                state.swap.observe(
                    convert.SWAP_STEPS.get(feedback.step, ""),
                    feedback.instruction,
                    feedback.token,
                    needs_confirmation=bool(feedback.confirmation),
                )

    def _read_result(self, act: str, result: Any) -> tuple[bool, str]:
        self._lists_due = 0
        with self._state.locked() as state:
            if act == "grasp":
                outcome = convert.GRASP_OUTCOMES.get(result.outcome, "?")
                state.grasps.observe_result(
                    outcome,
                    result.reason,
                    duration_s=float(result.duration),
                    latency_s=float(result.latency),
                    fingers=convert.grasp_decision(result.decision),
                    decided_stamp_s=convert.decided_stamp_s(result.decision),
                )
                return outcome == "GRIPPED", f"{outcome}: {result.reason}"
            if act == "calibrate":
                outcome = convert.RIG_OUTCOMES.get(result.outcome, "?")
                return outcome == "SUCCEEDED", f"{outcome}: {result.reason}"
            if act in {"pull", "slacken"}:
                outcome = convert.MOVE_OUTCOMES.get(result.outcome, "?")
                return outcome in {"REACHED", "TENSION_LIMIT"}, f"{outcome}: {result.reason}"
            outcome = convert.SWAP_OUTCOMES.get(result.outcome, "?")
            state.swap.end(success=outcome == "SUCCEEDED", message=result.reason)
            return outcome == "SUCCEEDED", f"{outcome}: {result.reason}"


def _check_access(values: dict[str, Any]) -> None:
    """Refuse to be reached from elsewhere without log-in and TLS."""
    if bool(values["tls_certificate"]) != bool(values["tls_key"]):
        raise StartupError("tls_certificate and tls_key: expected both or none, found one")
    missing = [name for name in ("users_file", "tls_certificate") if not values[name]]
    if missing and not is_loopback(values["host"]):
        raise StartupError(
            f"host '{values['host']}' can be reached from elsewhere: expected {' and '.join(missing)}, found none; "
            "`ros2 run softgrip_panel users FILE add NAME ROLE` writes accounts; docs/panel.md: certificates"
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(PanelNode, args)


if __name__ == "__main__":
    sys.exit(main())
