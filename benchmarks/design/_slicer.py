# SPDX-License-Identifier: Apache-2.0
"""PrusaSlicer, a program of its own (apt-get install prusa-slicer): what it says of a 3MF file and makes of it."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

PROGRAM = "prusa-slicer"
#: what `--info` counts where a mesh had to be repaired (PrusaSlicer 2.5, src/libslic3r/Model.cpp: print_info)
REPAIRS = ("open_edges", "edges_fixed", "degenerate_facets", "facets_removed", "facets_reversed", "backwards_edges")


@dataclass(frozen=True)
class SlicedPart:
    """What PrusaSlicer made of a file.

    Attributes:
        is_manifold: the mesh as it was read.
        repairs: what had to be repaired, as PrusaSlicer counts it.
        grams: of filament. minutes: that the print is expected to take.
    """

    is_manifold: bool
    repairs: tuple[str, ...]
    grams: float
    minutes: float

    @property
    def is_sound(self) -> bool:
        """Whether it was sliced as it is, and holds material."""
        return self.is_manifold and not self.repairs and self.grams > 0.0


def has_slicer() -> bool:
    """Return whether PrusaSlicer is installed."""
    return shutil.which(PROGRAM) is not None


def slice_part(path: Path, folder: Path) -> SlicedPart:
    """Slice a 3MF file with the settings that it carries.

    Raises:
        subprocess.CalledProcessError: PrusaSlicer ended with an error.
    """
    said = _run("--info", str(path))
    gcode = folder / f"{path.stem}.gcode"
    _run("--export-gcode", "--output", str(gcode), str(path))
    text = gcode.read_text(encoding="utf-8", errors="replace")
    gcode.unlink()
    grams = re.search(r"^; total filament used \[g\] = ([0-9.]+)", text, re.MULTILINE)
    time = re.search(r"^; estimated printing time \(normal mode\) = (.*)$", text, re.MULTILINE)
    repairs = tuple(line.strip() for line in said.splitlines() if line.split("=")[0].strip() in REPAIRS)
    return SlicedPart(
        "manifold = yes" in said, repairs, float(grams[1]) if grams else 0.0, _minutes(time[1] if time else "")
    )


def _run(*arguments: str) -> str:
    return subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, check=True).stdout


def _minutes(text: str) -> float:
    """Return minutes of a time as PrusaSlicer writes it, such as 1d 2h 18m 3s."""
    unit = {"d": 1440.0, "h": 60.0, "m": 1.0, "s": 1.0 / 60.0}
    return sum(float(number) * unit[letter] for number, letter in re.findall(r"(\d+)([dhms])", text))
