# SPDX-License-Identifier: Apache-2.0
"""gdfe_simulator between real topics: shapes carry the state's stamp, and the same state gives the same bits."""

import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker

from softgrip_interfaces.msg import CellState, FrictionModel, MountedFinger, PredictedShape
from softgrip_model.nodes.gdfe_simulator import GdfeSimulator
from softgrip_nodekit import LATCHED, SENSOR, Health, nanoseconds, to_time_message

PERIOD_NS = 40_000_000


class Bench:
    """The node, and a node that talks to it."""

    def __init__(self) -> None:
        rclpy.init(
            args=["--ros-args", "-p", "resolution:=coarse", "-p", "travel_m:=0.008", "-p", "frame_prefix:=left/"]
        )
        self.node = GdfeSimulator()
        self.other = rclpy.create_node("other")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.other)
        self.got: list[PredictedShape] = []
        self.markers: list[Marker] = []
        self.other.create_subscription(Marker, "shape/marker", self.markers.append, SENSOR)
        self.other.create_subscription(PredictedShape, "shape/predicted", self.got.append, SENSOR)
        self.tendons = self.other.create_publisher(JointState, "tendon/state", SENSOR)
        self.cell = self.other.create_publisher(CellState, "cell/state", LATCHED)
        self.friction = self.other.create_publisher(FrictionModel, "friction/active", LATCHED)
        self.spin(lambda: self.tendons.get_subscription_count() > 0 and self.node._shapes.get_subscription_count() > 0)

    def spin(self, done, seconds=20.0):
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, "nothing came within the time"
            self.executor.spin_once(timeout_sec=0.02)

    def pull(self, stamp_ns, length):
        message = JointState(name=["index"], position=[length], velocity=[0.0], effort=[1.0])
        message.header.stamp = to_time_message(stamp_ns)
        before = len(self.got)
        self.tendons.publish(message)
        self.spin(lambda: len(self.got) > before)
        return self.got[-1]

    def health(self, component):
        return self.node._diagnostics._components[component][:2]

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.other.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture(scope="module")
def bench():
    bench = Bench()
    yield bench
    bench.close()


def test_a_pulled_finger_closes_towards_minus_y(bench):
    shape = bench.pull(1_000_000_000, 0.006)
    vertices = np.array(shape.vertices).reshape(-1, 3)
    assert shape.converged
    assert nanoseconds(shape.header.stamp) == 1_000_000_000
    assert shape.header.frame_id == "left/index_base"
    assert vertices[:, 1].min() < -0.03
    bench.spin(lambda: bool(bench.markers))
    assert bench.markers[0].header.frame_id == "left/index_base"
    assert len(shape.strain) == shape.hexahedra
    assert max(shape.faces) < len(vertices)


def test_the_same_state_gives_the_same_bits_whatever_came_before(bench):
    first = bench.pull(2_000_000_000, 0.0041)
    for k in range(1, 4):
        bench.pull(2_000_000_000 + k * PERIOD_NS, 0.002 * k)
    again = bench.pull(3_000_000_000, 0.0041)
    assert first.vertices == again.vertices
    assert (first.residual, first.iterations, first.mesh) == (again.residual, again.iterations, again.mesh)


def test_a_slack_finger_is_shown_at_rest_and_nothing_is_wrong_with_it(bench):
    for k in range(40):  # at the rate that is asked for
        shape = bench.pull(3_500_000_000 + k * 29_000_000, -0.001)
    assert shape.reason == "cable slack: shown at rest"
    assert bench.health("finger index") == (Health.OK, shape.reason)


def test_beyond_the_travel_the_last_converged_shape_is_marked(bench):
    shape = bench.pull(4_800_000_000, 0.012)
    assert not shape.converged
    assert "8.00 mm" in shape.reason
    assert bench.health("finger index") == (Health.WARN, shape.reason)


def test_a_swap_shows_the_mounted_profile(bench):
    before = bench.pull(5_000_000_000, 0.004).mesh
    bench.cell.publish(CellState(mounted=[MountedFinger(finger="index", profile="hook", state=MountedFinger.VERIFIED)]))
    bench.spin(lambda: bench.node._session.mounted == {"index": "hook"})
    assert bench.pull(6_000_000_000, 0.004).mesh != before


def capstan(coefficient, **changes):
    fields = {
        "id": f"capstan-{coefficient}",
        "law": "capstan",
        "k_reading": "printed",
        "coefficient_names": ["mu"],
        "coefficients": [coefficient],
        "cable_radius": 0.000125,
        "surface_radius": 0.001,
        "angle_range": [0.0, 6.3],
        "tension_range": [0.0, 100.0],
        "verdict": FrictionModel.USABLE,
    }
    return FrictionModel(**{**fields, **changes})


def test_an_active_friction_model_is_used_instead_of_the_profiles_own(bench):
    own = bench.pull(7_000_000_000, 0.004)
    bench.friction.publish(capstan(0.001))
    bench.spin(lambda: bench.node._session.friction_id == "capstan-0.001")
    without = bench.pull(8_000_000_000, 0.004)
    bench.friction.publish(capstan(0.4))
    bench.spin(lambda: bench.node._session.friction_id == "capstan-0.4")
    rubbed = bench.pull(9_000_000_000, 0.004)
    assert len({own.mesh, without.mesh, rubbed.mesh}) == 3  # each names what it was computed with
    tensions = bench.node._session._fingers["index"].fine.shape(0.004).tension
    assert tensions[0] > 1.1 * tensions[-1]  # friction took its share
    # the same length with friction bends the joints near the actuator more, so the tip is elsewhere
    assert np.abs(np.array(rubbed.vertices) - np.array(without.vertices)).max() > 1e-4


@pytest.mark.parametrize(
    "bad",
    [
        {"verdict": FrictionModel.DO_NOT_USE, "reason": "too few points"},
        {"verdict": FrictionModel.UNSET},
        {"verdict": 200},
        {"law": "velcro"},
        {"coefficients": [-1.0]},
        {"coefficients": [1e300]},
        {"digest": "0" * 64},
    ],
    ids=["verdict", "unset", "unknown verdict", "law", "negative", "huge", "digest"],
)
def test_a_friction_model_that_cannot_be_used_changes_nothing(bench, monkeypatch, bad):
    used, session = [], bench.node._session
    use = session.set_friction
    monkeypatch.setattr(session, "set_friction", lambda friction: used.append(friction.id) or use(friction))
    bench.friction.publish(capstan(0.7, **bad))
    bench.friction.publish(capstan(0.2))
    bench.spin(lambda: "capstan-0.2" in used)
    assert used == ["capstan-0.2"]
    assert session.friction_id == "capstan-0.2"


def test_a_model_of_the_same_name_with_other_numbers_is_another_configuration(bench):
    bench.friction.publish(capstan(0.3, id="rig"))
    bench.spin(lambda: bench.node._session.friction_id == "rig")
    first = bench.pull(12_000_000_000, 0.004).configuration
    bench.friction.publish(capstan(0.31, id="rig"))
    bench.spin(lambda: bench.node._session._friction.law.coefficients == (0.31,))
    assert bench.pull(13_000_000_000, 0.004).configuration != first


def test_shapes_at_less_than_the_rate_asked_for_say_so(bench):
    # 10 Hz of stamps where 35 Hz are asked for: what a solver gives that is too slow for its source
    for k in range(20):
        shape = bench.pull(20_000_000_000 + k * 100_000_000, 0.004)
    assert shape.rate == pytest.approx(10.0, rel=0.05)
    assert "Hz instead of 35 Hz" in shape.reason
    for k in range(40):
        shape = bench.pull(30_000_000_000 + k * 34_000_000, 0.004)
    assert shape.rate > 25.0
    assert not shape.reason
