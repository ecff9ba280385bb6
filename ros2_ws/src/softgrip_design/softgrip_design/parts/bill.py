# SPDX-License-Identifier: Apache-2.0
"""What a hand takes: printed parts in grams and metres of filament, cable, sheath and screws."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from softgrip_design.parts.drives import BEAD_MM, FACES, ServoFace
from softgrip_design.parts.forms import Form, Screw
from softgrip_design.parts.kit import Kit, OtherDrives
from softgrip_design.parts.palm import pin_screw
from softgrip_design.parts.printing import MATERIALS
from softgrip_design.parts.screws import BOARD_MM
from softgrip_design.parts.solid import Solid

#: Assumed: sheath from palm to servos, and the turns that stay on a spool.
SHEATH_M, TURNS = 0.5, 3.0
#: Waste of a knot or a crimp.
ENDS_M = 0.05


@dataclass(frozen=True)
class PrintedRow:
    """A printed part.

    Attributes:
        title: for people.
        count: of them.
        material: for people.
        volume_mm3, mass_g, filament_m: of one, printed full.
    """

    title: str
    count: int
    material: str
    volume_mm3: float
    mass_g: float
    filament_m: float


@dataclass(frozen=True)
class BoughtRow:
    """Something to buy.

    Attributes:
        title: for people.
        amount: with its unit.
        use: what it is for.
    """

    title: str
    amount: str
    use: str


def printed_rows(solids: Sequence[Solid]) -> list[PrintedRow]:
    """Return the printed parts; masses are those of parts printed full, so PLA parts weigh less with their infill."""
    rows = []
    for solid in solids:
        material = MATERIALS[solid.form.material]
        volume = solid.volume_mm3
        rows.append(
            PrintedRow(solid.form.title, solid.form.count, material.title, volume, material.mass_g(volume),
                       material.filament_m(volume))
        )  # fmt: skip
    return rows


def cable_m(kit: Kit, spool_radius_mm: float) -> float:
    """Return the length of cable for all fingers: inside them, through the sheaths, on the spools [m]."""
    outside = SHEATH_M + ENDS_M + TURNS * 2.0 * math.pi * 1e-3 * spool_radius_mm
    return sum(1e-3 * finger.cable_mm + outside for finger in kit.fingers.values())


def bought_rows(kit: Kit, spool_radius_mm: float, face: ServoFace = FACES[0], model: str = "") -> list[BoughtRow]:
    """Return what is bought for the fingers of a kit, and for the palm and the drives where they are in it.

    Args:
        kit: what is printed.
        spool_radius_mm: to the middle of the cable.
        face: of the servos.
        model: of the servos; empty: any with this front.
    """
    fingers = len(kit.fingers)
    rows = [
        BoughtRow(kit.profile.cable.name, f"{cable_m(kit, spool_radius_mm):.2f} m", "cables"),
        BoughtRow("PTFE tube 2 x 3 mm", f"{fingers * SHEATH_M:.2f} m", "sheaths, foot to servo plate"),
        BoughtRow(
            f"crimp bead {BEAD_MM:g} mm", f"{2 * fingers}", "both ends of a cable: in the tip, behind the spool's rim"
        ),
        *(BoughtRow(f"screw {pin_screw(kit.hand, name).name}", "1", f"cross pin of {name}") for name in kit.fingers),
        BoughtRow(
            "dot 5 mm, green", f"{sum(len(f.grooves) + 2 for f in kit.fingers.values())}", "markers: base, joints, tip"
        ),
    ]
    if kit.others:
        rows += [
            BoughtRow(f"servo {model or ' or '.join(face.models)}", f"{fingers}", "one a finger"),
            *screw_rows(kit.others),
        ]
    return rows


def screw_rows(forms: Sequence[Form]) -> list[BoughtRow]:
    """Return the screws that the holes of parts take, and the nuts that go with them."""
    needed: Counter[Screw] = Counter()
    exchanged: Counter[Screw] = Counter()
    for form in forms:
        taken = Counter(bore.screw for bore in form.bores if bore.screw) + Counter(form.screws)
        if form.is_exchanged:
            exchanged |= taken
        else:
            needed.update({screw: number * form.count for screw, number in taken.items()})
    needed += exchanged
    nuts: Counter[str] = Counter()
    for screw, number in needed.items():
        nuts[screw.nut] += number
    return [
        *(BoughtRow(f"screw {screw.name}", f"{number}", screw.use) for screw, number in needed.items()),
        *(BoughtRow(f"nut {nut}", f"{number}", f"board of {BOARD_MM:g} mm") for nut, number in nuts.items() if nut),
    ]


def instead_rows(instead: Sequence[OtherDrives], solids: Mapping[str, Solid]) -> list[tuple[str, str, str, str]]:
    """Return what other servos would take: models; g and m of plate and spools; screws, or why there are none.

    Args:
        instead: of the kit.
        solids: by name of their form.
    """
    rows = []
    for one in instead:
        printed = printed_rows([solids[form.name] for form in one.forms])
        mass_g = sum(row.count * row.mass_g for row in printed)
        filament_m = sum(row.count * row.filament_m for row in printed)
        servos = max((row.count for row in printed), default=0)
        screws = "; ".join(f"{number * servos} {name}" for name, number in one.face.screws)
        rows.append(
            (" or ".join(one.face.models), f"{mass_g:.1f}", f"{filament_m:.2f}", screws)
            if one.forms
            else (" or ".join(one.face.models), "", "", one.problem)
        )
    return rows


def bill_text(
    title: str,
    printed: Sequence[PrintedRow],
    bought: Sequence[BoughtRow],
    instead: Sequence[Sequence[str]] = (),
) -> str:
    """Return the bill of material as Markdown."""
    printed_lines = [
        f"| {row.title} | {row.count} | {row.material} | {1e-3 * row.volume_mm3:.1f} | {row.mass_g:.1f} "
        f"| {row.filament_m:.2f} |"
        for row in printed
    ]
    count, mass_g = sum(row.count for row in printed), sum(row.count * row.mass_g for row in printed)
    filament_m = sum(row.count * row.filament_m for row in printed)
    lines = [
        f"# {title}: bill of material",
        "",
        "Masses and lengths of filament are those of one full part; PLA printed with infill takes less.",
        "",
        "| printed | count | material | cm3 | g | m of 1.75 mm |",
        "| --- | ---: | --- | ---: | ---: | ---: |",
        *printed_lines,
        f"| all | {count} | | | {mass_g:.1f} | {filament_m:.2f} |",
        "",
        "| bought | amount | for |",
        "| --- | ---: | --- |",
        *(f"| {row.title} | {row.amount} | {row.use} |" for row in bought),
        "",
    ]
    if instead:
        lines += [
            "Other servos instead; plate and spools, in the folder other_servos, are not in the sums above:",
            "",
            "| servo | g | m of 1.75 mm | screws |",
            "| --- | ---: | ---: | --- |",
            *(f"| {' | '.join(row)} |" for row in instead),
            "",
        ]
    return "\n".join(lines)
