# SPDX-License-Identifier: Apache-2.0
"""kinematics_predictor as a process of its own, fed with scripted tendons, friction models and a cell."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState, Temperature

from softgrip_interfaces.msg import (
    CellState,
    FingerState,
    FingerStates,
    FrictionModel,
    MountedFinger,
    PredictionResidual,
)
from softgrip_interfaces.srv import PredictFinger
from softgrip_model.finger import Finger, JointModel, close
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, to_time_message
from softgrip_testing.free_domains import own_domain

pytestmark = pytest.mark.ros

PROFILES = Path(__file__).resolve().parents[2] / "softgrip_bringup" / "profiles"
MILLISECOND = 1_000_000


def friction(model_id: str, alpha: float = 0.27049) -> FrictionModel:
    return FrictionModel(
        id=model_id,
        law="matte",
        k_reading="printed",
        coefficient_names=["alpha", "n", "epsilon", "lambda"],
        coefficients=[alpha, 0.82038, 0.06483, 0.00851],
        covariance=[1e-4 if i % 5 == 0 else 0.0 for i in range(16)],
        cable_radius=0.000125,
        surface_radius=0.003,
        angle_range=[0.1745, 1.5708],
        tension_range=[1.962, 9.81],
        verdict=FrictionModel.USABLE,
    )


class Cell(Node):
    """Everything around the predictor."""

    def __init__(self) -> None:
        super().__init__("scripted_cell")
        self.predicted: list[FingerStates] = []
        self.residuals: list[PredictionResidual] = []
        self.health: dict[str, tuple[int, str]] = {}
        self._tendons = self.create_publisher(JointState, "tendon/state", SENSOR)
        self._measured = self.create_publisher(FingerStates, "finger/measured", SENSOR)
        self.friction = self.create_publisher(FrictionModel, "friction/active", LATCHED)
        self.cell = self.create_publisher(CellState, "cell/state", LATCHED)
        self.create_subscription(FingerStates, "finger/predicted", self.predicted.append, SENSOR)
        self.create_subscription(PredictionResidual, "finger/residual", self.residuals.append, SENSOR)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE)
        self.thermometer = self.create_publisher(Temperature, "cell/temperature", SENSOR)
        self.client = self.create_client(PredictFinger, "finger/predict")
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)
        self.stamp = 1_000 * MILLISECOND
        self.process: subprocess.Popen[str] | None = None

    def start(self, *parameters: str) -> None:
        settings = [argument for parameter in parameters for argument in ("-p", parameter)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "softgrip_model.nodes.kinematics_predictor", "--ros-args", *settings],
            stderr=subprocess.PIPE,
            text=True,
        )

    def stop(self) -> int:
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=15)
        code, self.process = self.process.returncode, None
        return code

    def until(self, condition: Callable[[], bool], expected: str, poke: Callable[[], None] | None = None) -> None:
        """Spin until a condition holds; `poke` is done at 100 Hz meanwhile."""
        deadline, next_poke = time.monotonic() + 15.0, 0.0
        while not condition():
            assert time.monotonic() < deadline, f"expected {expected}; health: {self.health}"
            assert self.process is None or self.process.poll() is None, "the predictor ended"
            if poke is not None and time.monotonic() >= next_poke:
                poke()
                next_poke = time.monotonic() + 0.01
            self.executor_.spin_once(timeout_sec=0.005)

    def tendons(self, pulled: float, velocity: float = 0.01) -> None:
        self.stamp += 5 * MILLISECOND
        message = JointState(name=["index", "wrist"], position=[pulled, 0.1], velocity=[velocity] * 2, effort=[5.0] * 2)
        message.header.stamp = to_time_message(self.stamp)
        self._tendons.publish(message)

    def measured(self, stamp: int, tip: tuple[float, float]) -> None:
        state = FingerState(
            finger="index", profile="power", pulled_length=math.nan, joint_angles=[0.5, 0.3, 0.3],
            tip=Point(x=tip[0], y=tip[1], z=0.0),
        )  # fmt: skip
        message = FingerStates(fingers=[state])
        message.header.stamp = to_time_message(stamp)
        self._measured.publish(message)

    def prediction(self, pulled: float, model: str, profile: str = "power") -> FingerState:
        """The state predicted for a pulled length, by this friction model, for this profile."""

        def found() -> list[FingerState]:
            return [
                state
                for message in self.predicted
                if message.friction_model == model
                for state in message.fingers
                if state.pulled_length == pulled and state.profile == profile
            ]

        self.predicted.clear()
        self.until(lambda: bool(found()), f"a prediction by {model} for {profile}", lambda: self.tendons(pulled))
        return found()[0]

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith("kinematics_predictor: "):
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                self.health[status.name.split(": ", 1)[1]] = (level, status.message)

    def close(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.communicate(timeout=15)
        self.executor_.shutdown()
        self.destroy_node()


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    made = Cell()
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown()


def test_it_follows_friction_and_mounted_fingers(cell: Cell) -> None:
    """Its numbers are the thesis' (docs/finger.md), which has hinges."""
    cell.start(f"profiles_directory:={PROFILES}", "joint_model:=hinge", "intervals:=friction")
    own = cell.prediction(0.010, "braid-tpu-chapter4")
    assert [round(math.degrees(angle), 2) for angle in own.joint_angles] == [47.82, 22.55, 23.99]
    assert own.tension == pytest.approx(7.3779, abs=6e-5)
    assert list(own.joint_angles_stddev) == []
    assert len(cell.predicted[0].fingers) == 1  # the wrist has no finger

    cell.friction.publish(friction("rig-1", alpha=0.35))
    calibrated = cell.prediction(0.010, "rig-1")
    assert calibrated.tension > own.tension
    assert all(deviation > 0.0 for deviation in calibrated.joint_angles_stddev)

    named = cell.predicted[-1].friction_digest
    assert len(named) == 64
    cell.friction.publish(friction("rig-1", alpha=0.36))  # the same name, other numbers
    cell.until(lambda: cell.predicted[-1].friction_digest != named, "another digest", lambda: cell.tendons(0.010))

    before = cell.predicted[-1].configuration
    cell.cell.publish(CellState(mode=CellState.IDLE, mounted=[MountedFinger(finger="index", profile="hook", state=3)]))
    hook = cell.prediction(0.010, "rig-1", profile="hook")
    assert hook.joint_angles[1] > hook.joint_angles[0]
    assert cell.predicted[-1].configuration != before
    assert cell.stop() == 0


def test_it_hears_a_thermometer_and_names_one_in_another_unit(cell: Cell) -> None:
    cell.start(f"profiles_directory:={PROFILES}")
    cell.prediction(0.010, "braid-tpu-chapter4")

    def says(celsius: float) -> Callable[[], None]:
        message = Temperature(temperature=celsius)
        message.header.stamp = to_time_message(cell.stamp)

        def say() -> None:
            cell.thermometer.publish(message)
            cell.tendons(0.010)  # a temperature holds from a later sample on

        return say

    cell.until(lambda: cell.health.get("room") == (0, "23.4 degC"), "a temperature", says(23.4))
    cell.until(lambda: "found 296.5" in cell.health["room"][1], "kelvin refused", says(296.5))
    assert cell.health["room"][0] == 1
    assert cell.stop() == 0


def test_what_it_cannot_use_it_names_and_goes_on(cell: Cell) -> None:
    cell.start(f"profiles_directory:={PROFILES}")
    cell.friction.publish(friction("rig-1"))
    cell.prediction(0.010, "rig-1")

    bad = friction("rig-2")
    bad.coefficients = [0.3, 1.4, 0.1, 0.0]
    cell.friction.publish(bad)
    cell.until(lambda: cell.health.get("friction", (0, ""))[0] == 1, "a warning about the friction model")
    assert "expected 0.001 <= n <= 0.999" in cell.health["friction"][1]
    assert "still using rig-1" in cell.health["friction"][1]

    unset = friction("rig-3")
    unset.verdict = FrictionModel.UNSET
    cell.friction.publish(unset)
    cell.until(lambda: "'rig-3'" in cell.health["friction"][1], "a warning about the missing verdict")
    assert "expected a verdict, found none" in cell.health["friction"][1]

    cell.cell.publish(CellState(mounted=[MountedFinger(finger="index", profile="glove", state=3)]))
    cell.until(lambda: cell.health.get("profile", (0, ""))[0] == 1, "a warning about the profile")
    assert "unknown profile 'glove'" in cell.health["profile"][1]
    failed = cell.prediction(0.2, "rig-1")
    assert failed.validity == FingerState.FAILED
    assert all(math.isnan(angle) for angle in failed.joint_angles)
    assert cell.prediction(0.010, "rig-1").validity == FingerState.OK


def test_residuals_carry_the_measurements_stamp_and_the_fingers_frame(cell: Cell) -> None:
    cell.start(f"profiles_directory:={PROFILES}", "frame_prefix:=left/")
    expected = cell.prediction(0.010, "braid-tpu-chapter4")
    at = cell.stamp + 7 * MILLISECOND  # between two tendon samples to come
    cell.measured(at, (expected.tip.x, expected.tip.y + 0.0019))
    cell.until(lambda: bool(cell.residuals), "a residual", lambda: cell.tendons(0.010))
    residual = cell.residuals[0]
    assert residual.header.stamp == to_time_message(at)
    assert residual.header.frame_id == "left/index_base"
    assert residual.tip_error == pytest.approx(0.0019, abs=1e-9)
    assert residual.tip_error_percent == pytest.approx(2.0, abs=1e-6)
    assert residual.tension_error == pytest.approx(5.0 - expected.tension, abs=1e-9)
    assert "baseline" in residual.reason


def test_the_service_predicts_any_profile(cell: Cell) -> None:
    cell.start(f"profiles_directory:={PROFILES}", "intervals:=friction")  # the profile's own finger, its cable as well
    cell.until(cell.client.service_is_ready, "the service")

    def ask(**request: object) -> PredictFinger.Response:
        future = cell.client.call_async(PredictFinger.Request(**request))
        cell.until(future.done, "a response")
        return future.result()

    good = ask(profile="pinch", finger="index", pulled_lengths=[0.005, 0.010])
    assert good.success
    assert [state.pulled_length for state in good.states] == [0.005, 0.010]
    pinch = load_directory(PROFILES)["pinch"]
    flexures = Finger.from_profile(pinch, "index", JointModel.FLEXURE)
    expected = close(flexures, published(pinch.friction_id).law, [10.0], march=False)
    assert list(good.states[1].joint_angles) == pytest.approx(expected.angle_rad[0, 0].tolist(), abs=1e-12)
    bad = ask(profile="glove", pulled_lengths=[0.005])
    assert not bad.success
    assert bad.message == "unknown profile 'glove'; loaded: hook, pinch, power"


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (["profiles_directory:=/nowhere"], "/nowhere: expected a folder with profiles"),
        ([f"profiles_directory:={PROFILES}", "profiles:=[glove]"], "unknown profile 'glove'"),
        ([f"profiles_directory:={PROFILES}", "profiles:=[power, hook]"], "expected 1 or 3"),
        ([f"profiles_directory:={PROFILES}", "tip_stddev_m:=-1.0"], "tip_stddev_m"),
    ],
)
def test_it_does_not_start_on_nonsense(cell: Cell, parameters: list[str], message: str) -> None:
    cell.start(*parameters)
    assert cell.process is not None
    _, errors = cell.process.communicate(timeout=10)
    assert cell.process.returncode == 2
    assert message in errors
    cell.process = None
