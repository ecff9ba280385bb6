# SPDX-License-Identifier: Apache-2.0
"""Parts of the bench: guide blocks of the rig, camera stand, foot of the calibration target, test cube. In mm."""

from __future__ import annotations

import math

from softgrip_design.parts.forms import Bore, Form, PartPose, Prism, Screw, corners, rectangle
from softgrip_design.parts.lettering import engraving
from softgrip_design.parts.printing import LAYER_MM
from softgrip_design.parts.screws import board_screw

#: Thesis section 3.2.1: wrap angles of the 45 tests, radius of the contact surface (3 mm).
WRAP_ANGLES_DEG = tuple(range(10, 91, 10))
SURFACE_RADIUS_MM = 3.0
#: Guide block: where the cable turns, straight piece before and after, width, and M4 holes.
LEAD_MM, BLOCK_MM, BLOCK_WIDTH_MM = 12.0, 40.0, 12.0
BLOCK_HOLES_MM, M4_MM = ((10.0, 8.0), (10.0, 24.0)), 2.25
EDGE_MM = 1.0
#: Camera stand: foot, mast, and the hole of the camera's 1/4 inch screw (6.35 mm).
STAND_FOOT_MM, STAND_MAST_MM, STAND_THICK_MM = (90.0, 70.0), 140.0, 8.0
CAMERA_SCREW_MM, CAMERA_SLOT_MM = 3.3, 60.0
#: Half an inch: 8 mm of mast and 4.7 mm of thread, as deep as ISO 1222 lets a tripod's screw go into a camera.
CAMERA_SCREW = "1/4-20 UNC x 1/2 in"
#: Target holder: a slit for a board of 3 mm with the print on it, and the slit's depth.
BOARD_MM, HOLDER_MM, SLIT_DEPTH_MM = 3.2, (80.0, 40.0, 18.0), 12.0

#: Test cube of the first grasp: its edge, the rounding of its upright edges, and its mass with the settings of
#: "pla_light" (PrusaSlicer 2.5.0 expects 41.2 g of filament).
CUBE_MM, CUBE_ROUNDING_MM, CUBE_G = 45.0, 2.0, 40.0


def guide_block(angle_deg: int, material: str) -> Form:
    """Return a block over which a cable turns by an angle; printed on its side, as the fingers are (section 3.2.1).

    Args:
        angle_deg: between the cable before and after the block.
        material: of the surface, a key of `printing.MATERIALS`.
    """
    angle = math.radians(angle_deg)
    # the cable arrives along y = 0 and leaves downwards; the two faces are its tangents
    end = (LEAD_MM * math.cos(angle), -LEAD_MM * math.sin(angle))
    outline = corners((-BLOCK_MM, 0.0), (-BLOCK_MM, -BLOCK_MM), (end[0], -BLOCK_MM), end, (0.0, 0.0, SURFACE_RADIUS_MM))
    width = BLOCK_WIDTH_MM
    screw = board_screw(
        width, f"guide block on the rig: each has {len(BLOCK_HOLES_MM)} holes, one stands there at a time"
    )
    holes = [
        Bore((x - BLOCK_MM, -y, 0.0), (x - BLOCK_MM, -y, width), M4_MM, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw)
        for x, y in BLOCK_HOLES_MM
    ]
    letters = engraving(f"{angle_deg}°", (-22.0, -28.0), 18.0, 7.0, (width - 2.0 * LAYER_MM, width + EDGE_MM))
    return Form(f"guide_block_{angle_deg:02d}_{material}", f"guide block {angle_deg} deg, {material}", material,
                (Prism(outline, 0.0, width),), tuple(holes), letters=letters.prisms, is_exchanged=True)  # fmt: skip


def camera_stand() -> Form:
    """Return a foot with a mast; the camera's screw slides in its slot."""
    (length, width), thick = STAND_FOOT_MM, STAND_THICK_MM
    beside = PartPose((-EDGE_MM, 0.0, thick - EDGE_MM), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))  # local y is up
    gusset = corners((0.0, 0.0), (0.5 * length, 0.0), (0.0, 0.5 * STAND_MAST_MM))
    bodies = (
        Prism(rectangle((-thick, length - thick), (-0.5 * width, 0.5 * width), 5.0), 0.0, thick),
        Prism(rectangle((-thick, 0.0), (-0.25 * width, 0.25 * width)), 0.0, STAND_MAST_MM),
        Prism(gusset, -0.25 * width, thick - 0.25 * width, beside),
        Prism(gusset, 0.25 * width - thick, 0.25 * width, beside),
    )
    across = PartPose((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))  # local x is y, local y is z
    top = STAND_MAST_MM - 10.0
    slot = rectangle((-CAMERA_SCREW_MM, CAMERA_SCREW_MM), (top - CAMERA_SLOT_MM, top), CAMERA_SCREW_MM)
    inset = 9.0
    feet = [(x, sy * (0.5 * width - inset)) for x in (inset - thick, length - thick - inset) for sy in (-1.0, 1.0)]
    screw = board_screw(thick, "camera stand to the board")
    bores = tuple(Bore((x, y, 0.0), (x, y, thick), M4_MM, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw) for x, y in feet)
    return Form(
        "camera_stand",
        "camera stand",
        "pla",
        bodies,
        bores,
        (Prism(slot, -2.0 * thick, thick, across),),
        screws=(Screw(CAMERA_SCREW, "camera to its stand"),),
    )


def target_holder() -> Form:
    """Return one of the two feet that hold the board of the camera's calibration upright in a finger's plane."""
    length, depth, height = HOLDER_MM
    block = Prism(rectangle((-0.5 * length, 0.5 * length), (-0.5 * depth, 0.5 * depth), 4.0), 0.0, height)
    slit = Prism(
        rectangle((-length, length), (-0.5 * BOARD_MM, 0.5 * BOARD_MM)), height - SLIT_DEPTH_MM, height + EDGE_MM
    )
    places = [(sx * 0.35 * length, sy * 0.3 * depth) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)]
    screw = board_screw(height, "feet of the calibration target to the board")
    bores = tuple(
        Bore((x, y, 0.0), (x, y, height), M4_MM, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw) for x, y in places
    )
    return Form("target_holder", "foot of the calibration target", "pla", (block,), bores, (slit,), count=2)


def grasp_cube() -> Form:
    """Return the cube that a new cell grasps first."""
    half = 0.5 * CUBE_MM
    block = Prism(rectangle((-half, half), (-half, half), CUBE_ROUNDING_MM), 0.0, CUBE_MM)
    title = f"test cube of {CUBE_MM:g} mm; as its settings print it about {CUBE_G:g} g"
    return Form("test_cube", title, "pla_light", (block,))
