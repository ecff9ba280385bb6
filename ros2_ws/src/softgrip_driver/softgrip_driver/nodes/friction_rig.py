# SPDX-License-Identifier: Apache-2.0
"""friction_rig: measures cable friction with a person's help, and says which friction model is active.

Configured: both devices are connected and identified. Active: the stage may move. On every way out the stage is
stopped. On a bench without a rig (`stage` none) it is active all the same and serves the friction models.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from softgrip_driver.errors import DriverError, NoReplyError, PortLostError, StoppedError
from softgrip_driver.nodes import convert_friction as convert
from softgrip_driver.nodes.rig_parameters import NO_STAGE, PARAMETERS, make_bench, measurement_settings
from softgrip_driver.nodes.rig_progress import ProgressLog, broken_plan_text
from softgrip_driver.nodes.rig_safety import FollowedSafety, OwnSafety, RigSafety
from softgrip_driver.rig.bench import Bench
from softgrip_driver.rig.clock import ScaledClock
from softgrip_driver.rig.procedure import (
    JudgedPoint,
    PlanFailedError,
    PlanOutcome,
    Procedure,
    ProcedureStep,
    RigOperator,
)
from softgrip_driver.rig.pull import RigSample
from softgrip_driver.rig.pulley import Pulley, read_pulley, write_pulley
from softgrip_driver.rig.slide import PointVerdict
from softgrip_driver.tendon.safety_store import SafetyStore, port_file
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import FrictionModel, FrictionSample, RigProgress
from softgrip_interfaces.srv import ActivateFrictionModel, ListFrictionModels
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.record import ModelVerdict
from softgrip_model.friction.store import ModelStore
from softgrip_nodekit import (
    LATCHED,
    RELIABLE,
    SENSOR,
    Diagnostics,
    GoalHandle,
    HardwareNode,
    Health,
    OrderGuard,
    StartupError,
    cell_clock,
    run,
)
from softgrip_time import Clock as CellClock
from softgrip_time import WallClock
from softgrip_time.units import to_s

_Handle = GoalHandle[CalibrateFriction.Goal, CalibrateFriction.Feedback]

#: [s] between looks at idle devices.
_IDLE_PERIOD = 0.5
#: Folder of the plans' records, within that of the models.
_PLANS = "plans"
_NO_RIG = "this bench has no rig (stage: none): friction models are served, nothing is measured"
_KEPT = "accepted points are kept: resume the plan to go on"


class FrictionRig(HardwareNode):
    """The node; measuring runs in the action's thread, everything else in the others."""

    def __init__(self) -> None:
        super().__init__("friction_rig")
        self._values = PARAMETERS.declare(self)
        self._has_rig = self._values["stage"] != NO_STAGE
        if not self._has_rig:
            self.device_paths = []  # none that `run` would wait for
        self._diagnostics = Diagnostics(self, hardware_id=self._values["stage_port"] if self._has_rig else "")
        self._folder = Path(self._values["model_dir"]).expanduser()
        self._bench: Bench | None = None
        #: that the devices wait on
        self.clock_of_cell: CellClock = WallClock()
        self._active = False
        self._session: _Session | None = None
        self._session_lock = threading.Lock()

        self._wrench = self.create_publisher(WrenchStamped, "load_cell/wrench", SENSOR)
        self._stage_state = self.create_publisher(JointState, "rig/stage", SENSOR)
        self._samples = self.create_publisher(FrictionSample, "rig/sample", RELIABLE)
        self._progress = self.create_publisher(RigProgress, "rig/progress", LATCHED)
        #: what rig/progress says
        self.progress = ProgressLog(self._publish_progress, broken_plan_text(self._folder / _PLANS))
        self._friction_active = self.create_publisher(FrictionModel, "friction/active", LATCHED)
        services = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "rig/confirm", self._on_confirm, callback_group=services)
        self.create_service(ActivateFrictionModel, "friction/activate", self._on_activate, callback_group=services)
        self.create_service(ListFrictionModels, "friction/list", self._on_list, callback_group=services)
        self._action = ActionServer(
            self,
            CalibrateFriction,
            "rig/calibrate",
            execute_callback=self._on_calibrate,
            # Accepted always: only a result can carry the reason why not.
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
        )
        self.create_timer(_IDLE_PERIOD, self._look, callback_group=MutuallyExclusiveCallbackGroup())
        self._order_guard = OrderGuard(self)
        self._safety = self._make_safety(self._order_guard, MutuallyExclusiveCallbackGroup())
        self._open_store()

    def _make_safety(self, order_guard: OrderGuard, group: MutuallyExclusiveCallbackGroup) -> RigSafety:
        if self._values["safety_source"] == "topic":
            return FollowedSafety(self, group, self._stop_now)
        text = "no tendon_driver here (safety_source: none): its emergency stop does not reach this rig; rig/stop does"
        self._diagnostics.set("safety", Health.WARN, text)
        file = self._values["safety_file"]
        store = SafetyStore(Path(file).expanduser() if file else port_file(self._values["stage_port"]))
        return OwnSafety(self, store, group, self._stop_now, lambda: order_guard.refusal)

    def _stop_now(self, reason: str) -> None:
        """End a running pull: the stand stands still and holds by its screw, since letting down is a motion, too."""
        with self._session_lock:
            session = self._session
        if session is not None:
            session.stop(reason)

    def _open_store(self) -> None:
        try:
            self._models = ModelStore(self._folder)
            model_id = self._models.active or self._values["initial_model"]
            self._publish_active(convert.model_message(self._models.get(model_id)))
        except (FrictionError, OSError) as error:
            raise StartupError(f"model_dir {self._folder}: {error}") from error
        self._active_id = model_id

    # -- lifecycle ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Connect and identify both devices, where there are any."""
        if not self._has_rig:
            self._diagnostics.set("rig", Health.OK, _NO_RIG)
            return super().on_configure(state)
        try:
            clock = self.clock_of_cell = cell_clock(self)
            bench = make_bench(self._values, clock)
            with clock.stepping():
                identities = bench.open(timeout=self._values["connect_timeout"])
        except (DriverError, StartupError) as error:
            self._diagnostics.set("rig", Health.ERROR, str(error))
            return self.fail(str(error))
        self._bench = bench
        for identity in identities:
            self.get_logger().info(f"connected: {identity.model}")
            for warning in identity.warnings:
                self.get_logger().warning(f"{identity.model}: {warning}")
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Allow motion."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop."""
        self._halt()
        return super().on_deactivate(state)

    def close(self) -> None:
        """Stop the stage, disconnect, and end what guards it."""
        self._halt()
        self._safety.close()
        self.disconnect()

    def disconnect(self) -> None:
        """Stop the stage and close its devices."""
        self._halt()
        bench, self._bench = self._bench, None
        if bench is not None:
            bench.close()

    def _halt(self) -> None:
        self._active = False
        with self._session_lock:
            session = self._session
        if session is not None:
            session.stop()
            session.ended.wait(timeout=2.0)

    # -- measuring ---------------------------------------------------------------------------------------------------

    def _on_calibrate(self, goal_handle: _Handle) -> CalibrateFriction.Result:
        result = CalibrateFriction.Result()
        # A result without a model must not look like one that may be used.
        result.model = FrictionModel(verdict=FrictionModel.DO_NOT_USE, reason="no model was fitted")
        session = _Session(self, goal_handle, ScaledClock(self.clock_of_cell, self._values["time_scale"]))
        try:
            outcome = self._measure(session, goal_handle.request)
            self._keep(outcome, goal_handle.request, result)
            goal_handle.succeed()
            result.outcome = CalibrateFriction.Result.SUCCEEDED
        except StoppedError as error:
            result.outcome = CalibrateFriction.Result.CANCELLED
            result.reason = f"{session.stop_reason or error}; {_KEPT}"
            self.announce(goal_handle.canceled if goal_handle.is_cancel_requested else goal_handle.abort)
        except (DriverError, FrictionError) as error:
            result.outcome = CalibrateFriction.Result.FAILED
            kept = [_KEPT] if session.accepted and not isinstance(error, PlanFailedError) else []
            result.reason = "; ".join([str(error), *getattr(error, "__notes__", []), *kept])
            self._diagnostics.set("plan", Health.ERROR, result.reason)
            goal_handle.abort()
        except OSError as error:
            result.outcome = CalibrateFriction.Result.FAILED
            result.reason = (
                f"measured, but {self._folder} cannot keep it: {error}; make room: this result holds the model, "
                f"{self._folder / _PLANS} the points"
            )
            self._diagnostics.set("plan", Health.ERROR, result.reason)
            goal_handle.abort()
        finally:
            session.ended.set()
        result.samples = list(session.accepted.values())
        with self._session_lock:
            is_last = self._session is None
        if is_last:  # else this goal was refused because another one is measured
            self.progress.end(result)
        return result

    def _measure(self, session: _Session, goal: CalibrateFriction.Goal) -> PlanOutcome:
        if not self._has_rig:
            raise DriverError(_NO_RIG)
        bench = self._bench
        if bench is None or not self._active:
            raise DriverError("expected friction_rig to be active, found it is not; configure and activate it first")
        refusal = self._safety.refusal or self._order_guard.refusal
        if refusal:
            raise DriverError(refusal)
        pulley = read_pulley(self._folder) or Pulley(1.0, self._values["pulley_stddev"])
        settings = measurement_settings(self._values, pulley.ratio, pulley.stddev)
        with bench.measuring():
            with self._session_lock:
                self._session = session
            session.stop_if(self._safety.refusal)  # it may have come while the session began
            self.progress.publish_start()
            self._diagnostics.set("plan", Health.OK, "measuring")
            try:
                procedure = Procedure(bench.stage, bench.gauge, session, session.clock, settings, self._folder / _PLANS)
                with self.clock_of_cell.stepping():
                    return procedure.run(convert.request_of(goal), resume=bool(goal.resume))
            finally:
                with self._session_lock:
                    self._session = None

    def _keep(self, outcome: PlanOutcome, goal: CalibrateFriction.Goal, result: CalibrateFriction.Result) -> None:
        if outcome.calibration is None:
            write_pulley(self._folder, Pulley(outcome.pulley_ratio, outcome.pulley_stddev))
            result.reason = f"guide pulley: T1/T2 = {outcome.pulley_ratio:.4f}, taken out of every later point"
            return
        model = outcome.calibration.model
        result.model = convert.model_message(model)
        result.reason = model.reason
        self._models.add(model)
        usable = model.verdict is ModelVerdict.USABLE
        self._diagnostics.set("plan", Health.OK if usable else Health.WARN, f"{model.verdict}: {model.reason}")
        if usable and goal.activate:
            self._make_active(model.id)

    def _on_cancel(self, _: _Handle) -> CancelResponse:
        with self._session_lock:
            session = self._session
        if session is not None:
            session.stop()
        return CancelResponse.ACCEPT

    def _on_confirm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = self._order_guard.refusal
        if response.message:
            return response
        with self._session_lock:
            session = self._session
        response.success = session is not None and session.confirm()
        response.message = "" if response.success else "nothing to confirm: no step is waiting"
        return response

    def announce(self, send: Callable[..., None], *messages: object) -> bool:
        """Send something; False when the process is ending (rclpy has no public name for what it raises then)."""
        try:
            send(*messages)
        except Exception:
            if self.context.ok():
                raise
            return False
        return True

    def publish_sample(self, sample: RigSample) -> bool:
        """Publish a raw reading; False when the process is ending."""
        stamp = self.get_clock().now().to_msg()
        frame = self._values["gauge_frame"]
        sent = self.announce(self._wrench.publish, convert.wrench_message(sample, stamp, frame))
        return sent and self.announce(self._stage_state.publish, convert.stage_message(sample, stamp, frame))

    def publish_point(self, judged: JudgedPoint) -> FrictionSample:
        """Publish one attempt at one point."""
        message = convert.sample_message(judged, self.get_clock().now().to_msg())
        self.announce(self._samples.publish, message)
        self.progress.judge(message)
        return message

    def _publish_progress(self, message: RigProgress) -> None:
        message.header.stamp = self.get_clock().now().to_msg()
        self.announce(self._progress.publish, message)

    def _look(self) -> None:
        """Watch idle devices: publish the tension, say who is missing, take up who is plugged in again."""
        bench = self._bench
        if bench is None:
            return
        try:
            with self.clock_of_cell.stepping():
                sample = bench.read_idle(to_s(self.get_clock().now().nanoseconds))
        except (PortLostError, NoReplyError) as error:
            self._diagnostics.set("rig", Health.ERROR, str(error))
            self._take_up(bench)
        except DriverError as error:
            self._diagnostics.set("rig", Health.WARN, str(error))
        else:
            self._diagnostics.set("rig", Health.OK, "connected" if self._active else "connected, not active")
            if sample is not None:
                self.publish_sample(sample)

    def _take_up(self, bench: Bench) -> None:
        try:
            with self.clock_of_cell.stepping():
                bench.reopen()
        except DriverError as error:
            self.get_logger().debug(f"still missing: {error}")

    # -- models ------------------------------------------------------------------------------------------------------

    def _make_active(self, model_id: str) -> None:
        model = self._models.activate(model_id)
        self._active_id = model_id
        self._publish_active(convert.model_message(model))

    def _publish_active(self, message: FrictionModel) -> None:
        message.activated = self.get_clock().now().to_msg()
        self._friction_active.publish(message)

    def _on_activate(
        self, request: ActivateFrictionModel.Request, response: ActivateFrictionModel.Response
    ) -> ActivateFrictionModel.Response:
        try:
            self._make_active(request.id)
        except (FrictionError, OSError) as error:
            response.success, response.message = False, str(error)
        else:
            response.success = True
            response.message = f"friction model '{request.id}' is active"
        return response

    def _on_list(
        self, _: ListFrictionModels.Request, response: ListFrictionModels.Response
    ) -> ListFrictionModels.Response:
        models, problems = self._models.readable()
        now = datetime.now(UTC)
        response.models = [convert.model_message(model) for model in models]
        response.ages = [float(model.age(now)) for model in models]
        response.active = self._active_id
        response.success = True
        response.message = "; ".join(problems)
        return response


class _Session(RigOperator):
    """One running plan: between the procedure's questions and the action's client."""

    def __init__(self, node: FrictionRig, goal_handle: _Handle, clock: ScaledClock) -> None:
        self.clock = clock
        self.ended = threading.Event()
        self.accepted: dict[int, FrictionSample] = {}
        self._node = node
        self._goal_handle = goal_handle
        self._waiting = False
        self._answer = threading.Condition()
        self.stop_reason = ""

    def show_step(self, step: ProcedureStep) -> None:
        self._node.progress.publish_step(step, needs_confirmation=self._waiting)
        if not self._node.announce(self._goal_handle.publish_feedback, convert.feedback_message(step)):
            raise StoppedError("the process is ending")

    def confirmed(self, step: ProcedureStep) -> None:
        with self._answer:
            self._waiting = True
            self.show_step(step)
            with self._node.clock_of_cell.detached():
                self._answer.wait_for(lambda: not self._waiting or self.clock.stopped)
        if self.clock.stopped:
            raise StoppedError("the measurement was stopped")

    def judged(self, point: JudgedPoint) -> None:
        message = self._node.publish_point(point)
        if point.slide.verdict is PointVerdict.ACCEPTED:
            self.accepted[point.index] = message
        else:
            self.accepted.pop(point.index, None)

    def sampled(self, sample: RigSample) -> None:
        if not self._node.publish_sample(sample):
            raise StoppedError("the process is ending")

    def confirm(self) -> bool:
        """Take the person's confirmation; False when nothing waits for it."""
        with self._answer:
            waited, self._waiting = self._waiting, False
            if waited:
                self._node.progress.confirm()
            self._answer.notify_all()
        return waited

    def stop_if(self, reason: str) -> None:
        """Stop where there is a reason to."""
        if reason:
            self.stop(reason)

    def stop(self, reason: str = "") -> None:
        """End all waits; the procedure stops the stage."""
        self.stop_reason = self.stop_reason or reason
        self.clock.stop()
        with self._answer:
            self._answer.notify_all()


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run(FrictionRig, args, threads=4))


if __name__ == "__main__":
    main()
