# SPDX-License-Identifier: Apache-2.0
"""Packets between a time server and the participants of its simulated time: one JSON object each (SOCK_SEQPACKET).

A *stepper* holds the time unless it waits: it requests a time, and the server grants it when that time has come or the
device that the stepper reads from has sent something. A *follower* reports its progress; the time runs ahead of it by
a bounded lag only. These are the time-advance request and grant of distributed simulations (IEEE 1516.1, chapter 8:
time management), reduced to what a gripper cell needs.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any

#: [byte] Longer packets are refused.
MAX_PACKET = 4096
#: What a follower follows: the time itself, or the frames of the camera.
FOLLOWED = ("clock", "frames")


@dataclass(frozen=True, slots=True)
class Join:
    """First packet of a participant.

    Attributes:
        name: of the node.
        follows: "" for a stepper, else one of `FOLLOWED`.
        lag_s: how far the time may run ahead of a follower [s].
    """

    name: str
    follows: str = ""
    lag_s: float = 0.0


@dataclass(frozen=True, slots=True)
class TimeRequest:
    """A stepper waits. It is answered once: by the time, or as its device sends, or after a `CancelRequest`.

    Attributes:
        number: of the request, counted by the stepper.
        until_s: time of the cell [s].
        reads: path of the terminal whose bytes end the wait, too; "" = none.
        written: bytes that the stepper has written to each terminal since it was opened.
    """

    number: int
    until_s: float
    reads: str = ""
    written: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CancelRequest:
    """A stepper stopped waiting and asks for the time; one that has been granted its request is answered already."""

    number: int


@dataclass(frozen=True, slots=True)
class Progress:
    """A follower has done what there was to do up to a time of the cell [s]."""

    time_s: float


@dataclass(frozen=True, slots=True)
class TimeGrant:
    """Answer of the server to a join (number 0), a request or a cancelled one.

    Attributes:
        number: of the request.
        now_s: time of the cell [s].
        epoch_s: the time of the cell's zero, since the epoch [s].
    """

    number: int
    now_s: float
    epoch_s: float


Packet = Join | TimeRequest | CancelRequest | Progress | TimeGrant
_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (Join, TimeRequest, CancelRequest, Progress, TimeGrant)}
_FIELDS = {name: kind.__annotations__ for name, kind in _KINDS.items()}
_to_json = json.JSONEncoder(separators=(",", ":")).encode


def encode(packet: Packet) -> bytes:
    """Return a packet's bytes."""
    name = type(packet).__name__
    return _to_json({name: {field: getattr(packet, field) for field in _FIELDS[name]}}).encode()


def decode(data: bytes) -> Packet:
    """Return the packet that bytes hold.

    Raises:
        ValueError: they are no packet; the message gives what was expected and found.
    """
    try:
        ((name, values),) = json.loads(data).items()
        kind = _KINDS[name]
        fields = {field: _checked(values[field], annotation) for field, annotation in _FIELDS[name].items()}
    except (ValueError, OverflowError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f"lock-step: expected a packet of {', '.join(_KINDS)} with its fields, found {data[:80]!r}"
        ) from error
    packet: Packet = kind(**fields)
    return packet


def _checked(value: Any, annotation: str) -> Any:
    if annotation == "str" and isinstance(value, str):
        return value
    if annotation == "int" and type(value) is int and abs(value) < 2**63:
        return value
    if annotation == "float" and type(value) in {int, float} and math.isfinite(value):
        return float(value)
    if annotation == "dict[str, int]" and isinstance(value, dict):
        return {key: _checked(count, "int") for key, count in value.items()}
    raise ValueError(value)
