# SPDX-License-Identifier: Apache-2.0
"""A policy through topics and services, against a cell that pulls each tendon as it is told."""

from __future__ import annotations

import numpy as np
import pytest
import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger

pytest.importorskip("gymnasium", reason="make study-setup")

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_gym.grasp_policy import GraspPolicy
from softgrip_gym.nodes import policy_runner
from softgrip_gym.nodes.policy_runner import PolicyRunError, PolicyRunner
from softgrip_gym.tendons import MAX_RATE_M_S, PERIOD_S
from softgrip_interfaces.msg import EmulatorTruth
from softgrip_interfaces.srv import MountFingers, PlaceObject
from softgrip_nodekit import SENSOR
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.following_cell import FollowingCell, spun

APPLE = read_catalogue().products["apple"]
#: As stiff as 2 N a millimetre.
N_PER_M = 2000.0


class PolicyCell(FollowingCell):
    """With a product that hangs between its fingers."""

    def __init__(self):
        services = [
            (Trigger, "tendon/home"), (Trigger, "tendon/release"), (PlaceObject, "emulator/place_object"),
            (MountFingers, "emulator/mount"),
        ]  # fmt: skip
        super().__init__(services, tick_s=0.002, n_per_m=N_PER_M)
        self._truth = self.create_publisher(EmulatorTruth, "emulator/truth", SENSOR)

    def publish_more(self):
        self._truth.publish(EmulatorTruth(product="apple", held=True, touching=True))


@pytest.fixture
def cell(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    one = PolicyCell()
    with spun(one):
        yield one


@pytest.fixture
def runner(cell):
    node = Node("policy_runner")
    yield PolicyRunner(node, GraspPolicy("power", (10.0, 0.0, 0.0), (6.0, 0.0, 0.0), 1.0))
    node.destroy_node()


def test_a_policy_winds_the_tendons_it_leased_and_lets_them_go(cell, runner):
    run = runner.grasp(APPLE, 1.0, 0.5)
    assert run.is_held
    assert cell.asked == [
        "emulator/place_object", "emulator/mount", "tendon/home", "emulator/place_object", "tendon/lease",
        "tendon/lease_release", "tendon/release",
    ]  # fmt: skip
    assert {order.header.frame_id for order in cell.orders} == {"token"}
    lengths_m = np.array([order.points[0].positions for order in cell.orders])
    steps_m = np.diff(lengths_m, axis=0)
    assert np.abs(steps_m).max() <= policy_runner.MAX_LATE_PERIODS * MAX_RATE_M_S * PERIOD_S + 1e-9
    # where a tendon of 2 N/mm carries 10 N, and the thumb's 6 N
    assert lengths_m[-1] == pytest.approx([0.005, 0.005, 0.003], abs=3e-4)


def test_a_refused_lease_moves_nothing(cell, runner):
    cell.owner = "a person"
    with pytest.raises(PolicyRunError, match="owned by a person"):
        runner.grasp(APPLE, 1.0, 0.5)
    assert cell.orders == []


def test_a_cell_that_falls_silent_is_named_and_let_go(cell, runner, monkeypatch):
    monkeypatch.setattr(policy_runner, "SILENCE_TIMEOUT_S", 0.5)
    cell.speaks = False
    with pytest.raises(PolicyRunError, match="tendon/state"):
        runner.grasp(APPLE, 1.0, 0.5)
    assert cell.asked[-1] == "tendon/release"
