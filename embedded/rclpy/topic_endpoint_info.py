# SPDX-License-Identifier: Apache-2.0
"""What is known about an endpoint of a topic."""

from __future__ import annotations

import functools
import operator
from enum import IntEnum
from typing import Any

from rclpy.qos import QoSProfile, qos_profile_unknown
from rclpy.type_hash import TypeHash

from embedded_ros import wire
from embedded_ros.wire import Entity, EntityKind


class TopicEndpointTypeEnum(IntEnum):
    """Publisher or subscription."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TopicEndpointInfo:
    """Node, type, QoS and gid of an endpoint."""

    __slots__ = ("_endpoint_gid", "_endpoint_type", "_node_name", "_node_namespace", "_qos_profile", "_topic_type",
                 "_topic_type_hash")  # fmt: skip

    def __init__(self, **kwargs: Any) -> None:
        unknown = {"_" + name for name in kwargs} - set(self.__slots__)
        if unknown:
            raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(sorted(unknown))}")
        defaults = {
            "node_name": "",
            "node_namespace": "",
            "topic_type": "",
            "topic_type_hash": TypeHash(),
            "endpoint_type": TopicEndpointTypeEnum.INVALID,
            "endpoint_gid": [],
            "qos_profile": qos_profile_unknown,
        }
        for name, value in {**defaults, **kwargs}.items():
            setattr(self, name, value)

    node_name: str
    node_namespace: str
    topic_type: str
    topic_type_hash: TypeHash
    endpoint_type: TopicEndpointTypeEnum
    endpoint_gid: list[int]
    qos_profile: QoSProfile

    @classmethod
    def _from_entity(cls, entity: Entity) -> TopicEndpointInfo:
        known = _made(entity)
        own = {"_endpoint_gid": known.endpoint_gid.copy(), "_qos_profile": known.qos_profile._copy()}
        twin = object.__new__(cls)
        for slot in cls.__slots__:
            setattr(twin, slot, own.get(slot, getattr(known, slot)))
        return twin

    @classmethod
    def _make(cls, entity: Entity) -> TopicEndpointInfo:
        return cls(
            node_name=entity.node,
            node_namespace=entity.namespace,
            topic_type=entity.ros_type,
            topic_type_hash=TypeHash.from_text(entity.hash),
            endpoint_type=TopicEndpointTypeEnum.PUBLISHER
            if entity.kind is EntityKind.PUBLISHER
            else TopicEndpointTypeEnum.SUBSCRIPTION,
            endpoint_gid=list(wire.gid_of(wire.encode_token(entity))),
            qos_profile=QoSProfile._from_wire(entity.qos),
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TopicEndpointInfo):
            return False
        return all(getattr(self, slot) == getattr(other, slot) for slot in self.__slots__)

    __hash__ = None  # type: ignore[assignment]  # holds a list

    def __str__(self) -> str:
        gid = ".".join(f"{byte:02x}" for byte in self.endpoint_gid)
        history_depth = self.qos_profile.history.name
        if history_depth == "KEEP_LAST":
            history_depth += f" ({self.qos_profile.depth})"
        return "\n".join(
            (
                f"Node name: {self.node_name}",
                f"Node namespace: {self.node_namespace}",
                f"Topic type: {self.topic_type}",
                f"Topic type hash: {self.topic_type_hash}",
                f"Endpoint type: {self.endpoint_type.name}",
                f"GID: {gid}",
                "QoS profile:",
                f"  Reliability: {self.qos_profile.reliability.name}",
                f"  History (Depth): {history_depth}",
                f"  Durability: {self.qos_profile.durability.name}",
                f"  Lifespan: {self.qos_profile.lifespan}",
                f"  Deadline: {self.qos_profile.deadline}",
                f"  Liveliness: {self.qos_profile.liveliness.name}",
                f"  Liveliness lease duration: {self.qos_profile.liveliness_lease_duration}",
            )
        )


# Nodes ask for them several times a second, and most are those of last time.
_made = functools.lru_cache(maxsize=1024)(TopicEndpointInfo._make)


def _make_property(name: str, kind: type) -> property:
    def put(self: TopicEndpointInfo, value: Any) -> None:
        if kind is TopicEndpointTypeEnum and isinstance(value, int):
            value = TopicEndpointTypeEnum(value)
        if not isinstance(value, kind):
            raise AssertionError(f"{name}: expected {kind.__name__}, found {value!r}")
        setattr(self, "_" + name, value)

    return property(operator.attrgetter("_" + name), put, doc=f"The {name.replace('_', ' ')}.")


for _name, _kind in (
    ("node_name", str), ("node_namespace", str), ("topic_type", str), ("topic_type_hash", TypeHash),
    ("endpoint_type", TopicEndpointTypeEnum), ("endpoint_gid", list), ("qos_profile", QoSProfile),
):  # fmt: skip
    setattr(TopicEndpointInfo, _name, _make_property(_name, _kind))
