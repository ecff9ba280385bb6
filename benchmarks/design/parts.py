# SPDX-License-Identifier: Apache-2.0
"""Parts against their profile: STEP read back by gmsh, STL by manifold3d, 3MF sliced by PrusaSlicer; time.

Every finger of the shipped sets, those of Fig 4.1 in a palm with five slots, and random ones within the bounds of
section 4.2.3. gmsh may be installed anywhere: SOFTGRIP_GMSH_PYTHON names a Python that has it (default: this one, else
the system's; Debian: apt-get install python3-gmsh prusa-slicer). What is not installed is said, and left out.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import manifold3d
import meshio
import numpy as np
from _slicer import has_slicer, slice_part

from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_design.hand import FINGERS, blank, profile
from softgrip_design.parts.drives import FACES, min_spool_radius_mm
from softgrip_design.parts.files import write_part
from softgrip_design.parts.finger_form import finger_form
from softgrip_design.parts.forms import PartError
from softgrip_design.parts.kit import whole_kit
from softgrip_design.parts.palm import palm_forms, palm_seat
from softgrip_design.parts.solid import make_solid
from softgrip_model.profile import FingerDesign, Profile, load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim

HAND = shipped_hand()
FIVE = load_hand(Path(__file__).with_name("five_fingers.yaml"))
#: [deg] of the little finger's grooves: with 90 its middle link of 20 mm has no room between two of them
LITTLE_OPENING_DEG = 75.0
CABLE_RADIUS_MM = 0.125
READER = Path(__file__).with_name("_step_reader.py")
GOAL_UM = 10.0
#: Radius of the spools: every servo's horn has room below it.
SPOOL_MM = float(max(math.ceil(min_spool_radius_mm(face, CABLE_RADIUS_MM)) for face in FACES))
SEED = 1


def random_designs(count: int) -> Iterator[FingerDesign]:
    """Yield fingers within the bounds of section 4.2.3, with links, strips and openings drawn as well."""
    rng = np.random.default_rng(SEED)
    like = load_directory(shipped_directory())["power"].finger("index")
    while count > 0:
        design = dataclasses.replace(
            like,
            link_lengths_m=tuple(rng.uniform((0.032, 0.030, 0.022), (0.060, 0.045, 0.040)).round(6).tolist()),
            thicknesses_m=tuple(rng.uniform(0.0025, 0.005, 3).round(6).tolist()),
            routing_radii_m=tuple(rng.uniform(0.005, 0.013, 6).round(6).tolist()),
            joint_lengths_m=tuple(rng.uniform(0.006, 0.012, 3).round(6).tolist()),
            openings_rad=tuple(rng.uniform(math.radians(80.0), math.radians(90.0), 3).tolist()),
            width_m=round(float(rng.uniform(0.012, 0.016)), 6),
        )
        yield design
        count -= 1


def five_fingers() -> Profile:
    """Return the fingers of Fig 4.1, thickness and routing in the middle of their bounds."""
    made = profile("five_fingers", "Fig 4.1", "section 4.2", "braid-tpu", {name: blank(name) for name in FINGERS})
    opening = math.radians(LITTLE_OPENING_DEG)
    fingers = tuple(
        (name, dataclasses.replace(one, openings_rad=(opening,) * one.joints) if name == "little" else one)
        for name, one in made.fingers
    )
    return dataclasses.replace(made, fingers=fingers)


def gmsh_python() -> str:
    """Return a Python that has gmsh, empty where there is none."""
    for candidate in filter(None, (os.environ.get("SOFTGRIP_GMSH_PYTHON"), sys.executable, "/usr/bin/python3")):
        found = subprocess.run([candidate, "-c", "import gmsh"], capture_output=True, check=False)
        if found.returncode == 0:
            return candidate
    return ""


def plane_of(surface: dict[str, Any]) -> tuple[np.ndarray, float]:
    """Return unit normal (2,) in the finger's plane and distance from the origin of a plane along z."""
    normal = np.array(surface["normal"][:2])
    return normal, float(normal @ surface["point"][:2])


def flank(planes: Sequence[dict[str, Any]], x_mm: float, side: float, reach_mm: float) -> dict[str, Any]:
    """Return the largest oblique plane beside a joint: its groove's flank."""
    beside = [
        p for p in planes
        if abs(p["normal"][2]) < 1e-9 and min(abs(p["normal"][0]), abs(p["normal"][1])) > 0.05
        and p["box"][4] < 0.0 and 0.0 < side * (0.5 * (p["box"][0] + p["box"][3]) - x_mm) < reach_mm
    ]  # fmt: skip
    return max(beside, key=lambda p: p["area"])


def errors_um(design: FingerDesign, found: dict[str, Any]) -> list[float]:
    """Return the deviation of every h, l, r, opening (as micrometres at the body's depth), link, width and height."""
    planes, x_mm, apexes, errors = found["planes"], 0.0, [], []
    depth_mm = 1e3 * design.body_height_m
    for j in range(design.joints):
        reach = depth_mm * math.tan(0.5 * design.openings_rad[j]) + 1.0
        flanks = [flank(planes, x_mm, side, reach) for side in (-1.0, 1.0)]
        (n1, d1), (n2, d2) = (plane_of(one) for one in flanks)
        apex = np.linalg.solve(np.array([n1, n2]), np.array([d1, d2]))
        apexes.append(apex)
        opening = math.acos(min(1.0, abs(float(n1 @ n2))))
        opening = min((opening, math.pi - opening), key=lambda angle: abs(angle - design.openings_rad[j]))
        errors.append(1e3 * depth_mm * abs(opening - design.openings_rad[j]))
        level = [p for p in planes if abs(p["normal"][1]) > 1.0 - 1e-9 and p["box"][0] < x_mm < p["box"][3]]
        lower = min(level, key=lambda p: abs(p["point"][1]))
        upper = min((p for p in level if p["point"][1] > 0.3), key=lambda p: p["point"][1])
        errors.append(1e3 * abs(upper["point"][1] - lower["point"][1] - 1e3 * design.thicknesses_m[j]))
        # gmsh widens a bounding box by its tolerance, 1e-7
        errors.append(1e3 * abs(lower["box"][3] - lower["box"][0] - 1e3 * design.joint_lengths_m[j]))
        for side, (normal, distance) in enumerate(((n1, d1), (n2, d2))):
            expected = 1e3 * design.routing_radii_m[2 * j + side]
            radii = [
                float(np.linalg.norm(crossing(axis, normal, distance) - apex))
                for axis in found["cylinders"]
                if axis["radius"] < 1.0 and abs(axis["start"][2]) < 1e-6 and abs(axis["end"][2]) < 1e-6
                and beside(axis, x_mm, -1.0 if side == 0 else 1.0)
            ]  # fmt: skip
            errors.append(1e3 * min(abs(radius - expected) for radius in radii))
        x_mm += 1e3 * design.link_lengths_m[j]
    ends = [*(apex[0] for apex in apexes), found["box"][3]]
    links = [b - a for a, b in itertools.pairwise(ends)]
    errors += [1e3 * abs(link - 1e3 * length) for link, length in zip(links, design.link_lengths_m, strict=True)]
    errors.append(1e3 * abs(found["box"][5] - found["box"][2] - 1e3 * design.width_m))
    errors.append(1e3 * abs(-found["box"][1] - depth_mm))
    return errors


def beside(axis: dict[str, Any], x_mm: float, side: float) -> bool:
    """Return whether a bore lies on one side of a joint: its nearer end within a groove's reach."""
    ends = [side * (axis[key][0] - x_mm) for key in ("start", "end")]
    return min(ends) > 0.0 and min(ends) < 16.0


def crossing(axis: dict[str, Any], normal: np.ndarray, distance: float) -> np.ndarray:
    """Return where a bore's axis meets a plane, (2,)."""
    start, end = np.array(axis["start"][:2]), np.array(axis["end"][:2])
    share = (distance - normal @ start) / (normal @ (end - start))
    return np.asarray(start + share * (end - start))


def is_watertight(path: Path) -> bool:
    """Return whether an STL file closes a volume, by manifold3d."""
    stl = meshio.read(path)
    points, numbers = np.unique(stl.points.round(4), axis=0, return_inverse=True)
    triangles = numbers.reshape(-1)[stl.cells_dict["triangle"]].astype(np.uint64)
    distinct = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    body = manifold3d.Manifold(manifold3d.Mesh64(points.astype(float), triangles[distinct]))
    return bool(body.status() == manifold3d.Error.NoError and body.volume() > 0.0)


def main() -> int:
    """Measure and print the claims."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--random", type=int, default=10, help="random fingers (default: %(default)s)")
    count = options.parse_args().random
    python = gmsh_python()
    if not python:
        print("gmsh not found: pip install gmsh, or set SOFTGRIP_GMSH_PYTHON; no dimensions follow", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder), count, python)
    return 0


def dimension_errors_um(python: str, designs: dict[Path, FingerDesign]) -> list[float]:
    """Return the largest deviation of each STEP file from its design."""
    read = subprocess.run([python, str(READER), *map(str, designs)], capture_output=True, text=True, check=True)
    measured = json.loads(read.stdout.splitlines()[-1])
    return [max(errors_um(design, found)) for design, found in zip(designs.values(), measured, strict=True)]


@dataclasses.dataclass
class Made:
    """Fingers that were made: designs by their STEP files, seconds each, and how many were refused by name."""

    designs: dict[Path, FingerDesign] = dataclasses.field(default_factory=dict)
    seconds: list[float] = dataclasses.field(default_factory=list)
    refused: int = 0

    def make(self, design: FingerDesign, slot: str, hand: Hand, folder: Path) -> None:
        """Make a finger and write its files into a folder."""
        folder.mkdir()
        try:
            finger = finger_form(design, CABLE_RADIUS_MM, slot, palm_seat(hand, slot), "")
        except PartError:
            self.refused += 1
            return
        started = time.perf_counter()
        write_part(make_solid(finger.form, finger.channels), folder)
        self.seconds.append(time.perf_counter() - started)
        self.designs[folder / f"finger_{slot}.step"] = design


def make_fingers(folder: Path, count: int) -> Made:
    """Make the fingers of the published sets, of the five-finger hand, and random ones."""
    made, five = Made(), five_fingers()
    for name, one in load_directory(shipped_directory()).items():
        for slot in one.slots:
            made.make(one.finger(slot), slot, HAND, folder / f"{name}_{slot}")
    for slot in five.slots:
        made.make(five.finger(slot), slot, FIVE, folder / f"five_{slot}")
    for number, design in enumerate(random_designs(count)):
        made.make(design, "index", HAND, folder / f"random{number}")
    return made


def measure(folder: Path, count: int, python: str) -> None:
    """Make the fingers and a hand, measure their files, print the claims."""
    made = make_fingers(folder, count)
    fingers = f"{len(made.designs)} fingers (9 published, 5 of Fig 4.1, {count} random; {made.refused} refused by name)"
    if python:
        errors = dimension_errors_um(python, made.designs)
        claim("dimension error", max(errors), "um", better="lower", goal=GOAL_UM, runs=len(errors),
              note=f"largest of every h, l, r, opening, link, width, height; STEP read by gmsh; {fingers}; median "
              f"{statistics.median(errors):.2g} um")  # fmt: skip
    started = time.perf_counter()
    whole = whole_kit(load_directory(shipped_directory())["power"], HAND, SPOOL_MM)
    kit = (*whole.others, *(form for other in whole.instead for form in other.forms))
    paths = [path for form in kit for path in write_part(make_solid(form), folder)]
    hand_s = time.perf_counter() - started + 3.0 * statistics.median(made.seconds)
    (folder / "five").mkdir()
    paths += [path for form in palm_forms(FIVE) for path in write_part(make_solid(form), folder / "five")]
    stls = [*(path.with_suffix(".stl") for path in made.designs), *(path for path in paths if path.suffix == ".stl")]
    parts = f"{fingers}, the {len(kit)} other parts of a hand and its bench, palm and plate for five"
    leaks = sum(not is_watertight(path) for path in stls)
    claim("not watertight", float(leaks), "parts", better="lower", goal=0.0, runs=len(stls),
          note=f"STL read back, manifold3d; {parts}")  # fmt: skip
    each = f"a finger {statistics.median(made.seconds):.1f} s"
    claim("hand time", hand_s, "s", better="lower", goal=None, runs=1,
          note=f"all parts of hand and bench to STEP, STL, 3MF; {each}")  # fmt: skip
    slice_all(stls, folder, parts)


def slice_all(stls: Sequence[Path], folder: Path, parts: str) -> None:
    """Slice the 3MF files beside some STL files, print the claim."""
    if not has_slicer():
        print("PrusaSlicer not found: apt-get install prusa-slicer; nothing was sliced", file=sys.stderr)
        return
    found = {path: slice_part(path.with_suffix(".3mf"), folder) for path in stls}
    for path, one in found.items():
        if not one.is_sound:
            print(f"{path.name}: manifold {one.is_manifold}, {one.repairs}, {one.grams} g", file=sys.stderr)
    power = [path for path in stls if path.parent.name.startswith("power_") or path == folder / "palm.stl"]
    hours = sum(found[path].minutes for path in power) / 60.0
    unsound = sum(not one.is_sound for one in found.values())
    claim("not sliced as they are", float(unsound), "parts", better="lower", goal=0.0, runs=len(found),
          note=f"PrusaSlicer, settings of the 3MF, repairs nothing; {parts}; three power fingers and the palm print in "
          f"{hours:.1f} h")  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
