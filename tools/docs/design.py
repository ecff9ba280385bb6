# SPDX-License-Identifier: Apache-2.0
"""Writes docs/design.md and its figure: what capture and optimise do, and what comes out of a recorded hand.

`render()` is the text; a test compares it with the committed file, so that no number in it can grow old.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from string import Template

import numpy as np

from softgrip_design import hand, plots
from softgrip_design.design import Followed, HandDesign, Task, design_hand, design_uniform, evaluate, published_on
from softgrip_design.objective import FollowTrajectory, Weights
from softgrip_design.optimiser import OptimiserSettings, optimise
from softgrip_design.target import STEPS, DesignTarget
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model.finger.published import OPTIMISED_ROUTING_MM
from softgrip_model.friction.published import published

ROOT = Path(__file__).resolve().parents[2]
TEMPLATE = Path(__file__).with_name("design.md.in")
TASK = Task(published("braid-tpu-chapter4").law)
SHIPPED_NAMES = ("captured_power", "captured_pinch", "hand_power", "hand_pinch")


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *rows])


def numbers(values: tuple[float, ...], digits: int = 1) -> str:
    """Return values as text, separated by strokes."""
    return " / ".join(f"{value:.{digits}f}" for value in values)


def objectives() -> dict[str, FollowTrajectory]:
    """Return the index finger's tasks by name."""
    found = {name: TASK.objective(load(SHIPPED / f"{name}.csv"), "index") for name in SHIPPED_NAMES}
    total = math.radians(140.0) * np.arange(1, STEPS + 1) / STEPS
    found["synthetic hook"] = FollowTrajectory(
        hand.blank("index"),
        TASK.law,
        DesignTarget(total, np.outer(total, (0.10, 0.52, 0.38))),
        Weights(),
        hand.THICKNESS_BOUNDS_MM,
        hand.ROUTING_BOUNDS_MM,
    )
    return found


def index_fingers() -> dict[str, tuple[FollowTrajectory, Followed]]:
    """Return the index finger's designs by name."""
    return {name: (task, evaluate(name, task, optimise(task, TASK.search))) for name, task in objectives().items()}


def design_table(fingers: list[tuple[str, Followed]]) -> str:
    """Return what was designed, a row each."""
    # no h and r: the optimum is flat, their digits depend on the processor's rounding
    head = ["", "target J0 / J1 / J2 [deg]", "E_T [deg]", "of each joint [deg]", "E_F [N]"]
    rows = [
        [
            name,
            numbers(tuple(np.degrees(one.target.angle_rad[-1])), 0),
            f"{one.error_deg:.2f}",
            numbers(one.error_per_joint_deg),
            f"{one.force_n:.1f}",
        ]
        for name, one in fingers
    ]
    return table(head, rows)


def published_table(found: dict[str, tuple[FollowTrajectory, Followed]]) -> str:
    """Return error and force of the designs of Fig 4.4 on every target."""
    rows = []
    for name, (task, one) in found.items():
        theirs = [f"{error:.2f} deg / {force:.1f} N" for error, force in published_on(task).values()]
        rows.append([name, f"{one.error_deg:.2f} deg / {one.force_n:.1f} N", *theirs])
    return table(["target", "optimised for it", "power", "hook", "pinch"], rows)


def uniform_table() -> str:
    """Return the uniform finger beside the published one."""
    uniform = design_uniform(published("twine-tpu").law, OptimiserSettings())
    rows = [
        [f"published, {numbers(OPTIMISED_ROUTING_MM, 2)} mm", f"{uniform.published_spread_deg:.2f}", "4.7"],
        ["found here", f"{uniform.spread_deg:.2f}", "-"],
    ]
    return table(["routing", "spread, mode P [deg]", "thesis [deg]"], rows)


def render() -> str:
    """Return the document."""
    found = index_fingers()
    whole = design_hand(load(SHIPPED / "captured_power.csv"), hand.FINGERS, TASK)
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        index_table=design_table([(name, one) for name, (_, one) in found.items()]),
        published_table=published_table(found),
        hand_table=design_table([(one.name, one) for one in whole.followed]),
        uniform_table=uniform_table(),
    )


def main() -> int:
    """Write the document and its figure."""
    (ROOT / "docs/design.md").write_text(render(), encoding="utf-8")
    shown = [one for name, (_, one) in index_fingers().items() if not name.startswith("hand_")]
    plots.draw_design(
        "Index finger: hand and optimised finger",
        HandDesign(tuple(shown), (), 0.0),
        ROOT / "docs/figures/design_index.png",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
