# SPDX-License-Identifier: Apache-2.0
"""A finger as a part: links, V grooves, strips, cable channels, tip anchor, keyed foot, marker seats, engraved serial.

Frame: x along the straight finger from its first joint, closing towards -y, z across; lengths in mm. A joint is the
apex of its groove: the strip (h x l x width) lies on its far side, the flanks start from it at half the opening (thesis
Fig 4.2, section 4.3.2). Where a strip is longer than the groove is wide at a routing point, the flank goes on as a lip
below the strip, so that the cable bends at the profile's distance r and the strip is still l long (docs/parts.md).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from softgrip_design.parts import foot
from softgrip_design.parts.forms import (
    Bore,
    Corner,
    Form,
    Outline,
    PartError,
    PartPose,
    Point2,
    Prism,
    circle,
    corners,
    rectangle,
)
from softgrip_design.parts.lettering import engraving
from softgrip_design.parts.printing import LAYER_MM, NOZZLE_MM
from softgrip_model.profile import FingerDesign

#: Between cable and channel, each side, and the smallest channel that prints open.
CABLE_PLAY_MM, MIN_CHANNEL_RADIUS_MM = 0.35, 0.6
#: Rounding of a channel's mouth, which the cable bends around.
MOUTH_MM = 0.5
#: Height of the slit between a strip's end and the lip below it, and how deep a lip's edge lies at least.
SLIT_MM, MIN_LIP_DEPTH_MM = 0.6, 0.8
#: Kept between a bent strip and the lip.
STRIP_PLAY_MM = 0.3
LIP_RADIUS_MM, TIP_RADIUS_MM, EDGE_RADIUS_MM = 0.3, 3.0, 1.0
#: A crimped bead holds the cable in the tip.
ANCHOR_RADIUS_MM, ANCHOR_DEPTH_MM = 1.5, 2.5
#: Markers of docs/vision.md: diameter, and where the base marker is, behind the first joint.
MARKER_DIAMETER_MM, BASE_MARKER_MM = 5.0, 20.0
MARKER_PLAY_MM = 0.1
#: Depth of the serial, height of its capitals, and how deep below the joints its base line runs.
ENGRAVING_MM, LETTER_MM, MIN_LETTER_MM, BASE_LINE_MM = 2.0 * LAYER_MM, 4.0, 2.0, 5.5
#: Upper side of the body must be flat here before a channel or the shoulder begins.
MARGIN_MM = 1.0
#: Flanks more oblique to the cable than this have no mouth that could be rounded.
MAX_OBLIQUE_RAD = math.radians(75.0)


@dataclass(frozen=True)
class JointGroove:
    """One joint.

    Attributes:
        x_mm: of the joint.
        half_opening_rad: between a flank and the normal of the finger.
        strip_mm: thickness h and length l.
        routing: where the cable bends: entry on the proximal flank, exit on the distal one, (x, y).
        lip_depth_mm: of the upper edge of the lip below the strip; 0: the flank itself starts at the strip's end.
        free_rad: how far the joint closes before the strip touches the lip.
    """

    x_mm: float
    half_opening_rad: float
    strip_mm: tuple[float, float]
    routing: tuple[Point2, Point2]
    lip_depth_mm: float
    free_rad: float


@dataclass(frozen=True)
class FingerForm:
    """A finger's dimensions, and the part that has them.

    Attributes:
        form: the part.
        grooves: base to tip.
        length_mm, width_mm, depth_mm: first joint to tip, across, and below the joints.
        channel_radius_mm: of the cable's channels.
        channels: from the foot to the tip.
        seat: in the palm.
        serial: engraved.
    """

    form: Form
    grooves: tuple[JointGroove, ...]
    length_mm: float
    width_mm: float
    depth_mm: float
    channel_radius_mm: float
    channels: tuple[Bore, ...]
    seat: foot.Seat
    serial: str

    @property
    def cable_mm(self) -> float:
        """Length of cable from the sheath to the anchor, finger straight."""
        first, last = self.channels[0].start, self.channels[-1].end
        points = [first, *((x, y, 0.0) for groove in self.grooves for x, y in groove.routing), last]
        return sum(math.dist(a, b) for a, b in itertools.pairwise(points))


def finger_form(design: FingerDesign, cable_radius_mm: float, name: str, seat: foot.Seat, serial: str) -> FingerForm:
    """Return a finger as a part.

    Args:
        design: of the profile.
        cable_radius_mm: of the profile's cable.
        name: of the slot.
        seat: in the palm.
        serial: to engrave; empty: none.

    Raises:
        PartError: a profile that cannot be made so; names every joint and reason.
    """
    channel_mm = max(MIN_CHANNEL_RADIUS_MM, cable_radius_mm + CABLE_PLAY_MM)
    grooves = _grooves(design, channel_mm)
    problems = _joint_problems(design, grooves, channel_mm) + _base_problems(design, grooves, channel_mm, seat)
    if problems:
        raise PartError("; ".join(f"finger {name}, {text}" for text in problems))
    length_mm, width_mm = 1e3 * design.length_m, 1e3 * design.width_m
    channels = _channels(grooves, length_mm, channel_mm, seat)
    form = Form(
        f"finger_{name}",
        f"finger {name}",
        "tpu",
        (Prism(_outline(design, grooves, seat), -0.5 * width_mm, 0.5 * width_mm), _tenon(seat)),
        (_pin(seat), _sheath_seat(channels[0]), *channels, _anchor(channels[-1])),
        (_key(seat), *_marker_seats(grooves, length_mm, width_mm, seat)),
        _serial(design, grooves, 0.5 * width_mm, serial, name),
    )
    depth_mm = 1e3 * design.body_height_m
    return FingerForm(form, grooves, length_mm, width_mm, depth_mm, channel_mm, channels, seat, serial)


def _grooves(design: FingerDesign, channel_mm: float) -> tuple[JointGroove, ...]:
    made, x_mm = [], 0.0
    for j, opening in enumerate(design.openings_rad):
        half = 0.5 * opening
        entry, exit_ = (1e3 * radius for radius in design.routing_radii_m[2 * j : 2 * j + 2])
        points = ((x_mm - entry * math.sin(half), -entry * math.cos(half)),
                  (x_mm + exit_ * math.sin(half), -exit_ * math.cos(half)))  # fmt: skip
        strip = (1e3 * design.thicknesses_m[j], 1e3 * design.joint_lengths_m[j])
        roof_mm = min(-points[0][1], -points[1][1]) - channel_mm - MOUTH_MM - NOZZLE_MM
        lip_mm, free_rad = _lip(strip, half, roof_mm)
        made.append(JointGroove(x_mm, half, strip, points, lip_mm, free_rad))
        x_mm += 1e3 * design.link_lengths_m[j]
    return tuple(made)


def _lip(strip_mm: tuple[float, float], half_rad: float, roof_mm: float) -> tuple[float, float]:
    """Return the depth of a lip's edge and the angle that it leaves free.

    Args:
        strip_mm: thickness and length.
        half_rad: half of the groove's opening.
        roof_mm: depth above which nothing of the flank is needed for the cable.
    """
    if 0.5 * strip_mm[1] <= roof_mm * math.tan(half_rad):
        return 0.0, 2.0 * half_rad
    needed_mm = strip_depth_mm(strip_mm, half_rad, 2.0 * half_rad) + STRIP_PLAY_MM
    if needed_mm <= roof_mm:
        return min(max(needed_mm, MIN_LIP_DEPTH_MM), roof_mm), 2.0 * half_rad
    low, high = 0.0, 2.0 * half_rad
    for _ in range(40):
        angle = 0.5 * (low + high)
        low, high = (
            (angle, high) if strip_depth_mm(strip_mm, half_rad, angle) + STRIP_PLAY_MM < roof_mm else (low, angle)
        )
    return roof_mm, low


def strip_depth_mm(strip_mm: tuple[float, float], half_rad: float, angle_rad: float) -> float:
    """Return how deep a strip bent to an arc reaches where it crosses the plane of the proximal flank.

    The middle of the strip keeps its length l, so its radius is l / angle; its lower side starts at (-l/2, 0) and
    crosses x = y tan(half). Infinite where the strip would have to fold.
    """
    h, l = strip_mm  # noqa: E741  the thesis' letters
    radius = l / angle_rad if angle_rad > 1e-9 else math.inf
    inner = radius - 0.5 * h
    if math.isinf(radius):
        return 0.0
    if inner <= 0.0:
        return math.inf
    sine = (0.5 * l + math.tan(half_rad) * (0.5 * h - radius)) * math.cos(half_rad) / inner
    turned = half_rad + math.asin(max(-1.0, min(1.0, sine)))
    return inner * (1.0 - math.cos(max(turned, 0.0)))


def _joint_problems(design: FingerDesign, grooves: tuple[JointGroove, ...], channel_mm: float) -> list[str]:
    found = []
    depth_mm = 1e3 * design.body_height_m
    for j, groove in enumerate(grooves):
        h, l = groove.strip_mm  # noqa: E741
        mouth_mm = depth_mm * math.tan(groove.half_opening_rad)
        if h < NOZZLE_MM:
            found.append(f"joint {j}: expected a strip of at least a nozzle's width ({NOZZLE_MM} mm), found {h:g} mm")
        if 0.5 * l >= mouth_mm:
            found.append(
                f"joint {j}: expected a strip shorter than the groove's mouth ({2.0 * mouth_mm:.2f} mm), found {l:g} "
                "mm; shorten it or open the groove"
            )
        for i, (_, y) in enumerate(groove.routing):
            floor_mm = depth_mm + y - channel_mm - MOUTH_MM
            if floor_mm < NOZZLE_MM:
                found.append(
                    f"joint {j}: below routing point {2 * j + i} expected a wall of {NOZZLE_MM} mm, found "
                    f"{floor_mm:.2f} mm; make its distance smaller or the body higher"
                )
        if 0.0 < groove.lip_depth_mm < MIN_LIP_DEPTH_MM:
            found.append(
                f"joint {j}: routing points {2 * j} and {2 * j + 1} leave {groove.lip_depth_mm:.2f} mm between cable "
                f"and strip, expected at least {MIN_LIP_DEPTH_MM} mm; move them outwards or shorten the strip"
            )
        elif groove.lip_depth_mm < 0.0:
            found.append(
                f"joint {j}: the cable runs through the strip; move routing point {2 * j} or {2 * j + 1} outwards"
            )
    ends = [*(groove.x_mm - _reach(groove, depth_mm) for groove in grooves[1:]), 1e3 * design.length_m - TIP_RADIUS_MM]
    for j, (groove, end_mm) in enumerate(zip(grooves, ends, strict=True)):
        left_mm = end_mm - groove.x_mm - _reach(groove, depth_mm)
        if left_mm < 2.0 * NOZZLE_MM:
            found.append(
                f"joint {j}: expected {2.0 * NOZZLE_MM} mm of link between its groove and the next, or the tip, found "
                f"{left_mm:.2f} mm; lengthen link {j} or make the body lower"
            )
    return found


def _reach(groove: JointGroove, depth_mm: float) -> float:
    """Return how far a groove reaches along the finger from its joint."""
    return max(0.5 * groove.strip_mm[1], depth_mm * math.tan(groove.half_opening_rad))


def _base_problems(
    design: FingerDesign, grooves: tuple[JointGroove, ...], channel_mm: float, seat: foot.Seat
) -> list[str]:
    found = []
    if 1e3 * design.width_m < 2.0 * foot.HALF_WIDTH_MM:
        found.append(
            f"foot: expected a finger as wide as its foot ({2.0 * foot.HALF_WIDTH_MM:g} mm), found "
            f"{1e3 * design.width_m:g} mm"
        )
    groove, depth_mm = grooves[0], 1e3 * design.body_height_m
    behind_mm = -seat.shoulder_mm - _reach(groove, depth_mm)
    if behind_mm < MARGIN_MM:
        found.append(
            f"joint 0: expected its groove to end {MARGIN_MM:g} mm before the shoulder at {-seat.shoulder_mm:.2f} mm, "
            f"found {behind_mm:.2f} mm; make the body lower or the opening smaller"
        )
    cable_mm = -groove.routing[0][1]
    deepest_mm = -foot.Y_MM[0] - foot.SHEATH_RADIUS_MM - NOZZLE_MM
    highest_mm = foot.PIN_RADIUS_MM - foot.PIN_Y_MM + NOZZLE_MM + max(channel_mm, foot.SHEATH_RADIUS_MM)
    if not highest_mm <= cable_mm <= deepest_mm:
        found.append(
            f"joint 0: routing point 0 lies {cable_mm:.2f} mm deep, the foot has room for a cable from "
            f"{highest_mm:.2f} to {deepest_mm:.2f} mm; change its distance"
        )
    return found


def _outline(design: FingerDesign, grooves: tuple[JointGroove, ...], seat: foot.Seat) -> Outline:
    """Return the body's outline: along the pad side to the tip, back over the strips."""
    depth_mm, length_mm = 1e3 * design.body_height_m, 1e3 * design.length_m
    base_mm = max(depth_mm, foot.BODY_DEPTH_MM)
    made = [Corner(seat.shoulder_mm, -base_mm, EDGE_RADIUS_MM)]
    if base_mm > depth_mm:
        step_mm = grooves[0].x_mm - _reach(grooves[0], depth_mm)
        made.append(Corner(step_mm, -base_mm))
    for groove in grooves:
        made += _groove_corners(groove, depth_mm)
    tip_radius = min(TIP_RADIUS_MM, 0.25 * depth_mm)
    made += [Corner(length_mm, -depth_mm, tip_radius), Corner(length_mm, grooves[-1].strip_mm[0], EDGE_RADIUS_MM)]
    for groove in reversed(grooves):
        h, l = groove.strip_mm  # noqa: E741
        made += [Corner(groove.x_mm + 0.5 * l, h), Corner(groove.x_mm - 0.5 * l, h)]
    h, l = grooves[0].strip_mm  # noqa: E741
    back_mm = foot.Y_MM[1] + foot.SHOULDER_MM
    rise_mm = min(max(back_mm - h, 0.0), -0.5 * l - seat.shoulder_mm - MARGIN_MM)
    made += [Corner(-0.5 * l - rise_mm, max(back_mm, h)), Corner(seat.shoulder_mm, max(back_mm, h), EDGE_RADIUS_MM)]
    return tuple(made)


def _groove_corners(groove: JointGroove, depth_mm: float) -> list[Corner]:
    """Return a groove from its proximal mouth to its distal one."""
    half, slope = 0.5 * groove.strip_mm[1], math.tan(groove.half_opening_rad)
    side = [(depth_mm * slope, -depth_mm, 0.0)]
    if groove.lip_depth_mm > 0.0:
        side += [(groove.lip_depth_mm * slope, -groove.lip_depth_mm, LIP_RADIUS_MM), (half, -SLIT_MM, 0.0)]
    else:
        side += [(half, -half / slope, 0.0)]
    side += [(half, 0.0, 0.0)]
    return [Corner(groove.x_mm - x, y, r) for x, y, r in side] + [
        Corner(groove.x_mm + x, y, r) for x, y, r in reversed(side)
    ]


def _channels(
    grooves: tuple[JointGroove, ...], length_mm: float, channel_mm: float, seat: foot.Seat
) -> tuple[Bore, ...]:
    """Return the straight channels: from the sheath's seat to the first groove, through each link, to the anchor."""
    start = (seat.end_mm + foot.SHEATH_DEPTH_MM, grooves[0].routing[0][1])
    end = (length_mm - ANCHOR_DEPTH_MM, grooves[-1].routing[1][1])
    points = [start, *(point for groove in grooves for point in groove.routing), end]
    made = []
    for i, (a, b) in enumerate(zip(points[::2], points[1::2], strict=True)):
        steep = abs(math.atan2(b[1] - a[1], b[0] - a[0]))
        before, after = (grooves[k] if 0 <= k < len(grooves) else None for k in (i - 1, i))
        mouths = (MOUTH_MM if before else 0.0, MOUTH_MM if after else 0.0)
        beyond = (_beyond_mm(before, channel_mm, steep), _beyond_mm(after, channel_mm, steep))
        made.append(Bore((*a, 0.0), (*b, 0.0), channel_mm, mouths, beyond))
    return tuple(made)


def _beyond_mm(groove: JointGroove | None, channel_mm: float, steep_rad: float) -> float:
    """Return how far a channel is cut into a groove, so that its whole mouth lies in the flank."""
    if groove is None:
        return MARGIN_MM
    return channel_mm * math.tan(min(groove.half_opening_rad + steep_rad, MAX_OBLIQUE_RAD)) + 0.5 * MOUTH_MM


def _tenon(seat: foot.Seat) -> Prism:
    outline = rectangle((seat.end_mm, seat.shoulder_mm + MARGIN_MM), foot.Y_MM)
    rounded = tuple(Corner(c.x_mm, c.y_mm, EDGE_RADIUS_MM if c.x_mm == seat.end_mm else 0.0) for c in outline)
    return Prism(rounded, -foot.HALF_WIDTH_MM, foot.HALF_WIDTH_MM)


def _key(seat: foot.Seat) -> Prism:
    """Return the V along the back of the tenon."""
    back, depth = foot.Y_MM[1], foot.KEY_DEPTH_MM
    outline = corners((seat.key_mm - 2.0 * depth, -back - depth), (seat.key_mm + 2.0 * depth, -back - depth),
                      (seat.key_mm, -back + depth))  # fmt: skip
    along = PartPose(x_axis=(0.0, 0.0, 1.0), z_axis=(1.0, 0.0, 0.0))
    return Prism(outline, seat.end_mm - MARGIN_MM, seat.shoulder_mm, along)


def _pin(seat: foot.Seat) -> Bore:
    z = foot.HALF_WIDTH_MM
    ends = ((seat.pin_mm, foot.PIN_Y_MM, -z), (seat.pin_mm, foot.PIN_Y_MM, z))
    return Bore(*ends, foot.PIN_RADIUS_MM, beyond_mm=(MARGIN_MM, MARGIN_MM))


def _sheath_seat(base_channel: Bore) -> Bore:
    x, y, z = base_channel.start
    return Bore((x - foot.SHEATH_DEPTH_MM, y, z), (x, y, z), foot.SHEATH_RADIUS_MM, beyond_mm=(MARGIN_MM, 0.0))


def _anchor(tip_channel: Bore) -> Bore:
    x, y, z = tip_channel.end
    return Bore((x, y, z), (x + ANCHOR_DEPTH_MM, y, z), ANCHOR_RADIUS_MM, beyond_mm=(0.0, MARGIN_MM))


def _marker_seats(
    grooves: tuple[JointGroove, ...], length_mm: float, width_mm: float, seat: foot.Seat
) -> tuple[Prism, ...]:
    """Return a pocket of one layer for the dot on each joint, the tip, and the base where it is out of the palm.

    Where a dot comes nearer to the finger's back than a nozzle's width, its pocket is open there.
    """
    radius = 0.5 * MARKER_DIAMETER_MM + MARKER_PLAY_MM
    places = [*(groove.x_mm for groove in grooves), length_mm]
    if seat.shoulder_mm + radius < -BASE_MARKER_MM:
        places.insert(0, -BASE_MARKER_MM)
    back = np.array([(seat.shoulder_mm, foot.Y_MM[1] + foot.SHOULDER_MM), *_strip_backs(grooves)])
    outlines = [circle(radius, (x, 0.0)) for x in places]
    for x in places:
        beside = np.linspace(-radius, radius, 201)
        wall = np.interp(x + beside, *back.T) - np.sqrt(radius**2 - beside**2)
        near = beside[wall < NOZZLE_MM]
        if near.size:
            outlines.append(rectangle((x + near[0], x + near[-1]), (0.0, float(back[:, 1].max()) + MARGIN_MM)))
    top = 0.5 * width_mm
    return tuple(Prism(outline, top - LAYER_MM, top + MARGIN_MM) for outline in outlines)


def _strip_backs(grooves: tuple[JointGroove, ...]) -> list[Point2]:
    """Return both ends of every strip on the finger's back, base to tip; between them it is straight."""
    ends = ((groove.x_mm + side * groove.strip_mm[1], groove.strip_mm[0]) for groove in grooves for side in (-0.5, 0.5))
    return list(ends)


def _serial(
    design: FingerDesign, grooves: tuple[JointGroove, ...], top_mm: float, serial: str, name: str
) -> tuple[Prism, ...]:
    """Return the serial on the longest link, as large as it fits."""
    if not serial:
        return ()
    link = max(range(design.joints), key=lambda j: design.link_lengths_m[j])
    start = grooves[link].x_mm
    margin = max(_reach(grooves[link], BASE_LINE_MM), 0.5 * MARKER_DIAMETER_MM) + MARGIN_MM
    room = 1e3 * design.link_lengths_m[link] - 2.0 * margin
    made = engraving(
        serial, (start + margin, -BASE_LINE_MM), room, LETTER_MM, (top_mm - ENGRAVING_MM, top_mm + MARGIN_MM)
    )
    if made.height_mm < MIN_LETTER_MM:
        raise PartError(
            f"finger {name}: expected a serial that fits {room:.1f} mm of link {link}, found {serial!r}; shorten it"
        )
    return made.prisms
