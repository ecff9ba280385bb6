# SPDX-License-Identifier: Apache-2.0
"""Close a finger with and without friction: joint angles, fingertip and tension along the cable."""

import numpy as np

from softgrip_model.finger import FRICTIONLESS, Finger, Solution, close
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory, shipped_directory


def main() -> tuple[Solution, Solution]:
    """Close the shipped power finger by 20 mm."""
    profile = load_directory(shipped_directory())["power"]
    finger = Finger.from_profile(profile, "index")
    pulled_mm = np.linspace(0.1, 20.0, 100)
    rubbing = close(finger, published("braid-tpu").law, pulled_mm)
    sliding = close(finger, FRICTIONLESS, pulled_mm)
    for name, found in (("with friction", rubbing), ("without", sliding)):
        angles = ", ".join(f"{angle:.1f}" for angle in np.degrees(found.angle_rad[0, -1]))
        x, y = found.tip_mm[0, -1]
        at_actuator, at_tip = found.tension_n[0, -1, [0, -1]]
        print(f"{name:14} {angles} deg, tip at {x:.1f}, {y:.1f} mm, tension {at_actuator:.2f} N -> {at_tip:.2f} N")
    return rubbing, sliding


if __name__ == "__main__":
    main()
