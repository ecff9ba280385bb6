# SPDX-License-Identifier: Apache-2.0
"""Gauges that answer a command with their reading, as their manuals say.

sauter: FH-BA-e-2020 p. 13 (9600 8N1; "9"; 1021.15 is +21.15 N of pull, 0011.70 is -11.70 N). andilog: Centor Touch
V6.10 p. 22 ("F"; lines end in CR; "?" for a request it does not know). mt_sics: Mettler-Toledo 11780711 (command SI; "S
S 100.00 g", "S +" overload). radwag: PUE C/31 p. 58 (command SI; "SI ?       18.5 kg", "SI ^" overload). imada: a
client of the DST-44A, sktometometo/imada_forcegauge ("D<CR>" is answered "+12.34KTO<CR>": value, unit, tracking, good;
E for good is overload). tecsis: EZE30 p. 22 ("GN<CR>" is answered "N 00000<CR>", else "ERR<CR>"), Annex A ("N+01.100").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from softgrip_emulator.wire.device import Chunk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softgrip_emulator.rig.sensor import LoadCell

_GRAVITY: Final = 9.81


@dataclass(frozen=True)
class Protocol:
    """A gauge's words: speed, command, answer to a force [N], answer to anything else."""

    baud: int
    command: bytes
    answer: Callable[[float], bytes]
    unknown: bytes = b""


def _sauter(force: float) -> bytes:
    return b"%d%06.2f" % (force >= 0.0, min(abs(force), 999.99))


def _andilog(force: float) -> bytes:
    return b"!\r" if math.isinf(force) else b"%+.3f\r" % force


def _mt_sics(force: float) -> bytes:
    return b"S +\r\n" if math.isinf(force) else b"S D %10.2f g\r\n" % (1e3 * force / _GRAVITY)


def _radwag(force: float) -> bytes:
    if math.isinf(force):
        return b"SI ^\r\n"
    return b"SI ? %s%9.4f kg \r\n" % (b"-" if force < 0.0 else b" ", abs(force) / _GRAVITY)


def _imada(force: float) -> bytes:
    return b"+99.99NTE\r" if math.isinf(force) else b"%+06.2fNTO\r" % force


def _tecsis(force: float) -> bytes:
    return b"ERR\r" if math.isinf(force) else b"N%+07.3f\r" % force


PROTOCOLS: Final = {
    "sauter": Protocol(9600, b"9", _sauter),
    "andilog": Protocol(115200, b"F", _andilog, b"?\r"),
    "mt_sics": Protocol(9600, b"SI\r\n", _mt_sics, b"ES\r\n"),
    "radwag": Protocol(9600, b"SI\r\n", _radwag, b"ES\r\n"),
    "imada": Protocol(19200, b"D\r", _imada),
    "tecsis": Protocol(9600, b"GN\r", _tecsis, b"ERR\r"),
}


class EmulatedPolledGauge:
    """The gauge (a `WireDevice`).

    Args:
        cell: its load cell.
        protocol: of `PROTOCOLS`.
    """

    def __init__(self, cell: LoadCell, protocol: str) -> None:
        self._cell = cell
        self._protocol = PROTOCOLS[protocol]
        self._heard = b""
        #: Nothing comes any more. noisy: noise before answers. reply_cut: answers lose their second half.
        self.silent = False
        self.noisy = False
        self.reply_cut = False

    def opened(self, now_s: float) -> Sequence[Chunk]:  # noqa: ARG002  it says nothing
        """It does not notice."""
        self._heard = b""
        return []

    def due_s(self) -> float | None:
        """It speaks when spoken to."""
        return None

    def exchange(self, data: bytes, now_s: float, baud: int) -> Sequence[Chunk]:
        """A command to its answer."""
        protocol = self._protocol
        if self.silent or baud != protocol.baud:
            self._heard = b""
            return []
        self._heard += data
        if len(self._heard) < len(protocol.command):
            return []
        heard, self._heard = self._heard, b""
        answer = protocol.answer(self._cell.read(now_s)) if heard == protocol.command else protocol.unknown
        answer = answer[: len(answer) // 2] if self.reply_cut else answer
        return [Chunk(b"\xff#" + answer if self.noisy else answer, now_s)]
