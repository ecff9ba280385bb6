# SPDX-License-Identifier: Apache-2.0
"""What goes to browsers as binary: pictures with what is drawn over them, and the tensions."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from softgrip_panel.model.facts import TensionView

#: First byte of a message.
PICTURE, TENSIONS = 1, 2


@dataclass(frozen=True)
class PanelPicture:
    """A camera frame.

    Attributes:
        number: grows with each.
        jpeg: the image.
        size: (width, height) [px]; (0, 0) = as the image says.
        lines: name -> pixels (u, v) of a chain of joints, base to tip.
    """

    number: int
    jpeg: bytes
    size: tuple[int, int] = (0, 0)
    lines: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


def pack_picture(picture: PanelPicture) -> bytes:
    """Return a picture as one message: kind, length of the head (big-endian uint32), head (JSON), image."""
    head = _json(
        {
            "number": picture.number,
            "size": picture.size,
            "lines": {
                name: [[round(u, 1), round(v, 1)] for u, v in points if math.isfinite(u) and math.isfinite(v)]
                for name, points in picture.lines.items()
            },
        }
    )
    return struct.pack(">BI", PICTURE, len(head)) + head + picture.jpeg


def pack_tensions(tensions: Sequence[TensionView], stale: bool) -> bytes:
    """Return tensions as one message: kind, JSON."""
    rows = [
        [one.name, _number(one.tension_n), _number(one.free_tension_n), _number(one.pulled_length_m * 1e3)]
        for one in tensions
    ]
    return bytes([TENSIONS]) + _json({"stale": stale, "rows": rows})


def _number(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None


def _json(document: object) -> bytes:
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
