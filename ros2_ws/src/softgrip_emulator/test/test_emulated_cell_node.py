# SPDX-License-Identifier: Apache-2.0
"""The node as a process: wires before services, a person's hands as services, truth, clock, clean end."""

import os
import signal
import subprocess
import sys
from itertools import pairwise

import pytest
import rclpy
from rosgraph_msgs.msg import Clock

from softgrip_interfaces.msg import EmulatorTruth
from softgrip_interfaces.srv import InjectFault, MountFingers, PlaceObject, SetRig
from softgrip_nodekit import SENSOR, seconds

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RUN = [sys.executable, "-c", "from softgrip_emulator.nodes.emulated_cell import main; main()", "--ros-args"]


@pytest.fixture
def domain(monkeypatch):
    # unlikely to be used by anybody else on this machine
    monkeypatch.setenv("ROS_DOMAIN_ID", str(60 + os.getpid() % 40))


@pytest.fixture
def start(domain, tmp_path):
    processes = []

    def run(*parameters):
        words = [word for parameter in (f"wire_dir:={tmp_path}", *parameters) for word in ("-p", parameter)]
        processes.append(subprocess.Popen(RUN + words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def peer(domain):
    rclpy.init()
    node = rclpy.create_node("emulator_test")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def call(node, kind, name, **fields):
    client = node.create_client(kind, name)
    assert client.wait_for_service(timeout_sec=20.0)
    future = client.call_async(kind.Request(**fields))
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    return future.result()


def spin_until(node, condition, until):
    def once():
        rclpy.spin_once(node, timeout_sec=0.05)
        return condition()

    return until(once, 10.0)


def test_services_truth_and_clean_end(start, peer, tmp_path, until):
    process = start("cell_time_scale:=1.0", "truth_rate:=50.0")
    placed = call(peer, PlaceObject, "emulator/place_object", product="egg", offset=0.0)
    # wires exist before the services do
    assert {path.name for path in tmp_path.iterdir()} >= {"servos", "stand", "gauge", "camera.url"}
    assert placed.success
    refused = call(peer, PlaceObject, "emulator/place_object", product="pear", offset=0.0)
    assert (refused.success, "found 'pear'" in refused.message) == (False, True)
    mounted = call(peer, MountFingers, "emulator/mount", fingers=["thumb"], serials=["PI-T-01"], profiles=["pinch"])
    assert mounted.success
    assert call(peer, SetRig, "emulator/set_rig", angle=0.8, load=0.6).success
    fault = call(peer, InjectFault, "emulator/inject_fault", fault="servo_silent", target="2", duration=0.0)
    assert (fault.success, list(fault.active)) == (True, ["servo_silent@middle"])
    bad = call(peer, InjectFault, "emulator/inject_fault", fault="slack", arguments="[1")
    assert (bad.success, "YAML" in bad.message) == (False, True)
    truths = []
    peer.create_subscription(EmulatorTruth, "emulator/truth", truths.append, SENSOR)
    assert spin_until(peer, lambda: bool(truths), until)
    truth = truths[-1]
    assert (truth.product, truth.touching, list(truth.active_faults)) == ("egg", False, ["servo_silent@middle"])
    assert [(finger.finger, finger.profile) for finger in truth.fingers] == [
        ("index", "power"),
        ("middle", "power"),
        ("thumb", "pinch"),
    ]
    assert [len(finger.joint_angles) for finger in truth.fingers] == [3, 3, 2]
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=15) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_faster_cell_publishes_its_clock(start, peer, until):
    start("cell_time_scale:=2.0")
    ticks = []
    peer.create_subscription(Clock, "/clock", lambda message: ticks.append(seconds(message.clock)), SENSOR)
    assert spin_until(peer, lambda: len(ticks) > 20, until)
    assert all(b > a for a, b in pairwise(ticks))


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("mounted_profiles:=[claw,power,power]", "expected a profile of"),
        ("profiles_directory:=/nowhere", "expected a folder with profiles"),
        ("camera_fps:=0.0", "camera_fps"),
        ("fault_plan:=/nowhere.yaml", "/nowhere.yaml"),
    ],
)
def test_what_keeps_it_from_starting_is_said(start, parameter, message):
    process = start(parameter)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 2
    assert "cannot start" in errors
    assert message in errors
