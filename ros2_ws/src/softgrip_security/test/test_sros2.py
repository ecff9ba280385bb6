# SPDX-License-Identifier: Apache-2.0
"""What DDS reads. Expected topics are those that sros2 0.13 makes of the same grants (its permissions.xsl)."""

from __future__ import annotations

import datetime as dt
import xml.etree.ElementTree as ET

from softgrip_security.policy import Grant, Policy, PolicyIdentity
from softgrip_security.sros2 import governance_xml, permissions_xml, policy_xml

BEGIN, END = dt.datetime(2026, 1, 2, 3, 4, 5, tzinfo=dt.UTC), dt.datetime(2027, 1, 2, tzinfo=dt.UTC)


def topics(document, direction):
    return [found.text for found in ET.fromstring(document).findall(f".//allow_rule/{direction}/topics/topic")]


def permissions(**grants):
    return permissions_xml(
        PolicyIdentity("camera", ("camera",), {Grant(name): names for name, names in grants.items()}), BEGIN, END
    )


def test_an_action_client_has_the_topics_that_sros2_gives_it():
    document = permissions(call_action=("/fibonacci",))
    assert topics(document, "publish") == [
        "ros_discovery_info",
        "rq/fibonacci/_action/cancel_goalRequest",
        "rq/fibonacci/_action/get_resultRequest",
        "rq/fibonacci/_action/send_goalRequest",
    ]
    assert topics(document, "subscribe") == [
        "ros_discovery_info",
        "rr/fibonacci/_action/cancel_goalReply",
        "rr/fibonacci/_action/get_resultReply",
        "rr/fibonacci/_action/send_goalReply",
        "rt/fibonacci/_action/feedback",
        "rt/fibonacci/_action/status",
    ]


def test_a_server_reads_requests_and_writes_replies():
    document = permissions(serve=("/estop",), publish=("/rosout",), subscribe=("/clock",))
    assert topics(document, "publish") == ["ros_discovery_info", "rr/estopReply", "rt/rosout"]
    assert topics(document, "subscribe") == ["ros_discovery_info", "rq/estopRequest", "rt/clock"]


def test_a_recorder_reads_every_topic_and_no_requests():
    assert topics(permissions(subscribe=("*",)), "subscribe") == ["ros_discovery_info", "rt/*"]


def test_a_ros2_command_has_what_rclpy_makes_for_every_node():
    document = permissions_xml(PolicyIdentity("look", ("_ros2cli*",), is_tool=True), BEGIN, END)
    # the publishers and services that `ros2 node info` of Jazzy shows for a bare node
    services = [
        *("describe_parameters", "get_parameter_types", "get_parameters", "get_type_description"),
        *("list_parameters", "set_parameters", "set_parameters_atomically"),
    ]
    assert topics(document, "publish") == [
        "ros_discovery_info",
        *(f"rr/_ros2cli*/{name}Reply" for name in services),
        "rt/parameter_events",
        "rt/rosout",
    ]
    assert topics(document, "subscribe") == [
        "ros_discovery_info",
        *(f"rq/_ros2cli*/{name}Request" for name in services),
    ]


def test_all_else_is_denied_to_the_holder_of_the_certificate_for_its_time():
    root = ET.fromstring(permissions(publish=("/rosout",)))
    grant = root.find("permissions/grant")
    assert grant is not None
    assert [child.tag for child in grant] == ["subject_name", "validity", "allow_rule", "default"]
    assert grant.findtext("subject_name") == "CN=/softgrip/camera"
    assert grant.findtext("validity/not_before") == "2026-01-02T03:04:05"
    assert grant.findtext("validity/not_after") == "2027-01-02T00:00:00"
    assert grant.findtext("default") == "DENY"


def test_the_domain_admits_nobody_without_a_certificate():
    rule = ET.fromstring(governance_xml()).find("domain_access_rules/domain_rule")
    assert rule is not None
    assert rule.findtext("allow_unauthenticated_participants") == "false"
    assert rule.findtext("enable_join_access_control") == "true"
    for name in ("enable_read_access_control", "enable_write_access_control"):
        assert rule.findtext(f"topic_access_rules/topic_rule/{name}") == "true"


def test_the_policy_is_written_as_sros2_reads_it():
    grants = {Grant.PUBLISH: ("/image",), Grant.SERVE: ("/camera/ping",), Grant.CALL_ACTION: ("/tendon/move",)}
    root = ET.fromstring(policy_xml(Policy((PolicyIdentity("camera", ("camera",), grants),))))
    enclave = root.find("enclaves/enclave")
    assert enclave is not None
    assert enclave.get("path") == "/softgrip/camera"
    profile = enclave.find("profiles/profile")
    assert profile is not None
    assert profile.attrib == {"ns": "/", "node": "camera"}
    assert [(child.tag, child.attrib, [name.text for name in child]) for child in profile] == [
        ("topics", {"publish": "ALLOW"}, ["/image"]),
        ("services", {"reply": "ALLOW"}, ["/camera/ping"]),
        ("actions", {"call": "ALLOW"}, ["/tendon/move"]),
    ]


def test_no_domain_is_named_that_cyclone_dds_refuses():
    """Its parser takes ids of 0 to 230 (access_control_parser.c, governance_element_data_cb), or no file at all."""
    for document in (governance_xml(), permissions()):
        ids = [int(found.text) for name in ("id", "min", "max") for found in ET.fromstring(document).iter(name)]
        assert ids
        assert 0 <= min(ids) <= max(ids) <= 230
