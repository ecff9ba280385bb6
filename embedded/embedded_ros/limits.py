# SPDX-License-Identifier: Apache-2.0
"""How much one message from outside may cost: bytes before anything is decoded, parts before anything is made."""

from __future__ import annotations

import functools
import os

from embedded_ros.errors import WireError

MAX_BYTES_VARIABLE = "EMBEDDED_MAX_BYTES"
MAX_PARTS_VARIABLE = "EMBEDDED_MAX_PARTS"

_MIB = 1 << 20
_IMAGE_BYTES = 64 * _MIB  # 21 Mpx of rgb8
#: [B] by type. A frame is the largest thing a cell sends; a request is typed by hand or made from a table.
_MAX_BYTES = {
    "sensor_msgs/msg/Image": _IMAGE_BYTES,
    "sensor_msgs/msg/PointCloud2": _IMAGE_BYTES,
    "message": 16 * _MIB,
    "request": _MIB,
}
#: Objects, texts and lists in one message. Python makes a million of them a second: this is a tenth of a second, and
#: five times the triangles of three fingers' shapes.
_MAX_PARTS = 100_000
#: A frame and some room for its header; more does not even get through Zenoh.
LINK_BYTES = _IMAGE_BYTES + _MIB


def max_bytes(type_name: str, kind: str) -> int:
    """Return how long [B] a message may be.

    Args:
        type_name: ``pkg/kind/Name``.
        kind: "message" (also responses) or "request" (also goals), for types that have no limit of their own.

    Raises:
        WireError: EMBEDDED_MAX_BYTES is no list of ``type=bytes`` (types, ``message`` or ``request``).
    """
    limits = {**_MAX_BYTES, **_configured(os.environ.get(MAX_BYTES_VARIABLE, ""))}
    return limits.get(type_name, limits[kind])


def max_parts() -> int:
    """Return how many objects, texts and lists one message may have; WireError when EMBEDDED_MAX_PARTS is no number."""
    text = os.environ.get(MAX_PARTS_VARIABLE) or str(_MAX_PARTS)
    if not text.isdigit():
        raise WireError(f"{MAX_PARTS_VARIABLE}: expected a number, found {text!r}")
    return int(text)


@functools.cache
def _configured(text: str) -> dict[str, int]:
    found = {}
    for item in filter(None, (part.strip() for part in text.split(";"))):
        name, separator, value = item.partition("=")
        if not separator or not value.isdigit():
            raise WireError(f"{MAX_BYTES_VARIABLE}: expected type=bytes;type=bytes, found {item!r}")
        found[name.strip()] = int(value)
    return found
