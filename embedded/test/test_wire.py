# SPDX-License-Identifier: Apache-2.0
"""The wire of rmw_zenoh: vectors seen from rmw_zenoh_cpp 0.2.10 (Jazzy) and from its design document."""

from __future__ import annotations

import pytest

from embedded_ros import wire
from embedded_ros.graph import Graph, incompatible_policy
from embedded_ros.wire import Entity, EntityKind, WireQos

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
# Token of a publisher in a real rmw_zenoh_cpp process, and the GID that `ros2 topic info -v` there printed for it.
REAL_TOKEN = (
    "@ros2_lv/42/102ffe85c338bca7aae6ebf5ac28e6c1/0/11/MP/%/%/real_node/%real%latched/std_msgs::msg::dds_::String_/"
    f"{STRING_HASH}/:1:,1:,:,:,,"
)
REAL_GID = "89.d2.c2.17.e3.ef.cc.89.c4.5c.77.b8.97.f2.ba.95"
REAL_NODE_TOKEN = "@ros2_lv/42/102ffe85c338bca7aae6ebf5ac28e6c1/0/0/NN/%/%/real_node"

QOS_TEXTS = [
    (WireQos(depth=10), "::,10:,:,:,,"),
    (WireQos(reliability=2, depth=5), "2::,5:,:,:,,"),
    (WireQos(durability=1, depth=1), ":1:,1:,:,:,,"),
    (WireQos(durability=1, depth=1000, lifespan_ns=10 * 10**9), ":1:,1000:,:10,0:,,"),
    (WireQos(), "::,:,:,:,,"),
    (WireQos(history=2), "::2,:,:,:,,"),
    (WireQos(liveliness=3, lease_ns=1_500_000_000), "::,:,:,:3,1,500000000"),
]


@pytest.mark.parametrize(("qos", "text"), QOS_TEXTS)
def test_qos_text(qos: WireQos, text: str) -> None:
    assert wire.encode_qos(qos) == text
    assert wire.decode_qos(text) == qos


def test_system_defaults_are_announced_as_defaults() -> None:
    assert wire.encode_qos(WireQos(0, 0, 0, 0)) == "::,:,:,:,,"


def test_token_and_gid_of_a_real_publisher() -> None:
    entity = wire.decode_token(REAL_TOKEN)
    assert wire.encode_token(entity) == REAL_TOKEN
    assert wire.gid_of(REAL_TOKEN).hex(".") == REAL_GID
    assert (entity.name, entity.ros_type, entity.full_node_name) == (
        "/real/latched",
        "std_msgs/msg/String",
        "/real_node",
    )
    assert (entity.qos.durability, entity.qos.depth) == (1, 1)


def test_node_token() -> None:
    entity = wire.decode_token(REAL_NODE_TOKEN)
    assert (entity.kind, entity.full_node_name) == (EntityKind.NODE, "/real_node")
    assert wire.encode_token(entity) == REAL_NODE_TOKEN


def test_names_with_slashes_survive_a_token() -> None:
    entity = Entity(
        0, "a1", 0, 3, EntityKind.SERVICE, "/ns/deep", "n", "/enclave", "/ns/deep/srv", "p::srv::dds_::T_", "h"
    )
    assert wire.decode_token(wire.encode_token(entity)) == entity


@pytest.mark.parametrize(
    "token", ["", "a/b", "@ros2_lv/x/z/0/0/NN/%/%/n", REAL_TOKEN + "/more", "@ros2_lv/0/z/0/0/XX/%/%/n"]
)
def test_foreign_tokens_are_refused_and_ignored(token: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        wire.decode_token(token)
    graph = Graph()
    graph.add(token)
    assert graph.snapshot() == []


def test_data_keys_of_the_design_document() -> None:
    assert wire.dds_type_name("std_msgs/msg/String") == "std_msgs::msg::dds_::String_"
    assert wire.ros_type_name("example_interfaces::srv::dds_::AddTwoInts_") == "example_interfaces/srv/AddTwoInts"
    key = wire.data_key(0, "/robot1/chatter", "std_msgs::msg::dds_::String_", STRING_HASH)
    assert key == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"


def test_attachment_is_33_bytes() -> None:
    gid = bytes(range(16))
    data = wire.encode_attachment(5, 1_700_000_000_000_000_001, gid)
    assert (data[:8].hex(), data[16:].hex()) == ("0500000000000000", "10" + gid.hex())
    assert int.from_bytes(data[8:16], "little") == 1_700_000_000_000_000_001
    assert len(data) == 33
    assert wire.decode_attachment(data) == (5, 1_700_000_000_000_000_001, gid)
    with pytest.raises(ValueError, match="gid of 16 bytes"):
        wire.decode_attachment(data[:16] + b"\x0f" + gid)


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (WireQos(), WireQos(), None),
        (WireQos(reliability=2), WireQos(), "RELIABILITY_QOS_POLICY"),
        (WireQos(), WireQos(reliability=2), None),
        (WireQos(), WireQos(durability=1), "DURABILITY_QOS_POLICY"),
        (WireQos(durability=1), WireQos(), None),
        (WireQos(), WireQos(deadline_ns=10**9), "DEADLINE_QOS_POLICY"),
        (WireQos(deadline_ns=10**9), WireQos(), None),
        (WireQos(), WireQos(liveliness=3), "LIVELINESS_QOS_POLICY"),
    ],
)
def test_qos_meets_as_dds_says(offered: WireQos, requested: WireQos, policy: str | None) -> None:
    assert incompatible_policy(offered, requested) == policy
