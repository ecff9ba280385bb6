# SPDX-License-Identifier: Apache-2.0
"""Write a policy in the words of SROS2: policy.xml, and what DDS Security reads: permissions.xml and governance.xml.

The forms are those of sros2's policy.xsd (0.2.0) and of DDS Security 1.1, 9.4.1.2 and 9.4.1.3; ROS names become DDS
topics as in design.ros2.org, "Topic and Service name mapping to DDS".
"""

from __future__ import annotations

import datetime as dt
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from softgrip_security.policy import EVERY_TOPIC, Grant, Policy, PolicyIdentity

#: Domains that a keystore is good for. ROS 2 knows 0 to 232; Cyclone DDS refuses the file that names more than 230.
#: The keys are the border of a cell, not the domain.
DOMAINS = (0, 230)
#: What participants of rmw_fastrtps and rmw_cyclonedds tell each other of their nodes.
_GRAPH_TOPIC = "ros_discovery_info"
#: What rclpy makes for every node, also for those of the `ros2` command. DDS refuses to make an endpoint that is not
#: granted, and then there is no node; Zenoh only drops what is sent. access.yaml grants it to the nodes of the cell.
_TOPICS_OF_A_NODE = ("/parameter_events", "/rosout")
_SERVICES_OF_A_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901"
_QUALIFIERS = (
    ("topics", "topic", "publish", Grant.PUBLISH),
    ("topics", "topic", "subscribe", Grant.SUBSCRIBE),
    ("services", "service", "reply", Grant.SERVE),
    ("services", "service", "request", Grant.CALL),
    ("actions", "action", "execute", Grant.SERVE_ACTION),
    ("actions", "action", "call", Grant.CALL_ACTION),
)


def policy_xml(policy: Policy) -> bytes:
    """Return the policy as `ros2 security create_permission` and zenoh_security_tools read it."""
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    for identity in policy.identities:
        profiles = ET.SubElement(ET.SubElement(enclaves, "enclave", path=identity.enclave), "profiles")
        profile = ET.SubElement(profiles, "profile", ns=policy.namespace, node=identity.name)
        for group, element, qualifier, grant in _QUALIFIERS:
            _fill(profile, group, {qualifier: "ALLOW"}, element, identity.names(grant))
    return _document(root)


def permissions_xml(identity: PolicyIdentity, begin: dt.datetime, end: dt.datetime) -> bytes:
    """Return the permissions of an identity, for as long as its certificate is good; all else is denied."""
    root = _dds("permissions")
    grant = ET.SubElement(ET.SubElement(root, "permissions"), "grant", name=identity.enclave)
    ET.SubElement(grant, "subject_name").text = f"CN={identity.enclave}"
    validity = ET.SubElement(grant, "validity")
    ET.SubElement(validity, "not_before").text = _time(begin)
    ET.SubElement(validity, "not_after").text = _time(end)
    rule = ET.SubElement(grant, "allow_rule")
    _domains(rule)
    for direction, topics in (("publish", published_topics(identity)), ("subscribe", subscribed_topics(identity))):
        _fill(ET.SubElement(rule, direction), "topics", {}, "topic", topics)
    ET.SubElement(grant, "default").text = "DENY"
    return _document(root)


def governance_xml() -> bytes:
    """Return the rules of the domain: nobody without a certificate, everything checked and encrypted."""
    root = _dds("governance")
    rule = ET.SubElement(ET.SubElement(root, "domain_access_rules"), "domain_rule")
    _domains(rule)
    for name, value in (
        ("allow_unauthenticated_participants", "false"),
        ("enable_join_access_control", "true"),
        ("discovery_protection_kind", "ENCRYPT"),
        ("liveliness_protection_kind", "ENCRYPT"),
        ("rtps_protection_kind", "SIGN"),
    ):
        ET.SubElement(rule, name).text = value
    topic = ET.SubElement(ET.SubElement(rule, "topic_access_rules"), "topic_rule")
    for name, value in (
        ("topic_expression", "*"),
        ("enable_discovery_protection", "true"),
        ("enable_liveliness_protection", "true"),
        ("enable_read_access_control", "true"),
        ("enable_write_access_control", "true"),
        ("metadata_protection_kind", "ENCRYPT"),
        ("data_protection_kind", "ENCRYPT"),
    ):
        ET.SubElement(topic, name).text = value
    return _document(root)


def published_topics(identity: PolicyIdentity) -> list[str]:
    """Return the DDS topics that an identity writes."""
    own_topics = _TOPICS_OF_A_NODE if identity.is_tool else ()
    return _topics(
        [*identity.topics(Grant.PUBLISH), *own_topics], asks=identity.services(Grant.CALL), answers=_served(identity)
    )


def subscribed_topics(identity: PolicyIdentity) -> list[str]:
    """Return the DDS topics that an identity reads."""
    return _topics(identity.topics(Grant.SUBSCRIBE), asks=_served(identity), answers=identity.services(Grant.CALL))


def _served(identity: PolicyIdentity) -> list[str]:
    """Return the services that an identity answers, with those that every node of a tool has."""
    tools = identity.node_names if identity.is_tool else ()
    return [*identity.services(Grant.SERVE), *(f"/{node}/{name}" for node in tools for name in _SERVICES_OF_A_NODE)]


def _topics(topics: Iterable[str], *, asks: Iterable[str], answers: Iterable[str]) -> list[str]:
    """Return the DDS topics of ROS topics (rt), of requests (rq) and of replies (rr)."""
    return sorted(
        {
            _GRAPH_TOPIC,
            *("rt/*" if name == EVERY_TOPIC else f"rt{name}" for name in topics),
            *(f"rq{name}Request" for name in asks),
            *(f"rr{name}Reply" for name in answers),
        }
    )


def _fill(parent: ET.Element, group: str, attributes: dict[str, str], element: str, texts: Iterable[str]) -> None:
    """Add <group><element>text</element>...</group>, unless there is nothing to list."""
    listed = list(texts)
    if listed:
        below = ET.SubElement(parent, group, attributes)
        for text in listed:
            ET.SubElement(below, element).text = text


def _dds(kind: str) -> ET.Element:
    schema = f"{_SCHEMAS}/omg_shared_ca_{kind}.xsd"
    return ET.Element("dds", {f"{{{_XSI}}}noNamespaceSchemaLocation": schema})


def _domains(parent: ET.Element) -> None:
    span = ET.SubElement(ET.SubElement(parent, "domains"), "id_range")
    for name, value in zip(("min", "max"), DOMAINS, strict=True):
        ET.SubElement(span, name).text = str(value)


def _time(time: dt.datetime) -> str:
    """Return UTC without a zone, as sros2 writes it."""
    return time.astimezone(dt.UTC).replace(tzinfo=None, microsecond=0).isoformat()


def _document(root: ET.Element) -> bytes:
    ET.register_namespace("xsi", _XSI)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"
