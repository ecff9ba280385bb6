# SPDX-License-Identifier: Apache-2.0
"""The palm with a keyed slot for every finger, and the plate between it and the arm; from the hand file alone.

Frame: `palm` of the hand file, lengths in mm. Each slot is a notch in front of the finger's shoulder, so that the
finger can close, and a mortise for its foot along the finger's axis. Cables leave the feet in sheaths below and go out
through windows.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

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
    Point2,
    Point3,
    Prism,
    Screw,
    circle,
    corners,
    rectangle,
)
from softgrip_design.parts.printing import CLEARANCE_MM, NOZZLE_MM
from softgrip_design.parts.screws import ISO_4762_MM, THREAD_IN_PLASTIC, screw_length_mm

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
#: Cross pin, an M3 screw: its head (5.5 mm, ISO 4762) with room, and its own diameter.
PIN_HEAD_RADIUS_MM, PIN_MM = 3.1, 3.0
#: Its thread in the palm, and room beyond it for what the screw pushes before it.
PIN_THREAD_MM, MAX_PIN_THREAD_MM = (PIN_MM * diameters for diameters in THREAD_IN_PLASTIC)
PIN_ROOM_MM = 1.0
#: A hexagon key reaches a head that is sunk as deep as this; it has a diameter of palm below it.
MAX_PIN_SINK_MM, MIN_PIN_SEAT_MM = 10.0, PIN_MM
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
            *(bore for name, one in seats.items() for bore in _pin(hand.slots[name], one, pin_screw(hand, name))),
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
    to_palm = Screw(f"M4 x {screw_length_mm(PLATE_MM + THREAD_IN_PLASTIC[0] * 4.0):g}, ISO 4762", "plate to palm")
    to_arm = Screw("M6 x 12, ISO 4762", "plate to the arm's flange (ISO 9409-1-50-4-M6)")
    holes = [*((at, M4_MM, to_palm) for at in screws), *((at, FLANGE_HOLE_MM, to_arm) for at in flange)]
    bores = [
        Bore((x, y, 0.0), (x, y, PLATE_MM), radius, beyond_mm=(EDGE_MM, EDGE_MM), screw=screw)
        for (x, y), radius, screw in holes
    ]
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


@dataclass(frozen=True)
class PinScrew:
    """The cross pin of a slot; lengths along it, from the slot's middle towards the palm's nearer side.

    Attributes:
        length_mm: of ISO 4762.
        side_mm: where the palm's side is.
        sunk_mm: of the head's seat below that side.
    """

    length_mm: float
    side_mm: float
    sunk_mm: float

    @property
    def tip_mm(self) -> float:
        """Where the screw ends."""
        return self.side_mm - self.sunk_mm - self.length_mm

    @property
    def floor_mm(self) -> float:
        """Where the hole of its thread ends."""
        return self.tip_mm - PIN_ROOM_MM

    @property
    def name(self) -> str:
        """As it is ordered."""
        return f"M3 x {self.length_mm:g}, ISO 4762"


def pin_screw(hand: Hand, name: str) -> PinScrew:
    """Return the cross pin of a slot: the one whose head is sunk least and leaves it the thread that it needs.

    Where too little palm would be left below its head, the next longer one stands on the palm's side.

    Raises:
        PartError: no length of ISO 4762 fits.
    """
    side_mm = 500.0 * hand.palm_size_m[1] - abs(1e3 * hand.slots[name].position_m[1])
    mortise_mm = foot.HALF_WIDTH_MM + CLEARANCE_MM
    needed_mm = side_mm + mortise_mm + PIN_THREAD_MM
    shorter = [PinScrew(one, side_mm, needed_mm - one) for one in reversed(ISO_4762_MM) if one <= needed_mm]
    longer = [PinScrew(one, side_mm, 0.0) for one in ISO_4762_MM if one > needed_mm]
    for screw in (*shorter[:1], *longer[:1]):
        is_seated = side_mm - screw.sunk_mm - mortise_mm >= MIN_PIN_SEAT_MM
        is_deep = -screw.tip_mm - mortise_mm > MAX_PIN_THREAD_MM
        if screw.sunk_mm <= MAX_PIN_SINK_MM and is_seated and not is_deep:
            return screw
    longest_mm = ISO_4762_MM[-1] + MAX_PIN_SINK_MM - PIN_THREAD_MM - mortise_mm
    raise PartError(
        f"slot {name}: expected its middle {mortise_mm + MIN_PIN_SEAT_MM:g} to {longest_mm:g} mm from the palm's side, "
        f"where an M3 screw of ISO 4762 is its cross pin, found {side_mm:g} mm; move the slot or change the palm"
    )


def _check_pins(hand: Hand, seats: dict[str, foot.Seat]) -> None:
    """Raise PartError where a cross pin, from the palm's side to the end of its thread, meets another slot or pin."""
    screws = {name: pin_screw(hand, name) for name in seats}
    poses = {name: finger_pose(hand.slots[name]) for name in seats}
    spans = {name: _pin_span(poses[name], screws[name]) for name in seats}
    pins_meet = ""
    for name, other in itertools.permutations(seats, 2):
        start = poses[name].matrix @ np.array([seats[name].pin_mm, foot.PIN_Y_MM, 0.0, 1.0])
        at = np.linalg.inv(poses[other].matrix) @ start
        if _meets_slot(seats[other], (at[0], at[1]), _beside(spans[name], poses[other].origin[1])):
            raise PartError(
                f"slot {name}: expected a cross pin with nothing in its way, found the foot of '{other}' in its way; "
                "move one of them"
            )
        apart_mm = math.hypot(at[0] - seats[other].pin_mm, at[1] - foot.PIN_Y_MM)
        gap_mm = max(spans[name][0] - spans[other][1], spans[other][0] - spans[name][1])
        if apart_mm < 2.0 * foot.PIN_RADIUS_MM + NOZZLE_MM and gap_mm < NOZZLE_MM and not pins_meet:
            pins_meet = f"slot {name}: expected a cross pin with nothing in its way, found that of '{other}'; move one"
    if pins_meet:
        raise PartError(pins_meet)


def _pin_span(pose: PartPose, screw: PinScrew) -> tuple[float, float]:
    """Return from where to where along the palm's y the holes of a pin reach."""
    ends = [pose.origin[1] + _outwards(pose) * pose.z_axis[1] * z for z in (screw.floor_mm, screw.side_mm)]
    return min(ends), max(ends)


def _beside(span: tuple[float, float], middle: float) -> float:
    """Return how far a span is from a place; 0 where it holds it."""
    return max(span[0] - middle, middle - span[1], 0.0)


def _meets_slot(seat: foot.Seat, at_mm: Point2, beside_mm: float) -> bool:
    """Return whether a pin's hole leaves less than a nozzle's width of wall to a slot.

    Args:
        seat: of the slot.
        at_mm: (x, y) of the pin in the frame of the slot's finger.
        beside_mm: from the slot's middle to the nearest of the hole, along the pin.
    """
    x_mm, y_mm = at_mm
    reach = foot.PIN_RADIUS_MM + NOZZLE_MM
    low, high = (y - sign * CLEARANCE_MM for y, sign in zip(foot.Y_MM, (1.0, -1.0), strict=True))
    in_mortise = x_mm < seat.shoulder_mm + reach and low - reach < y_mm < high + reach
    back = foot.Y_MM[1] + foot.SHOULDER_MM + CLEARANCE_MM
    in_notch = x_mm > seat.shoulder_mm - reach and y_mm < back + reach
    return (in_mortise and beside_mm < foot.HALF_WIDTH_MM + CLEARANCE_MM + NOZZLE_MM) or (
        in_notch and beside_mm < NOTCH_HALF_WIDTH_MM + NOZZLE_MM
    )


def _outwards(pose: PartPose) -> float:
    """Return from which of its sides (1: its local z) a pin comes: the palm's nearer one."""
    return 1.0 if pose.origin[1] * pose.z_axis[1] >= 0.0 else -1.0


def _pin(slot: HandSlot, seat: foot.Seat, screw: PinScrew) -> tuple[Bore, Bore, Bore]:
    """Return the holes of a cross pin: its head's, its shank's to the slot's middle, and its thread's beyond that."""
    pose = finger_pose(slot)
    outwards = _outwards(pose)

    def at(z_mm: float) -> Point3:
        local = np.array([seat.pin_mm, foot.PIN_Y_MM, outwards * z_mm, 1.0])
        return _point((pose.matrix @ local)[:3])

    head = Bore(at(screw.side_mm - screw.sunk_mm), at(screw.side_mm), PIN_HEAD_RADIUS_MM, beyond_mm=(0.0, EDGE_MM))
    shank = Bore(at(0.0), at(screw.side_mm), foot.PIN_RADIUS_MM, beyond_mm=(0.0, EDGE_MM))
    return head, shank, Bore(at(screw.floor_mm), at(0.0), foot.PIN_TAP_RADIUS_MM)


def _window(length_mm: float, bottom_mm: float) -> Prism:
    """Return the cut through both ends of the skirt, seen along x."""
    along = PartPose(x_axis=(0.0, 1.0, 0.0), z_axis=(1.0, 0.0, 0.0))
    width, height = WINDOW_MM
    outline = rectangle((-0.5 * width, 0.5 * width), (bottom_mm - EDGE_MM, bottom_mm + height))
    return Prism(outline, -length_mm, length_mm, along)
