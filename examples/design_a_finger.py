# SPDX-License-Identifier: Apache-2.0
"""Design a finger that follows a human demonstration, and save it as a profile."""

import sys
from pathlib import Path

from softgrip_design import hand, trajectory
from softgrip_design.design import HandDesign, Task, design_hand
from softgrip_design.optimiser import OptimiserSettings
from softgrip_model import profile
from softgrip_model.friction.published import published


def main(folder: Path) -> HandDesign:
    """Follow the index finger of the shipped power grasp."""
    demonstration = trajectory.load(trajectory.SHIPPED / "hand_power.csv")
    friction = published("braid-tpu")
    task = Task(friction.law, search=OptimiserSettings(starts=4, seed=1))
    design = design_hand(demonstration, ["index"], task)
    (index,) = design.followed
    print(f"thickness {[round(h, 2) for h in index.finger.thickness_mm]} mm")
    print(f"routing {[round(r, 2) for r in index.finger.routing_mm]} mm")
    print(f"follows to {index.error_deg:.2f} deg with {index.force_n:.1f} N, found in {design.seconds:.2f} s")
    made = hand.profile("my_power", "Follows hand_power", "examples/design_a_finger.py", friction.id, design.fingers)
    profile.save(made, folder / "my_power.yaml")
    return design


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
