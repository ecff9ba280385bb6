# SPDX-License-Identifier: Apache-2.0
"""How a tendon-driven finger closes under friction: equilibria, exact gradients, batches (docs/finger.md).

Start with `Finger.from_profile(profile, "index")` and `close(finger, law, pulled_mm)`.
"""

from softgrip_model.finger.design import FRICTIONLESS, Finger, MomentLaw, Strip, law_of
from softgrip_model.finger.errors import FingerError
from softgrip_model.finger.kernel import Control, Gradient, Kernel, Solution, Status, close, reason

__all__ = [
    "FRICTIONLESS",
    "Control",
    "Finger",
    "FingerError",
    "Gradient",
    "Kernel",
    "MomentLaw",
    "Solution",
    "Status",
    "Strip",
    "close",
    "law_of",
    "reason",
]
