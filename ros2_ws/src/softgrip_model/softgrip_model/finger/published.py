# SPDX-License-Identifier: Apache-2.0
"""The fingers that the thesis computes and prints, in mm; for documents, benchmarks and tests.

Source: C.-D. Matte, "Toward Predictable Tendon Driven Soft Robots" (2025). Joint lengths are not given there.
"""

from __future__ import annotations

from softgrip_model.finger.design import Finger, JointModel, MomentLaw, Strip

#: [MPa], section 3.2.2; alone it makes the linear law.
YOUNGS_MODULUS_MPA = 21.89
#: [MPa], section 4.2.2.
TANGENT_MODULUS_MPA = (110.08, -89.33, 21.89)
#: [mm], section 3.4: every r of the uniform finger of Fig 3.7a.
UNIFORM_ROUTING_MM = (8.5,) * 6
#: [mm], section 3.4: the finger optimised for equal joint angles, Fig 3.7b.
OPTIMISED_ROUTING_MM = (5.23, 4.00, 7.13, 7.29, 12.00, 10.96)
#: [mm] thickness and routing of the index fingers, Fig 4.4.
CHAPTER_4_MM: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "power": ((2.55, 3.18, 3.36), (5.38, 5.74, 7.58, 7.91, 11.58, 11.81)),
    "hook": ((5.00, 2.76, 3.63), (5.13, 5.15, 7.85, 8.21, 11.69, 11.93)),
    "pinch": ((2.50, 4.27, 4.45), (12.22, 12.99, 5.01, 6.59, 5.59, 5.83)),
}
#: [deg] E_T of those fingers against the demonstrations they were made from, which are not published (section 4.3.1).
CHAPTER_4_ERROR_DEG = {"power": 6.59, "hook": 5.53, "pinch": 3.76}
#: [mm] proximal, middle, distal; width. Fig 4.1. The thumb's metacarpal (60 mm) is rigid.
HAND_MM: dict[str, tuple[tuple[float, ...], float]] = {
    "thumb": ((40.0, 30.0), 15.0),
    "index": ((45.0, 27.0, 23.0), 15.0),
    "middle": ((50.0, 30.0, 25.0), 15.0),
    "ring": ((47.0, 28.0, 24.0), 15.0),
    "little": ((38.0, 20.0, 20.0), 12.0),
}
THUMB_METACARPAL_MM = 60.0
#: [mm] assumed: the best fit of the facts of chapter 3 lies between 9 and 20 (docs/finger.md).
JOINT_LENGTH_MM = 10.0


def chapter_3_finger(routing_mm: tuple[float, ...], joint_length_mm: float = JOINT_LENGTH_MM) -> Finger:
    """Return a finger of section 3.4 with the given routing: hinges, exact |phi| and no stop, as the thesis has it."""
    return Finger(
        link_mm=(35.0,) * 3,
        thickness_mm=(3.0,) * 3,
        length_mm=(joint_length_mm,) * 3,
        routing_mm=routing_mm,
        width_mm=13.0,
        strip=Strip((0.0, 0.0, YOUNGS_MODULUS_MPA), MomentLaw.LINEAR),
        stop_moment_nmm=0.0,
        smoothing_rad=0.0,
        joint_model=JointModel.HINGE,
    )


def chapter_4_finger(
    grasp: str, moment_law: MomentLaw = MomentLaw.ABSOLUTE_TANGENT, *, stop_moment_nmm: float = 1000.0
) -> Finger:
    """Return the index finger of Fig 4.4 for "power", "hook" or "pinch"; hinges, as the thesis computes it."""
    thickness, routing = CHAPTER_4_MM[grasp]
    lengths, width = HAND_MM["index"]
    return Finger(
        link_mm=lengths,
        thickness_mm=thickness,
        length_mm=(JOINT_LENGTH_MM,) * 3,
        routing_mm=routing,
        width_mm=width,
        strip=Strip(TANGENT_MODULUS_MPA, moment_law),
        stop_moment_nmm=stop_moment_nmm,
        joint_model=JointModel.HINGE,
    )
