# SPDX-License-Identifier: Apache-2.0
"""Draws docs/figures/cell_graph.svg: nodes of a cell and the topics between them, from the shipped access policy."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from softgrip_security.policy import Grant, read_policy

ROOT = Path(__file__).resolve().parents[2]
FIGURE = ROOT / "docs/figures/cell_graph.svg"
#: Node -> where it is drawn.
PLACES = {
    "friction_rig": (0.0, 3.2),
    "tendon_driver": (0.0, 1.6),
    "camera": (0.0, 0.0),
    "marker_tracker": (1.85, 0.0),
    "kinematics_predictor": (2.7, 2.2),
    "gdfe_simulator": (2.7, 3.2),
    "hand_description": (4.2, 2.7),
    "grasp_mix_manager": (4.2, 0.6),
    "gripper_command": (1.0, 0.7),
}
#: Where along an edge its topics stand, where the middle is taken.
SHARES = {
    ("friction_rig", "grasp_mix_manager"): 0.5,
    ("friction_rig", "kinematics_predictor"): 0.35,
    ("tendon_driver", "gdfe_simulator"): 0.68,
    ("tendon_driver", "grasp_mix_manager"): 0.72,
    ("tendon_driver", "kinematics_predictor"): 0.3,
    ("marker_tracker", "hand_description"): 0.25,
    ("marker_tracker", "kinematics_predictor"): 0.72,
}
#: What nearly everybody hears would hide the rest; the caption names it.
LEFT_OUT = {"cell/state", "safety/state", "tendon/owners", "tendon/heartbeat", "camera/image_raw"}
COLOURS = {"tendon_driver": "#f3d9c9", "friction_rig": "#f3d9c9", "camera": "#f3d9c9", "grasp_mix_manager": "#d6e6d2"}


def edges() -> dict[tuple[str, str], list[str]]:
    """Return (publisher, subscriber) -> topics between them."""
    policy = {one.name: one for one in read_policy().identities if one.name in PLACES}
    found: dict[tuple[str, str], list[str]] = {}
    for giver, one in policy.items():
        for topic in one.names(Grant.PUBLISH):
            name = topic.strip("/")
            takers = [other for other in policy if topic in policy[other].names(Grant.SUBSCRIBE) and other != giver]
            if name not in LEFT_OUT and topic not in {"/rosout", "/parameter_events", "/diagnostics", "/clock"}:
                for taker in takers:
                    found.setdefault((giver, taker), []).append(name)
    return found


def draw() -> None:
    """Draw and write the figure."""
    plt.rcParams["svg.hashsalt"] = "softgrip"  # the same file each time
    figure, axes = plt.subplots(figsize=(11.0, 5.2), layout="constrained")
    boxes = {}
    for name, place in PLACES.items():
        style = {"boxstyle": "round,pad=0.5", "fc": COLOURS.get(name, "#d9e4f0"), "ec": "0.35"}
        text = axes.text(*place, name, fontsize=10, ha="center", va="center", bbox=style, zorder=3)
        boxes[name] = text.get_bbox_patch()
    for (giver, taker), topics in sorted(edges().items()):
        start, end = PLACES[giver], PLACES[taker]
        arrow = {"arrowstyle": "-|>", "color": "0.45", "patchA": boxes[giver], "patchB": boxes[taker]}
        axes.annotate("", end, start, arrowprops=arrow | {"shrinkA": 2, "shrinkB": 2}, zorder=1)
        share = SHARES.get((giver, taker), 0.5)
        x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
        label = {"fontsize": 8, "ha": "center", "va": "center", "color": "0.25"}
        axes.text(x, y, "\n".join(topics), **label, bbox={"fc": "white", "ec": "none", "pad": 0.8}, zorder=2)
    axes.set(xlim=(-0.5, 4.8), ylim=(-0.3, 3.5))
    axes.axis("off")
    figure.savefig(FIGURE, metadata={"Date": None})
    plt.close(figure)


def main() -> int:
    """Write the figure."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    draw()
    print(FIGURE.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
