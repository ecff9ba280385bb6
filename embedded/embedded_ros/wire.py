# SPDX-License-Identifier: Apache-2.0
"""What rmw_zenoh_cpp (Jazzy, 0.2.10) puts on the wire: keys, liveliness tokens, QoS text, attachments, gids.

Pure: text and bytes in, values out. Nothing else in the package knows these formats.
"""

from __future__ import annotations

import functools
import re
import struct
from dataclasses import dataclass
from enum import StrEnum

import xxhash

from embedded_ros.names import full_topic_problem, namespace_problem, node_problem

INFINITE_NS = 9223372036 * 10**9 + 854775807
_DEFAULT_DEPTH = 42
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
ATTACHMENT_BYTES = _ATTACHMENT.size
#: What rmw's enumerations hold for an endpoint that exists (rmw/types.h).
_POLICIES = {"reliability": (1, 2), "durability": (1, 2), "history": (1, 2), "liveliness": (1, 3)}
_MAX_TOKEN_CHARS = 4096
_TYPE_NAME = re.compile(r"[a-zA-Z]\w*::(?:msg|srv|action)::dds_::[a-zA-Z]\w*_", re.ASCII)


class EntityKind(StrEnum):
    """What a liveliness token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class WireQos:
    """QoS as it is announced; numbers are those of rmw: see the tables in :func:`encode_qos`."""

    reliability: int = 1
    durability: int = 2
    history: int = 1
    depth: int = _DEFAULT_DEPTH
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: int = 1
    lease_ns: int = INFINITE_NS


DEFAULT_QOS = WireQos()


def encode_qos(qos: WireQos) -> str:
    """Return ``reliability:durability:history,depth:deadline:lifespan:liveliness,lease``; defaults are left empty.

    Reliability 1 reliable, 2 best effort; durability 1 transient local, 2 volatile; history 1 keep last, 2 keep all;
    liveliness 1 automatic, 3 manual by topic. System defaults (0) and depth 0 become the defaults.
    """

    def piece(value: int, default: int) -> str:
        return "" if value in {default, 0} else str(value)

    def duration(value_ns: int) -> str:
        return "," if value_ns in {INFINITE_NS, 0} else f"{value_ns // 10**9},{value_ns % 10**9}"

    return ":".join(
        (
            piece(qos.reliability, 1),
            piece(qos.durability, 2),
            f"{piece(qos.history, 1)},{piece(qos.depth, _DEFAULT_DEPTH)}",
            duration(qos.deadline_ns),
            duration(qos.lifespan_ns),
            f"{piece(qos.liveliness, 1)},{duration(qos.lease_ns)}",
        )
    )


def decode_qos(text: str) -> WireQos:
    """Read QoS text; ValueError when it is malformed."""
    pieces = text.split(":")
    if len(pieces) != 6:
        raise ValueError(f"expected six ':'-separated pieces of QoS, found {text!r}")
    reliability, durability, history_depth, deadline, lifespan, liveliness_lease = pieces
    history, depth = history_depth.split(",")
    liveliness, lease_s, lease_ns = liveliness_lease.split(",")

    def number(piece: str, default: int) -> int:
        return int(piece) if piece else default

    def duration(seconds: str, nanoseconds: str) -> int:
        return int(seconds) * 10**9 + int(nanoseconds) if seconds or nanoseconds else INFINITE_NS

    found = WireQos(
        number(reliability, 1),
        number(durability, 2),
        number(history, 1),
        number(depth, _DEFAULT_DEPTH),
        duration(*deadline.split(",")),
        duration(*lifespan.split(",")),
        number(liveliness, 1),
        duration(lease_s, lease_ns),
    )
    _check_qos(found)
    return found


def _check_qos(qos: WireQos) -> None:
    for name, known in _POLICIES.items():
        if getattr(qos, name) not in known:
            raise ValueError(f"{name}: expected one of {known}, found {getattr(qos, name)}")
    for name in ("depth", "deadline_ns", "lifespan_ns", "lease_ns"):
        if not 0 <= getattr(qos, name) < 1 << 63:
            raise ValueError(f"{name}: expected 0 .. 2^63, found {getattr(qos, name)}")


@dataclass(frozen=True)
class Entity:
    """A node or an endpoint as its token tells. ``name`` to ``qos`` are empty for a node."""

    domain: int
    zid: str
    node_id: int
    entity_id: int
    kind: EntityKind
    namespace: str
    node: str
    enclave: str = "/"
    name: str = ""
    type: str = ""
    hash: str = ""
    qos: WireQos = DEFAULT_QOS

    @property
    def full_node_name(self) -> str:
        """Return ``/namespace/node``."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    @property
    def ros_type(self) -> str:
        """Return ``pkg/kind/Name`` of the announced type."""
        return ros_type_name(self.type)


def dds_type_name(name: str) -> str:
    """Turn ``pkg/msg/Name`` into ``pkg::msg::dds_::Name_``."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


@functools.lru_cache
def ros_type_name(name: str) -> str:
    """Turn ``pkg::msg::dds_::Name_`` into ``pkg/msg/Name``."""
    return name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """Return the key that topics and services of a fully qualified name use."""
    return f"{domain}/{name.strip('/')}/{type_name}/{type_hash}"


def liveliness_prefix(domain: int) -> str:
    """Return the key expression that matches every token of a domain."""
    return f"@ros2_lv/{domain}/**"


def _mangle(text: str) -> str:
    return text.replace("/", "%")


def encode_token(entity: Entity) -> str:
    """Return the liveliness key of a node or endpoint."""
    parts = [
        "@ros2_lv",
        str(entity.domain),
        entity.zid,
        str(entity.node_id),
        str(entity.entity_id),
        str(entity.kind),
        _mangle(entity.enclave or "/"),
        _mangle(entity.namespace or "/"),
        _mangle(entity.node),
    ]
    if entity.kind is not EntityKind.NODE:
        parts += [_mangle(entity.name), _mangle(entity.type), _mangle(entity.hash), encode_qos(entity.qos)]
    return "/".join(parts)


def decode_token(key: str) -> Entity:
    """Read a liveliness key; ValueError when it is none of rmw_zenoh's."""
    if len(key) > _MAX_TOKEN_CHARS:
        raise ValueError(f"expected a liveliness key of {_MAX_TOKEN_CHARS} characters at most, found {len(key)}")
    parts = key.split("/")
    if len(parts) not in {9, 13} or parts[0] != "@ros2_lv":
        raise ValueError(f"expected a liveliness key of 9 or 13 parts, found {key!r}")
    kind = EntityKind(parts[5])
    enclave, namespace, node = (part.replace("%", "/") for part in parts[6:9])
    ids = int(parts[1]), parts[2], int(parts[3]), int(parts[4])
    if (problem := node_problem(node) or namespace_problem(namespace)) is not None:
        raise ValueError(f"{problem[0]}: found {namespace!r}, {node!r}")
    if kind is EntityKind.NODE:
        return Entity(*ids, kind, namespace, node, enclave)
    if len(parts) != 13:
        raise ValueError(f"expected 13 parts for an endpoint, found {key!r}")
    name, type_name, type_hash = (part.replace("%", "/") for part in parts[9:12])
    if (problem := full_topic_problem(name)) is not None:
        raise ValueError(f"{problem[0]}: found {name!r}")
    if not _TYPE_NAME.fullmatch(type_name):
        raise ValueError(f"expected a type like std_msgs::msg::dds_::String_, found {type_name!r}")
    return Entity(*ids, kind, namespace, node, enclave, name, type_name, type_hash, decode_qos(parts[12]))


def gid_of(token: str) -> bytes:
    """Return the 16-byte gid of an endpoint: XXH3-128 of its token, low half first, each little-endian."""
    return xxhash.xxh3_128(token.encode()).digest()[::-1]


def encode_attachment(sequence: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the 33 bytes that go with every sample, request and reply."""
    return _ATTACHMENT.pack(sequence, stamp_ns, _GID_BYTES, gid)


def decode_attachment(data: bytes) -> tuple[int, int, bytes]:
    """Return sequence, source time [ns] and gid; struct.error or ValueError when it is none."""
    sequence, stamp_ns, length, gid = _ATTACHMENT.unpack(data)
    if length != _GID_BYTES:
        raise ValueError(f"expected a gid of {_GID_BYTES} bytes, found {length}")
    return sequence, stamp_ns, gid
