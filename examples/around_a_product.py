# SPDX-License-Identifier: Apache-2.0
"""Close a finger on a round product, let it back, and watch the cable stick before it slides."""

from softgrip_model.finger import Cylinder, Finger, JointModel, Path, follow
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory, shipped_directory

PULLS_MM = [4.0, 8.0, 12.0, 11.5, 8.0]


def main() -> Path:
    """Pull onto a cylinder of 40 mm and back."""
    finger = Finger.from_profile(load_directory(shipped_directory())["power"], "index", JointModel.HINGE)
    product = Cylinder(centre_mm=(55.0, -50.0), radius_mm=20.0)
    path = follow(finger, published("braid-tpu").law, PULLS_MM, contacts=[product])
    for pulled, force, gap, slide in zip(PULLS_MM, path.contact_force, path.gap, path.slide, strict=True):
        words = {1: "pulled", 0: "stuck", -1: "let back"}
        bends = ", ".join(words[int(one)] for one in slide)
        print(f"{pulled:4.1f} mm: presses with {force[0]:.2f} N, gap {gap[0]:.2f} mm; bends: {bends}")
    return path


if __name__ == "__main__":
    main()
