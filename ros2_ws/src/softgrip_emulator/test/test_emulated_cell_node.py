# SPDX-License-Identifier: Apache-2.0
"""The node as a process: wires before services, a person's hands as services, truth, clock, clean end."""

import signal
import subprocess
from itertools import pairwise

import dynamixel_sdk
import pytest
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature

from softgrip_interfaces.msg import EmulatorTruth
from softgrip_interfaces.srv import InjectFault, MountFingers, PlaceObject, SetRig
from softgrip_nodekit import SENSOR, seconds
from softgrip_testing.free_domains import own_domain
from softgrip_testing.nodes.node_processes import node_processes, peer_node
from softgrip_testing.waiting import TEST_TIMEOUT_S

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())


@pytest.fixture
def start(domain, tmp_path):
    with node_processes("softgrip_emulator.nodes.emulated_cell", (f"wire_dir:={tmp_path}",)) as started:
        yield started


@pytest.fixture
def peer(domain):
    with peer_node("emulator_test") as one:
        yield one


def test_services_truth_and_clean_end(start, peer, tmp_path):
    process = start("truth_rate:=50.0")
    placed = peer.call(PlaceObject, "emulator/place_object", product="egg", offset=0.0)
    # wires exist before the services do
    assert {path.name for path in tmp_path.iterdir()} >= {"servos", "stand", "gauge", "camera.url"}
    assert placed.success
    refused = peer.call(PlaceObject, "emulator/place_object", product="pear", offset=0.0)
    assert (refused.success, "found 'pear'" in refused.message) == (False, True)
    mounted = peer.call(MountFingers, "emulator/mount", fingers=["thumb"], serials=["PI-T-01"], profiles=["pinch"])
    assert mounted.success
    assert peer.call(SetRig, "emulator/set_rig", angle=0.8, load=0.6).success
    fault = peer.call(InjectFault, "emulator/inject_fault", fault="servo_silent", target="2", duration=0.0)
    assert (fault.success, list(fault.active)) == (True, ["servo_silent@middle"])
    for argument, expected in (("length_m", "a number is expected"), ("colour", "expected arguments of ['length_m']")):
        given = [Parameter(argument, value="long").to_parameter_msg()]
        bad = peer.call(InjectFault, "emulator/inject_fault", fault="slack", arguments=given)
        assert (bad.success, expected in bad.message) == (False, True), bad.message
    lossy = [Parameter("share", value=0.0).to_parameter_msg()]
    assert peer.call(InjectFault, "emulator/inject_fault", fault="bytes_lost", arguments=lossy).success
    assert peer.call(InjectFault, "emulator/inject_fault", fault="clear", target="bytes_lost").success
    truths = peer.hear(EmulatorTruth, "emulator/truth", SENSOR)
    peer.spin_until(lambda: truths)
    truth = truths[-1]
    assert (truth.product, truth.touching, list(truth.active_faults)) == ("egg", False, ["servo_silent@middle"])
    assert [(finger.finger, finger.profile) for finger in truth.fingers] == [
        ("index", "power"),
        ("middle", "power"),
        ("thumb", "pinch"),
    ]
    assert [len(finger.joint_angles) for finger in truth.fingers] == [3, 3, 2]
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=TEST_TIMEOUT_S) == 0
    assert list(tmp_path.iterdir()) == []


def test_servos_answer_until_their_host_has_left(start, peer, tmp_path):
    """One Ctrl-C ends emulator and driver at once, and the driver must hear that torque is off."""
    process = start()
    peer.call(PlaceObject, "emulator/place_object", product="egg", offset=0.0)  # the wires are there
    port, servos = dynamixel_sdk.PortHandler(str(tmp_path / "servos")), dynamixel_sdk.PacketHandler(2.0)
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    assert servos.ping(port, 1)[1] == dynamixel_sdk.COMM_SUCCESS
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=1.0)
    torque_enable = 64
    assert servos.write1ByteTxRx(port, 1, torque_enable, 0)[0] == dynamixel_sdk.COMM_SUCCESS
    port.closePort()
    assert process.wait(timeout=TEST_TIMEOUT_S) == 0


def test_its_thermometer_is_right_to_some_degrees_and_follows_the_room(start, peer):
    start("speed:=0.0")
    read = peer.hear(Temperature, "cell/temperature", SENSOR)
    peer.spin_until(lambda: read)
    # the room has 21 to 26 degC; the sensor is off by 0.5 K (one standard deviation), and says so
    assert 19.0 < read[-1].temperature < 28.0
    assert read[-1].variance == 0.25
    warm = [Parameter("temperature_c", value=40.0).to_parameter_msg()]
    assert peer.call(InjectFault, "emulator/inject_fault", fault="room_temperature", arguments=warm).success
    peer.spin_until(lambda: read[-1].temperature > 30.0)
    assert read[-1].temperature == pytest.approx(40.0, abs=2.0)
    stamps = [seconds(one.header.stamp) for one in read]
    assert min(b - a for a, b in pairwise(stamps)) >= 4.99


def test_a_faster_cell_publishes_its_clock(start, peer):
    start("speed:=2.0")
    ticks = peer.hear(Clock, "/clock", SENSOR)
    peer.spin_until(lambda: len(ticks) > 20)
    assert all(seconds(b.clock) > seconds(a.clock) for a, b in pairwise(ticks))


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
    _, errors = process.communicate(timeout=TEST_TIMEOUT_S)
    assert process.returncode == 2
    assert "cannot start" in errors
    assert message in errors
