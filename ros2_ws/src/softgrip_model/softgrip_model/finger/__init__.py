# SPDX-License-Identifier: Apache-2.0
"""How a tendon-driven finger closes under friction: equilibria, exact gradients, batches (docs/finger.md).

Start with `Finger.from_profile(profile, "index")` and `close(finger, law, pulled_mm)`.
"""

from softgrip_model.finger.compliance import JointCompliance, compliances
from softgrip_model.finger.design import FRICTIONLESS, Finger, JointModel, MomentLaw, Strip
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.flexure import FlexureStudy
from softgrip_model.finger.kernel import Control, Gradient, Kernel, Solution, Status, close, reason
from softgrip_model.finger.path import Cylinder, JointLimit, Path, PathSettings, Plane, follow, sphere

__all__ = [
    "FRICTIONLESS",
    "Control",
    "Cylinder",
    "Finger",
    "FingerError",
    "FlexureStudy",
    "Gradient",
    "JointCompliance",
    "JointLimit",
    "JointModel",
    "Kernel",
    "MomentLaw",
    "Path",
    "PathSettings",
    "Plane",
    "Solution",
    "Status",
    "Strip",
    "close",
    "compliances",
    "follow",
    "reason",
    "sphere",
]
