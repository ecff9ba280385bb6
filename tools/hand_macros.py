# SPDX-License-Identifier: Apache-2.0
"""Write the xacro macros of softgrip_description/urdf from the shipped hand and profiles.

Run after one of them has changed: ``python tools/hand_macros.py``. softgrip_description/test/test_xacro.py fails
until then.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from softgrip_description import macro_of, shipped_hand
from softgrip_model.profile import load_directory, shipped_directory

URDF = Path(__file__).resolve().parents[1] / "ros2_ws/src/softgrip_description/urdf"


def main() -> None:
    """Write one file a profile."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    for profile in load_directory(shipped_directory()).values():
        (URDF / f"{profile.id}.urdf.xacro").write_text(macro_of(shipped_hand(), profile), encoding="utf-8")


if __name__ == "__main__":
    main()
