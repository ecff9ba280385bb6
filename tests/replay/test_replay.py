# SPDX-License-Identifier: Apache-2.0
"""Recorded traffic of the cell, fed back through the nodes' own code: to the same bits.

Made anew by make_bags.py after a deliberate change of what a node computes. On another kind of processor than the one
that answered last, whose vector units round otherwise, numbers may differ by a millionth.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message

from softgrip_bag.comparison import ReplayResult, first_difference
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.messages import message_class, stamp_of, tree
from softgrip_bag.nodes.recorded_bag import RecordedBag
from softgrip_bag.nodes.replay import check, renewed
from softgrip_bag.nodes.replayed_node import ReplayedNode
from softgrip_bag.reader import RawMessage, attachments, topic_summaries
from softgrip_testing.scripts import load_script

PROFILES = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/profiles"
BAGS = Path(__file__).resolve().parent / "bags"
tolerance = load_script(Path(__file__).with_name("rounding.py")).tolerance
NODES = {
    "closings": ("kinematics_predictor", 1000),
    "shapes": ("gdfe_simulator", 3),
    "frames": ("marker_tracker", 20),
    "grasps": ("grasp_mix_manager", 100),
}
OUTCOMES = {"GRIPPED", "EMPTY", "SLIPPED", "ABORTED", "TENDON_FAULT"}
#: How a difference is told.
SAID = re.compile(r"/?\w.+ at \d+\.\d{9} s, field .+: recorded .+, replayed .+")


def bag_of(node: str) -> Path:
    return BAGS / next(bag for bag, (name, _) in NODES.items() if name == node)


def changed(node: str, *arguments: str) -> ReplayResult:
    bag = bag_of(node)
    return check(bag, node, [*arguments], tolerance=tolerance(bag.name))


def stamped(raw: RawMessage) -> tuple[int, object]:
    message = deserialize_message(raw.data, message_class(raw.type_name))
    return stamp_of(message), tree(message)


@pytest.mark.parametrize("bag", NODES)
def test_the_node_says_what_it_said(bag: str) -> None:
    node, minimum = NODES[bag]
    result = check(BAGS / bag, node, tolerance=tolerance(bag))
    assert result.divergence is None, str(result.divergence)
    assert result.without_input == 0
    assert result.compared >= minimum


@pytest.mark.parametrize(
    ("bag", "topic"),
    [
        ("closings", "/finger/residual"),
        pytest.param("closings", "/finger/predicted", marks=pytest.mark.long),
        ("grasps", "/cell/state"),
    ],
)
def test_a_topic_on_which_the_node_says_nothing_any_more_differs(
    bag: str, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = ReplayedNode.published
    monkeypatch.setattr(ReplayedNode, "published", lambda node: [one for one in said(node) if one.topic != topic])
    found = check(BAGS / bag, NODES[bag][0], tolerance=tolerance(bag)).divergence
    assert found is not None
    assert (found.topic, found.recorded, found.replayed) == (topic, "published", "not published")


def test_another_threshold_is_named_with_step_field_time_and_both_values() -> None:
    found = changed("grasp_mix_manager", "-p", "min_contact_tension_n:=0.9").divergence
    assert found is not None
    assert found.recorded != found.replayed
    assert SAID.fullmatch(str(found))


def test_a_change_of_a_profile_by_a_millionth_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "profiles"
    shutil.copytree(PROFILES, folder)
    for path in folder.glob("*.yaml"):
        text, count = re.subn(
            r"(modulus_constant_pa: )([\d.]+)", lambda m: f"{m[1]}{float(m[2]) * (1 + 1e-6)!r}", path.read_text()
        )
        assert count
        path.write_text(text)
    found = changed("kinematics_predictor", "-p", f"profiles_directory:={folder}").divergence
    assert found is not None
    assert found.topic in {"/finger/predicted", "/finger/residual"}
    assert found.recorded != found.replayed
    assert SAID.fullmatch(str(found))


def test_a_change_of_one_number_by_a_hundredth_is_found_as_that_number(tmp_path: Path) -> None:
    """With the digests of the configuration left out it is the number itself that differs."""
    folder = tmp_path / "profiles"
    shutil.copytree(PROFILES, folder)
    for path in folder.glob("*.yaml"):
        text = path.read_text()
        path.write_text(re.sub(r"(modulus_constant_pa: )([\d.]+)", lambda m: f"{m[1]}{float(m[2]) * 1.01!r}", text))
    bag = bag_of("kinematics_predictor")
    fresh = renewed(bag, "kinematics_predictor", ["-p", f"profiles_directory:={folder}"])
    kind = message_class("softgrip_interfaces/msg/FingerStates")
    then = {
        raw.received: tree(deserialize_message(raw.data, kind)) for raw in RecordedBag(bag).read({"/finger/predicted"})
    }
    found = [
        first_difference(then[raw.received], tree(deserialize_message(raw.data, kind)), frozenset({"configuration"}))
        for raw in fresh["/finger/predicted"]
    ]
    # around a swap the digest that tells when the node heard of it is another one: there the fingers may differ
    numbers = [field for field, recorded, _ in filter(None, found) if isinstance(recorded, float)]
    assert len(numbers) > 0.1 * len(found)
    assert all(re.match(r"fingers\[\d\]\.\w+", field) for field in numbers)


def test_the_calibration_is_there_with_its_samples_and_its_model() -> None:
    bag = BAGS / "calibration"
    assert ("/rig/sample", "softgrip_interfaces/msg/FrictionSample") in {
        (t.name, t.type_name) for t in topic_summaries(bag)
    }
    story = digest(bag)
    assert sum(sample.accepted for sample in story.samples) >= 9
    assert story.fits[-1].points == 9


def test_there_is_a_closing_with_every_finger_set() -> None:
    profiles = {(closing.profile, closing.finger) for closing in digest(BAGS / "closings").closings}
    assert {profile for profile, _ in profiles} == {"hook", "pinch", "power"}


def test_there_is_a_grasp_with_every_outcome_and_the_fault_of_one() -> None:
    story = digest(BAGS / "grasps")
    assert {grasp.outcome for grasp in story.grasps} == OUTCOMES
    assert any("index" in fault.name for fault in story.faults if fault.source == "tendon/status")


@pytest.mark.parametrize("bag", NODES)
def test_the_bag_carries_what_sets_its_node_up(bag: str) -> None:
    node, _ = NODES[bag]
    assert f"parameters/{node}.yaml" in {attachment.name for attachment in attachments(BAGS / bag)}


def test_a_bag_of_ros_2s_own_recorder_is_read_and_replayed_like_ours() -> None:
    """`ros2 bag record` of Jazzy (rosbag2 0.26.10, zstd) made it while its `ros2 bag play` played closings of ours.

    Both are of the release before the digest of friction models, and stay as they were recorded.
    """
    ours, theirs = BAGS / "by_rosbag2_source", BAGS / "by_rosbag2"
    for topic in ("/tendon/state", "/friction/active", "/cell/state"):
        sent, came = (dict(stamped(message) for message in RecordedBag(bag).read({topic})) for bag in (ours, theirs))
        assert came
        # compared as values: the middleware may add padding to a message's bytes
        assert all(first_difference(sent[stamp], now, frozenset()) is None for stamp, now in came.items())
    latched = [{topic.name for topic in topic_summaries(bag) if topic.latched} for bag in (theirs, ours)]
    assert latched[0] == latched[1] - {"/rosout"}
    kind = message_class("softgrip_interfaces/msg/FingerStates")
    outputs = (deserialize_message(raw.data, kind) for raw in RecordedBag(ours).read({"/finger/predicted"}))
    recorded = {stamp_of(output): output for output in outputs}
    replayed = renewed(theirs, "kinematics_predictor")["/finger/predicted"]
    assert len(replayed) > 100
    for raw in replayed:
        output = deserialize_message(raw.data, kind)
        then = tree(recorded[stamp_of(output)])
        named = frozenset({"configuration", "friction_digest"})
        # the kernel of that release rounded otherwise
        assert first_difference(then, tree(output), named, tolerance=max(tolerance(theirs.name), 1e-12)) is None


def test_the_bags_are_small() -> None:
    assert sum(file.stat().st_size for file in BAGS.rglob("*.mcap")) < 12_000_000
