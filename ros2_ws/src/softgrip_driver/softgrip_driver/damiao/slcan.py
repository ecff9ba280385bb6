# SPDX-License-Identifier: Apache-2.0
"""CAN frames as lines of text, as serial CAN adapters speak them (LAWICEL, "CAN232 manual", v2.2a).

`tIIILDD..` is a frame with an ID of 11 bits in three hexadecimal digits, a length, and its bytes; `S8` sets 1 Mbit/s,
`O` opens the channel, `C` closes it. A carriage return ends a line and confirms one, a bell refuses it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

END = b"\r"
OPEN_AT_1_MBIT = b"C\rS8\rO\r"
CLOSE = b"C\r"
#: a line with eight bytes of data
FRAME_LINE = 22
_MAX_ID, _MAX_DATA = 0x7FF, 8


@dataclass(frozen=True)
class Frame:
    """A CAN frame with an ID of 11 bits."""

    can_id: int
    data: bytes


def encode(frames: Iterable[Frame]) -> bytes:
    """Return the lines that send some frames."""
    return b"".join(b"t%03X%d%s\r" % (f.can_id, len(f.data), f.data.hex().upper().encode()) for f in frames)


def decode(heard: bytes) -> tuple[list[Frame], int]:
    """Return the frames of whole lines in what was heard, and how many lines were damaged.

    Confirmations are passed over, and so is a line whose end has not come.
    """
    frames, damaged = [], 0
    for line in heard.split(END)[:-1]:
        text = line.strip(b"\a\0\n")
        if not text or text in (b"z", b"Z"):
            continue
        frame = _frame(text)
        if frame is None:
            damaged += 1
        else:
            frames.append(frame)
    return frames, damaged


def _frame(text: bytes) -> Frame | None:
    at = text.rfind(b"t")
    try:
        can_id, size = int(text[at + 1 : at + 4], 16), int(text[at + 4 : at + 5])
        data = bytes.fromhex(text[at + 5 : at + 5 + 2 * size].decode("ascii"))
    except ValueError:
        return None
    if at < 0 or can_id > _MAX_ID or size > _MAX_DATA or len(data) != size:
        return None
    return Frame(can_id, data)
