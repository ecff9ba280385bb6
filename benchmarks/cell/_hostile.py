# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs to a ROS graph over Zenoh: what a stranger who knows only the interface texts can send.

The encoder is a second one, on purpose: it writes what the package under test would refuse to write.
"""

from __future__ import annotations

import random
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import zenoh

from embedded_ros import wire
from embedded_ros.interface_text import FieldType
from embedded_ros.network import router_port
from embedded_ros.registry import registry
from embedded_ros.wire import Entity, EntityKind

HEADER = b"\x00\x01\x00\x00"
CODES = {
    "bool": "B", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
FLOATS = (0.0, -0.0, 1.0, -1.0, 0.005, 1e-300, 1e30, -1e30, float("nan"), float("inf"), float("-inf"))
DOUBLES = (*FLOATS, 1e308, -1e308, 5e-324)
WORDS = (
    "", "index", "middle", "thumb", "power", "pinch", "hook", "egg", "apple", "use_sim_time", "mm", "bgr8", "mono8",
    "jpeg", "base_link", "../x", "a/b", "x\0y", "NaN", "'; --", "é\u202e", "x" * 300,
)  # fmt: skip
LENGTHS = (0, 0, 1, 1, 1, 2, 3, 5, 17)
LONG, LONG_WORD = 3000, 100_000
LIES = (0xFFFFFFFF, 0x7FFFFFFF, 1_000_000)
#: A valid request to these is an order that stops tendon/state or ends a node as it should; malformed ones are sent.
ORDERS = ("/change_state",)
MAX_OPEN = 256  # requests
MAX_TOKENS = 200
#: Zenoh 1.10 keeps each key that was ever announced, some kilobytes in each process, as long as the router's connection
#: lasts (zenoh issue 1518): what is measured here is the nodes' own memory.
DIFFERENT_TOKENS = 300
#: Results of goals that go on are not waited for.
REQUEST_TIMEOUT_S = 1.0
DISCOVERY_S = 3.0


class Encoder:
    """Writes CDR of random values of a type.

    Args:
        chance: the source of all choices.
    """

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._data = bytearray()

    def message(self, type_name: str) -> bytes:
        """Return the CDR of a message of ``pkg/kind/Name``."""
        self._data = bytearray()
        self._fields(registry().message(type_name), 0)
        return HEADER + bytes(self._data)

    def _fields(self, kind: Any, depth: int) -> None:
        fields = kind.DEFINITION.text.fields
        if not fields:
            self._number("uint8", 0)
        for field in fields:
            self._field(field.type, kind, depth)

    def _field(self, kind: FieldType, owner: Any, depth: int) -> None:
        if not kind.array:
            self._element(kind, owner, depth)
            return
        count = kind.size if kind.array == "fixed" else self._length(kind, depth)
        for _ in range(count):
            self._element(kind.element, owner, depth + 1)

    def _length(self, kind: FieldType, depth: int) -> int:
        chance = self._chance
        count = LONG if depth == 0 and chance.random() < 0.01 else chance.choice(LENGTHS)
        if kind.array == "bounded" and chance.random() < 0.9:
            count = min(count, kind.size)
        self._number("uint32", chance.choice(LIES) if chance.random() < 0.003 else count)
        return count

    def _element(self, kind: FieldType, owner: Any, depth: int) -> None:
        if kind.text:
            self._text(kind)
        elif kind.primitive:
            self._number(kind.base, self._value(kind.base))
        else:
            self._fields(owner.DEFINITION.nested(kind.base), depth + 1)

    def _text(self, kind: FieldType) -> None:
        word = "x" * LONG_WORD if self._chance.random() < 0.001 else self._chance.choice(WORDS)
        if kind.base == "wstring":
            self._number("uint32", len(word))
            for char in word:
                self._number("uint32", ord(char))
            return
        data = word.encode() + b"\0"
        self._number("uint32", len(data))
        self._data += data

    def _value(self, base: str) -> float:
        chance = self._chance
        if base in {"float32", "float64"}:
            if chance.random() < 0.3:
                return chance.uniform(-0.05, 0.05)
            return chance.choice(FLOATS if base == "float32" else DOUBLES)
        bits = 8 * struct.calcsize("<" + CODES[base])
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if base.startswith("int") else (0, (1 << bits) - 1)
        return chance.choice((0, 1, 1, 2, 3, low, high, chance.randint(low, high)))

    def _number(self, base: str, value: float) -> None:
        code = CODES[base]
        self._data += bytes(-len(self._data) % struct.calcsize("<" + code)) + struct.pack("<" + code, value)


@dataclass(frozen=True)
class Target:
    """Something that the nodes serve or listen to."""

    key: str
    name: str
    type_name: str
    is_service: bool


@dataclass(frozen=True)
class Input:
    """One hostile input; ``target`` is None for a liveliness token, whose key is the payload."""

    target: Target | None
    payload: bytes
    attachment: bytes | None


class Generator:
    """Inputs of all kinds, the same ones for the same seed and targets.

    Args:
        targets: what there is to be sent to.
        seed: of the choices.
        domain: of the tokens.
    """

    def __init__(self, targets: list[Target], seed: int, domain: int) -> None:
        self._targets = sorted(targets, key=lambda target: target.key)
        self._chance = random.Random(seed)
        self._encoder = Encoder(self._chance)
        self._domain = domain
        self._sequence = 0
        self._tokens = [self._token().encode() for _ in range(DIFFERENT_TOKENS)]

    def next(self) -> Input:
        """Return the next input."""
        chance = self._chance
        self._sequence += 1
        if chance.random() < 0.05:
            return Input(None, chance.choice(self._tokens), None)
        target = chance.choice(self._targets)
        kind = chance.random()
        if kind < 0.04:
            payload = chance.randbytes(chance.randint(0, 200))
        else:
            payload = self._encoder.message(target.type_name)
            if kind < 0.25 or target.name.endswith(ORDERS):
                payload = self._mutated(payload)
        return Input(target, payload, self._attachment())

    def _mutated(self, payload: bytes) -> bytes:
        chance = self._chance
        data = bytearray(payload)
        for _ in range(chance.randint(1, 4)):
            how = chance.randrange(4)
            at = chance.randrange(len(data)) if data else 0
            if how == 0:
                del data[at:]
            elif how == 1:
                data += chance.randbytes(chance.randint(1, 50))
            elif how == 2 and data:
                data[at] = chance.randrange(256)
            else:
                data[at : at + 4] = b"\xff\xff\xff\xff"
        return bytes(data[:-1]) if bytes(data) == payload else bytes(data)

    def _attachment(self) -> bytes | None:
        chance = self._chance
        kind = chance.random()
        if kind < 0.01:
            return None
        if kind < 0.02:
            return chance.randbytes(chance.choice((0, 1, 32, 33, 34, 1000)))
        stamp = time.time_ns() if kind < 0.9 else chance.choice((0, -1, -(1 << 63), (1 << 63) - 1))
        gid = chance.randrange(1 << 12).to_bytes(16, "little")
        sequence = self._sequence if kind < 0.97 else chance.choice((0, -1, -(1 << 63), (1 << 63) - 1))
        return wire.encode_attachment(sequence, stamp, gid)

    def _token(self) -> str:
        chance = self._chance
        target = chance.choice(self._targets)
        kind = chance.choice(("NN", "MP", "MS", "SS", "SC", "XX"))
        node = chance.choice(("stranger", "bad-name!", "n" * 300, "tendon_driver", "é", "7up"))
        space = chance.choice(("%", "%a", "%a%", "a b", "%%"))
        head = f"@ros2_lv/{self._domain}/{chance.randrange(1 << 32):x}/{chance.randrange(9)}/{chance.randrange(99)}"
        parts = [head, kind, "%", space, node]
        if kind != "NN":
            _, name, type_name, type_hash = target.key.split("/", 1)[0], target.name, *target.key.rsplit("/", 2)[1:]
            qos = chance.choice(
                (
                    "::,10:,:,:,,",
                    "2::,10:,:,:,,",
                    "9:9:9,9:,:,:9,,",
                    "::,-1:,:,:,,",
                    "::,:",
                    "x",
                    "1:1:1,1:1,1:1,1:1,1,1",
                )
            )
            parts += [chance.choice((name.replace("/", "%"), "no topic!", "%" + "t" * 400)), type_name, type_hash, qos]
        return "/".join(parts)


def open_client(domain: int) -> zenoh.Session:
    """Return a bare session at a domain's router."""
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["tcp/localhost:{router_port(domain)}"]')
    # a busy computer's router may take its time; one that stands still is an error
    configuration.insert_json5("connect/timeout_ms", "30000")
    configuration.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(configuration)


class Stranger:
    """A bare Zenoh client.

    Args:
        domain: whose router it connects to.
    """

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.session = open_client(domain)
        self._open = threading.Semaphore(MAX_OPEN)
        self._tokens: deque[Any] = deque()
        self.answered = 0
        self.refused = 0

    def entities(self) -> list[Entity]:
        """Return who is there."""
        replies = self.session.liveliness().get(wire.liveliness_prefix(self.domain), timeout=DISCOVERY_S)
        return [wire.decode_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]

    def targets(self) -> list[Target]:
        """Return each topic that somebody listens to, and each service, those of actions and parameters included."""
        found = set()
        for entity in self.entities():
            if entity.kind not in {EntityKind.SUBSCRIPTION, EntityKind.SERVICE}:
                continue
            is_service = entity.kind is EntityKind.SERVICE
            key = wire.data_key(self.domain, entity.name, entity.type, entity.hash)
            found.add(Target(key, entity.name, entity.ros_type + "_Request" * is_service, is_service))
        return sorted(found, key=lambda target: target.key)

    def send(self, item: Input) -> None:
        """Send an input; some requests wait for an answer at a time, and some tokens are up."""
        if item.target is None:
            self._announce(item.payload.decode())
        elif item.target.is_service:
            self._ask(item)
        else:
            block = zenoh.CongestionControl.BLOCK
            self.session.put(item.target.key, item.payload, attachment=item.attachment, congestion_control=block)

    def _announce(self, key: str) -> None:
        try:
            self._tokens.append(self.session.liveliness().declare_token(key))
        except zenoh.ZError:
            return  # not even Zenoh takes it for a key
        if len(self._tokens) > MAX_TOKENS:
            self._tokens.popleft().undeclare()

    def _ask(self, item: Input) -> None:
        assert item.target is not None
        self._open.acquire()
        handler = zenoh.handlers.Callback(self._count, self._open.release, indirect=False)
        self.session.get(
            item.target.key, handler, payload=item.payload, attachment=item.attachment, timeout=REQUEST_TIMEOUT_S
        )

    def _count(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self.answered += 1
        else:
            self.refused += 1

    def come_back(self) -> None:
        """Leave in the middle of everything and come back as somebody new."""
        self._tokens.clear()
        self.session.close()
        self.session = open_client(self.domain)

    def close(self) -> None:
        """Leave."""
        self.session.close()
