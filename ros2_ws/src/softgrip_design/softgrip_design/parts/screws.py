# SPDX-License-Identifier: Apache-2.0
"""Lengths of screws, from what they go through. In mm."""

from __future__ import annotations

from softgrip_design.parts.forms import PartError, Screw

#: Nominal lengths of ISO 4762.
ISO_4762_MM = (6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0)
#: Thread that a screw forms in plastic, in its diameters: two to three (B. Lincoln, K. Gomes, J. Braden, Mechanical
#: Fastening of Plastics, chapter on fastening sites for self-threading screws, doi 10.1201/9780203747889-6).
THREAD_IN_PLASTIC = (2.0, 3.0)
#: Board below the bench's parts (assumed), and the height of an M4 nut (ISO 4032, at most).
BOARD_MM, M4_NUT_MM = 12.0, 3.2


def screw_length_mm(needed_mm: float) -> float:
    """Return the shortest length that is enough.

    Raises:
        PartError: there is none.
    """
    for length_mm in ISO_4762_MM:
        if length_mm >= needed_mm:
            return length_mm
    raise PartError(f"screw: expected at most {ISO_4762_MM[-1]:g} mm, found {needed_mm:g} mm")


def board_screw(thickness_mm: float, use: str) -> Screw:
    """Return the M4 screw that holds a part of a thickness on the bench's board, with its nut."""
    length_mm = screw_length_mm(thickness_mm + BOARD_MM + M4_NUT_MM)
    return Screw(f"M4 x {length_mm:g}, ISO 4762", use, nut="M4, ISO 4032")
