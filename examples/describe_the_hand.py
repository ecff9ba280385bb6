# SPDX-License-Identifier: Apache-2.0
"""Write the hand as URDF and MJCF, for RViz, MoveIt and MuJoCo."""

import sys
from pathlib import Path

from softgrip_description import shipped_hand, urdf_of
from softgrip_description.mjcf import mjcf_of
from softgrip_model.profile import load_directory, shipped_directory


def main(folder: Path) -> tuple[Path, Path]:
    """Write hand.urdf and hand.xml with pinch fingers; returns both files."""
    profile, hand = load_directory(shipped_directory())["pinch"], shipped_hand()
    urdf, mjcf = folder / "hand.urdf", folder / "hand.xml"
    fingers = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    urdf.write_text(urdf_of(hand, fingers))
    mjcf.write_text(mjcf_of(hand, fingers, profile.material))
    for file in (urdf, mjcf):
        print(f"{file}: {file.stat().st_size} bytes")
    return urdf, mjcf


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
