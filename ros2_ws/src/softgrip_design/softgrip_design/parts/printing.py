# SPDX-License-Identifier: Apache-2.0
"""What parts are printed of and how; the settings go into the 3MF, where PrusaSlicer reads them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

#: Thickness of a layer: thesis sections 3.2.1 and 5.3. Nozzle: that of the thesis' Prusa MK3S, maker's data.
LAYER_MM, NOZZLE_MM = 0.2, 0.4
#: Between parts that fit into each other, each side; usual for filament printers.
CLEARANCE_MM = 0.2
FILAMENT_DIAMETER_MM = 1.75


@dataclass(frozen=True)
class Filament:
    """A filament.

    Attributes:
        title: for people.
        density_g_cm3: maker's data.
        settings: PrusaSlicer's own keys.
    """

    title: str
    density_g_cm3: float
    settings: Mapping[str, str]

    def mass_g(self, volume_mm3: float) -> float:
        """Return the mass of a volume printed full [g]."""
        return 1e-3 * self.density_g_cm3 * volume_mm3

    def filament_m(self, volume_mm3: float) -> float:
        """Return the length of filament that a volume takes when it is printed full [m]."""
        return 1e-3 * volume_mm3 / (0.25 * math.pi * FILAMENT_DIAMETER_MM**2)


_ALL = {
    "layer_height": f"{LAYER_MM}",
    "first_layer_height": f"{LAYER_MM}",
    "nozzle_diameter": f"{NOZZLE_MM}",
    "filament_diameter": f"{FILAMENT_DIAMETER_MM}",
    "bed_shape": "0x0,250x0,250x210,0x210",  # Prusa MK3S, maker's data
    "max_print_height": "210",
    "gcode_flavor": "marlin",
}
# Prusament PLA, maker's data sheet: 1.24 g/cm3, 215 C. Walls and infill: usual for parts that carry screws.
_PLA = {
    **_ALL,
    "filament_type": "PLA",
    "filament_density": "1.24",
    "perimeters": "4",
    "fill_density": "30%",
    "fill_pattern": "gyroid",
    "temperature": "210",
    "first_layer_temperature": "215",
    "bed_temperature": "60",
    "first_layer_bed_temperature": "60",
    "support_material": "0",
    "brim_width": "0",
}
MATERIALS = {
    # Density, thesis section 4.3 and NinjaTek's data sheet (1.19 g/cm3). Infill: section 3.2.2 (100 %, lines) gives the
    # modulus that the profiles use. 240 C, 40 mm/s, 105 % flow, 3 walls: section 5.3, NinjaFlex.
    "tpu": Filament(
        "NinjaFlex TPU 85A",
        1.19,
        {
            **_ALL,
            "filament_type": "FLEX",
            "filament_density": "1.19",
            "perimeters": "3",
            "fill_density": "100%",
            "fill_pattern": "rectilinear",
            "perimeter_speed": "40",
            "infill_speed": "40",
            "solid_infill_speed": "40",
            "temperature": "240",
            "first_layer_temperature": "240",
            "bed_temperature": "40",
            "first_layer_bed_temperature": "40",
            "extrusion_multiplier": "1.05",
            # the foot is narrower than the body and lies above the bed
            "support_material": "1",
            "support_material_buildplate_only": "1",
            "brim_width": "0",
        },
    ),
    "pla": Filament("PLA", 1.24, _PLA),
    # the test cube carries nothing
    "pla_light": Filament("PLA", 1.24, _PLA | {"perimeters": "2"}),
}  # fmt: skip
