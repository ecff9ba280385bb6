# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from softgrip_security.errors import SecurityError
from softgrip_security.policy import SHIPPED, Grant, read_policy

SMALL = """
version: 1
withheld: [secret/order]
groups:
  node: {publish: [/rosout], serve: [~/ping]}
  reader: {subscribe: ["{published}"], call: ["{node}/ping"]}
nodes:
  driver: {groups: [node], publish: [tendon/state, secret/order], serve_action: [tendon/move], subscribe: [~/own]}
  camera: {groups: [node], named: [eye], publish: [image], call_action: [tendon/move]}
tools:
  look: {groups: [reader], named: [_ros2cli*]}
"""


def read(tmp_path, text, namespace="/"):
    path = tmp_path / "access.yaml"
    path.write_text(text)
    return read_policy(path, namespace)


def test_names_are_given_in_full(tmp_path):
    policy = read(tmp_path, SMALL, "/cell_1")
    driver = policy.identity("driver")
    assert driver.names(Grant.PUBLISH) == ("/cell_1/secret/order", "/cell_1/tendon/state", "/rosout")
    assert driver.names(Grant.SERVE) == ("/cell_1/driver/ping",)
    assert driver.names(Grant.SUBSCRIBE) == ("/cell_1/driver/own",)


def test_an_action_is_five_endpoints_on_both_sides(tmp_path):
    policy = read(tmp_path, SMALL)
    assert policy.identity("driver").services(Grant.SERVE) == (
        "/driver/ping",
        "/tendon/move/_action/cancel_goal",
        "/tendon/move/_action/get_result",
        "/tendon/move/_action/send_goal",
    )
    assert policy.identity("camera").topics(Grant.SUBSCRIBE) == (
        "/tendon/move/_action/feedback",
        "/tendon/move/_action/status",
    )


def test_what_is_withheld_is_not_among_what_everybody_may_see(tmp_path):
    look = read(tmp_path, SMALL).identity("look")
    assert "/tendon/state" in look.names(Grant.SUBSCRIBE)
    assert "/secret/order" not in look.names(Grant.SUBSCRIBE)
    assert look.names(Grant.CALL) == ("/camera/ping", "/driver/ping", "/eye/ping")


def test_each_named_node_of_a_process_has_services_of_its_own(tmp_path):
    assert read(tmp_path, SMALL).identity("camera").names(Grant.SERVE) == ("/camera/ping", "/eye/ping")


def test_a_node_may_have_helpers_of_its_own_name_and_a_tool_only_its_own(tmp_path):
    policy = read(tmp_path, SMALL)
    assert policy.identity("driver").node_names == ("driver", "driver_*")
    assert policy.identity("look").node_names == ("_ros2cli*",)


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        (("version: 1", "version: 2"), "version: expected 1"),
        (("publish: [image]", "publish: [image, 'a b']"), "found 'a b'"),
        (("publish: [image]", "publish: image"), "expected a list"),
        (("publish: [image]", "publishes: [image]"), "publishes"),
        (("publish: [image]", "publish: ['*']"), "only subscribe"),
        (("publish: [image]", "publish: ['{published}']"), "only subscribe"),
        (("publish: [image]", "publish: ['image/**']"), "image"),
        (("groups: [reader]", "groups: [writer]"), "'writer'"),
        (("{publish: [/rosout], serve", "{groups: [node], publish: [/rosout], serve"), "groups"),
        (("  camera:", "  Camera:"), "'Camera'"),
        (("  camera:", "  router:"), "router"),
        (("  look:", "  camera:"), "camera"),
        (("named: [_ros2cli*]", "named: ['*']"), "node names"),
        (("tools:", "people:"), "people"),
        (("nodes:", "nodes: ["), "YAML"),
    ],
)
def test_what_is_no_policy_is_refused_with_the_reason(tmp_path, wrong, found):
    assert wrong[0] in SMALL
    with pytest.raises(SecurityError, match=f"(?s)access.yaml.*{found}".replace("*]", r"\*]")):
        read(tmp_path, SMALL.replace(*wrong, 1))


def test_a_namespace_that_is_none_is_refused(tmp_path):
    with pytest.raises(SecurityError, match="namespace"):
        read(tmp_path, SMALL, "cell")


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SecurityError, match="expected a policy"):
        read_policy(tmp_path / "none.yaml")


# -- the shipped policy ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped():
    return read_policy(SHIPPED)


def holders(policy, grant, name):
    names = (
        (lambda one: one.topics(grant))
        if grant in {Grant.PUBLISH, Grant.SUBSCRIBE}
        else (lambda one: one.services(grant))
    )
    return {one.name for one in policy.identities if name in names(one)}


def test_only_the_driver_says_what_the_tendons_do(shipped):
    for topic in ("/tendon/state", "/tendon/status", "/safety/state", "/tendon/owners"):
        assert holders(shipped, Grant.PUBLISH, topic) == {"tendon_driver"}
    for service in ("/estop", "/estop_reset", "/tendon/lock", "/tendon/unlock", "/tendon/lease"):
        assert holders(shipped, Grant.SERVE, service) == {"tendon_driver"}


def test_nobody_but_the_manager_the_standard_gripper_the_shift_and_people_moves_a_tendon(shipped):
    goal = "/tendon/move/_action/send_goal"
    assert holders(shipped, Grant.CALL, goal) == {
        "panel",  # where nobody owns the tendons: it gets no lease
        "grasp_mix_manager",
        "gripper_command",
        "shift",
        "first_run",
        "teleoperate",  # while its dead-man switch is held
        "cell_controller",
        "operate",
        "engineer",
    }
    assert holders(shipped, Grant.PUBLISH, "/tendon/trajectory") == {"teleoperate", "engineer"}
    assert holders(shipped, Grant.CALL, "/tendon/lease") == {
        "grasp_mix_manager",
        "gripper_command",
        "shift",
        "first_run",
        "teleoperate",
        "cell_controller",
        "operate",
        "engineer",
    }


def test_who_only_looks_changes_nothing(shipped):
    look = shipped.identity("look")
    assert not any(look.names(grant) for grant in (Grant.PUBLISH, Grant.SERVE, Grant.SERVE_ACTION, Grant.CALL_ACTION))
    harmless = ("get_", "list_", "describe_", "ping", "/cell/plan_mix", "/finger/predict", "/friction/list")
    assert all(any(text in name for text in harmless) for name in look.names(Grant.CALL))


def test_leases_are_heard_by_the_driver_the_recorder_and_an_engineer_alone(shipped):
    hears = holders(shipped, Grant.SUBSCRIBE, "/tendon/heartbeat") | holders(shipped, Grant.SUBSCRIBE, "*")
    assert hears == {"tendon_driver", "recorder", "engineer"}


def test_parameters_and_lifecycle_are_set_by_an_engineer_alone(shipped):
    by_hand_or_page = {"engineer", "panel"}  # the page's log-in asks for an engineer, too
    for node in ("tendon_driver", "friction_rig", "camera"):
        assert holders(shipped, Grant.CALL, f"/{node}/set_parameters") == by_hand_or_page
    assert holders(shipped, Grant.CALL, "/tendon_driver/change_state") == by_hand_or_page
    assert holders(shipped, Grant.CALL, "/friction_rig/change_state") == {"engineer"}


def test_no_node_knows_the_truth_of_the_emulated_cell(shipped):
    nodes = {one.name for one in shipped.identities if not one.is_tool}
    assert holders(shipped, Grant.SUBSCRIBE, "/emulator/truth") & nodes == set()
