# SPDX-License-Identifier: Apache-2.0
"""A serial CAN adapter with motors behind it: SLCAN lines in, SLCAN lines out (LAWICEL, "CAN232 manual", v2.2a).

A frame that is sent is confirmed with `z`; frames of the bus come as `tIIILDD..`; what it does not know it refuses with
a bell.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softgrip_emulator.damiao.motor import EmulatedDamiaoMotor

_END, _BELL = b"\r", b"\a"
_CAN_BIT_RATE: Final = 1_000_000
_FRAME_BITS: Final = 131
"""Eight bytes with an ID of 11 bits, with as many stuffed bits as there can be (Bosch, CAN 2.0)."""
_MAX_LINE: Final = 64
_BIT_RATE_CODES: Final = {b"S4": 0, b"S5": 2, b"S6": 3, b"S8": 4}
"""Of the adapter, as the motor's register 35 counts them: 125 k, 250 k, 500 k, 1 M."""


class SlcanAdapter:
    """The device end of a serial line (a `WireDevice`).

    Args:
        servos: motors on the CAN bus.
        lock: held while motors are read or changed; the plant holds the same one while it steps them.
        before: called with the time [s] of each frame, so that the plant can catch up before it is answered.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedDamiaoMotor],
        *,
        lock: threading.RLock | None = None,
        before: Callable[[float], None] | None = None,
    ) -> None:
        self.servos = list(servos)
        self._lock = lock or threading.RLock()
        self._before = before
        self._line = b""
        self._is_open = False
        self._bit_rate_code = 4
        self._busy_until_s = 0.0
        self.packets_seen = 0

    def opened(self, now_s: float) -> Sequence[Chunk]:
        """The adapter does not care who opens its port; its channel stays as it was."""
        self._line, self._busy_until_s = b"", now_s
        return []

    def due_s(self) -> float | None:
        """Motors speak only when spoken to."""
        return None

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """Lines from the host to confirmations and frames."""
        del baud  # an adapter on USB takes any
        chunks: list[Chunk] = []
        *lines, rest = (self._line + data).split(_END)
        self._line = rest[-_MAX_LINE:]
        for line in lines:
            chunks += self._obey(line, now_s)
        return chunks

    def _obey(self, line: bytes, now_s: float) -> list[Chunk]:
        if line in _BIT_RATE_CODES and not self._is_open:
            self._bit_rate_code = _BIT_RATE_CODES[line]
        elif line == b"O" and not self._is_open:
            self._is_open = True
        elif line == b"C" and self._is_open:
            self._is_open = False
        elif line[:1] == b"t" and self._is_open:
            return self._send(line, now_s)
        elif line not in (b"", b"V", b"N"):
            return [Chunk(_BELL, now_s)]
        return [Chunk(_END, now_s)]

    def _send(self, line: bytes, now_s: float) -> list[Chunk]:
        try:
            can_id, size = int(line[1:4], 16), int(line[4:5])
            data = bytes.fromhex(line[5:].decode("ascii"))
        except ValueError:
            return [Chunk(_BELL, now_s)]
        if len(data) != size or size != 8:
            return [Chunk(_BELL, now_s)]
        self.packets_seen += 1
        frame_s = _FRAME_BITS / _CAN_BIT_RATE
        self._busy_until_s = max(self._busy_until_s, now_s) + frame_s
        if self._before is not None:
            self._before(now_s)
        chunks = [Chunk(b"z" + _END, now_s)]
        with self._lock:
            for motor in self.servos:
                answer = motor.receive(can_id, data, now_s) if motor.listens(now_s, self._bit_rate_code) else None
                if answer is not None:
                    self._busy_until_s += frame_s
                    text = b"t%03X%d%s" % (answer[0], len(answer[1]), answer[1].hex().upper().encode())
                    chunks.append(Chunk(text + _END, self._busy_until_s))
        return chunks
