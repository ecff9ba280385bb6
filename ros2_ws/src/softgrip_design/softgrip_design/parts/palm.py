# SPDX-License-Identifier: Apache-2.0
"""The palm with a keyed slot for every finger, and the plate between it and the arm; from the hand file alone.

Frame: `palm` of the hand file, lengths in mm. Each slot is a notch in front of the finger's shoulder, so that the
finger can close, and a mortise for its foot along the finger's axis. Cables leave the feet in sheaths below and go out
through windows.
"""

from __future__ import annotations

import math

import numpy as np

from softgrip_description.geometry import slot_pose
from softgrip_description.hand import Hand, HandSlot
from softgrip_design.parts import foot
from softgrip_design.parts.forms import (
    Bore,
    Form,
    Outline,
    PartError,
    PartPose,
    Point3,
    Prism,
    circle,
    corners,
    rectangle,
)
from softgrip_design.parts.printing import CLEARANCE_MM

#: Widest finger body, each side of its middle, with room to move; and how high its back stands above the joints.
NOTCH_HALF_WIDTH_MM = 8.0
#: Room under the palm for feet and sheaths is closed by this plate, which the arm carries.
PLATE_MM, SKIRT_MM, POST_MM = 5.0, 4.0, 12.0
CORNER_RADIUS_MM, EDGE_MM = 6.0, 1.0
#: ISO 9409-1-50-4-M6: four M6 screws on a circle of 50 mm.
FLANGE_CIRCLE_MM, FLANGE_HOLE_MM = 50.0, 3.3
#: M4 screws between palm and plate: clearance and the core that they cut their thread into.
M4_MM, M4_TAP_MM = 2.25, 1.65
#: Window of the sheaths: width and height.
WINDOW_MM = (36.0, 6.0)
PIN_THREAD_MM = 6.0
#: Longer than any palm.
FAR_MM = 200.0
#: A finger flatter than this would need a slot longer than a palm.
MIN_REST_SINE = 0.5


def palm_seat(hand: Hand, name: str) -> foot.Seat:
    """Return how the finger of a slot sits in the palm.

    Raises:
        PartError: the hand has no such slot, or it lies too flat for one.
    """
    if name not in hand.slots:
        raise PartError(f"slot {name!r}: expected one of {', '.join(hand.slots)}")
    slot = hand.slots[name]
    if math.sin(slot.rest_angle_rad) < MIN_REST_SINE:
        raise PartError(
            f"slot {name}: expected a finger that rises by {math.degrees(math.asin(MIN_REST_SINE)):.0f} deg or more "
            f"from the palm, found {math.degrees(slot.rest_angle_rad):.0f} deg"
        )
    return foot.seat(tuple(hand.slots), name, slot)


def palm_forms(hand: Hand) -> tuple[Form, Form]:
    """Return palm and plate.

    Raises:
        PartError: a slot cannot be made, or the feet do not fit between palm and arm.
    """
    length, width, thickness = (1e3 * size for size in hand.palm_size_m)
    skirt_mm = 1e3 * hand.flange_position_m[2] - thickness - PLATE_MM
    seats = {name: palm_seat(hand, name) for name in hand.slots}
    _check_pins(hand, seats)
    below_mm = max(_depth_mm(hand.slots[name], one) for name, one in seats.items()) - thickness
    if skirt_mm < below_mm:
        raise PartError(
            f"palm: feet reach {below_mm:.1f} mm below it, expected at most {skirt_mm:.1f} mm to the plate on the arm; "
            "raise flange.position_m or make the palm thicker"
        )
    outline = rectangle((-0.5 * length, 0.5 * length), (-0.5 * width, 0.5 * width), CORNER_RADIUS_MM)
    inner = rectangle(
        (SKIRT_MM - 0.5 * length, 0.5 * length - SKIRT_MM),
        (SKIRT_MM - 0.5 * width, 0.5 * width - SKIRT_MM),
        CORNER_RADIUS_MM - SKIRT_MM,
    )
    screws = [
        (sx * (0.5 * length - 0.5 * POST_MM), sy * (0.5 * width - 0.5 * POST_MM)) for sx in (-1, 1) for sy in (-1, 1)
    ]
    bottom = -thickness - skirt_mm
    skirt = Prism(outline, bottom, EDGE_MM - thickness, holes=(inner,))
    posts = [Prism(circle(0.5 * POST_MM, at), bottom, EDGE_MM - thickness) for at in screws]
    palm = Form(
        "palm",
        "palm",
        "pla",
        (Prism(outline, -thickness, 0.0), skirt, *posts),
        (
            *(bore for name, one in seats.items() for bore in _pin(hand.slots[name], one, 0.5 * width)),
            *(Bore((*at, bottom), (*at, -0.5 * thickness), M4_TAP_MM, beyond_mm=(EDGE_MM, 0.0)) for at in screws),
        ),
        (
            *(cut for name, one in seats.items() for cut in _slot(hand.slots[name], one)),
            _window(length, bottom),
        ),
        up=(0.0, 0.0, -1.0),
    )
    return palm, _plate(outline, screws)


def _plate(outline: Outline, screws: list[tuple[float, float]]) -> Form:
    turned = [math.radians(45.0 + 90.0 * k) for k in range(4)]
    flange = [(0.5 * FLANGE_CIRCLE_MM * math.cos(a), 0.5 * FLANGE_CIRCLE_MM * math.sin(a)) for a in turned]
    holes = [*((at, M4_MM) for at in screws), *((at, FLANGE_HOLE_MM) for at in flange)]
    bores = [Bore((x, y, 0.0), (x, y, PLATE_MM), radius, beyond_mm=(EDGE_MM, EDGE_MM)) for (x, y), radius in holes]
    return Form("palm_plate", "plate between palm and arm", "pla", (Prism(outline, 0.0, PLATE_MM),), tuple(bores))


def finger_pose(slot: HandSlot) -> PartPose:
    """Return where a finger stands in the palm."""
    matrix = slot_pose(slot)
    return PartPose(_point(1e3 * matrix[:3, 3]), _point(matrix[:3, 0]), _point(matrix[:3, 2]))


def _point(values: np.ndarray) -> Point3:
    return float(values[0]), float(values[1]), float(values[2])


def _depth_mm(slot: HandSlot, seat: foot.Seat) -> float:
    """Return how deep below the palm's surface a foot reaches."""
    sine, cosine = math.sin(slot.rest_angle_rad), math.cos(slot.rest_angle_rad)
    across = max(-cosine * y for y in foot.Y_MM) if cosine < 0.0 else max(cosine * y for y in foot.Y_MM)
    return -1e3 * slot.position_m[2] - seat.end_mm * sine + across


def _slot(slot: HandSlot, seat: foot.Seat) -> tuple[Prism, Prism]:
    """Return the notch in which a finger moves, and the mortise for its foot, whose rib fits the foot's key."""
    pose = finger_pose(slot)
    back = foot.Y_MM[1] + foot.SHOULDER_MM + CLEARANCE_MM
    notch = Prism(
        rectangle((seat.shoulder_mm, FAR_MM), (-FAR_MM, back)), -NOTCH_HALF_WIDTH_MM, NOTCH_HALF_WIDTH_MM, pose
    )
    low, high = foot.Y_MM[0] - CLEARANCE_MM, foot.Y_MM[1] + CLEARANCE_MM
    half, depth = foot.HALF_WIDTH_MM + CLEARANCE_MM, foot.KEY_DEPTH_MM
    section = corners(
        (-half, -high), (seat.key_mm - depth, -high), (seat.key_mm, depth - high), (seat.key_mm + depth, -high),
        (half, -high), (half, -low), (-half, -low),
    )  # fmt: skip
    matrix = pose.matrix
    along = PartPose(pose.origin, _point(matrix[:3, 2]), _point(matrix[:3, 0]))
    mortise = Prism(section, seat.shoulder_mm - 0.4 * FAR_MM, seat.shoulder_mm + EDGE_MM, along)
    return notch, mortise


def _check_pins(hand: Hand, seats: dict[str, foot.Seat]) -> None:
    """Raise PartError where a cross pin on its way to the palm's side meets the foot of another slot."""
    reach = foot.PIN_RADIUS_MM + CLEARANCE_MM
    for name, seat in seats.items():
        pose = finger_pose(hand.slots[name])
        outwards = _outwards(pose) * pose.z_axis[1]
        start = pose.matrix @ np.array([seat.pin_mm, foot.PIN_Y_MM, 0.0, 1.0])
        for other, beside in seats.items():
            place = finger_pose(hand.slots[other])
            if (place.origin[1] - pose.origin[1]) * outwards <= 0.0:
                continue
            x, y = (np.linalg.inv(place.matrix) @ start)[:2]
            along = beside.end_mm - reach < x < beside.shoulder_mm + reach
            if along and foot.Y_MM[0] - reach < y < foot.Y_MM[1] + reach:
                raise PartError(
                    f"slot {name}: expected a cross pin that reaches the palm's side, found the foot of '{other}' in "
                    "its way; move one of them along x"
                )


def _outwards(pose: PartPose) -> float:
    """Return from which of its sides (1: its local z) a pin comes: the palm's nearer one."""
    return 1.0 if pose.origin[1] * pose.z_axis[1] >= 0.0 else -1.0


def _pin(slot: HandSlot, seat: foot.Seat, half_palm_mm: float) -> tuple[Bore, Bore]:
    """Return the hole of the cross pin from the palm's nearer side to the mortise, and its thread beyond it."""
    pose = finger_pose(slot)
    outwards = _outwards(pose)
    mortise = foot.HALF_WIDTH_MM + CLEARANCE_MM
    side = half_palm_mm - abs(pose.origin[1])

    def at(z_mm: float) -> Point3:
        local = np.array([seat.pin_mm, foot.PIN_Y_MM, outwards * z_mm, 1.0])
        return _point((pose.matrix @ local)[:3])

    return (
        Bore(at(0.0), at(side), foot.PIN_RADIUS_MM, beyond_mm=(0.0, EDGE_MM)),
        Bore(at(-mortise - PIN_THREAD_MM), at(0.0), foot.PIN_TAP_RADIUS_MM),
    )


def _window(length_mm: float, bottom_mm: float) -> Prism:
    """Return the cut through both ends of the skirt, seen along x."""
    along = PartPose(x_axis=(0.0, 1.0, 0.0), z_axis=(1.0, 0.0, 0.0))
    width, height = WINDOW_MM
    outline = rectangle((-0.5 * width, 0.5 * width), (bottom_mm - EDGE_MM, bottom_mm + height))
    return Prism(outline, -length_mm, length_mm, along)
