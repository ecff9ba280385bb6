# SPDX-License-Identifier: Apache-2.0
"""Writes the table of the grasp sequence into docs/cell.md, and draws a grasp as the contact test sees it.

`render()` is the page; a test compares it with the committed file. The grasp is one of the emulated cell in virtual
time (softgrip_testing.virtual_cell): seed 1, power fingers, an orange that is lifted.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.contact import ContactState
from softgrip_cell.grasp.hand import HandState
from softgrip_cell.grasp.sequence import GraspSequence
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase
from softgrip_testing.virtual_cell import VirtualCell, task

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/cell.md"
FIGURE = ROOT / "docs/figures/grasp_decision.png"
BEGIN, END = "<!-- table: tools/docs/cell.py -->\n", "<!-- end of table -->"

#: Colour of each state of a finger.
COLOURS = {
    ContactState.UNKNOWN: "0.85",
    ContactState.FREE: "0.65",
    ContactState.CONTACT: "tab:orange",
    ContactState.BLOCKED: "tab:green",
    ContactState.END_STOP: "tab:red",
}


def table() -> str:
    """Return GraspSequence.TABLE as Markdown."""
    rows = ["| phase | first of these that applies | then |", "|---|---|---|"]
    for phase, rules in GraspSequence.TABLE.items():
        for rule in rules:
            then = rule.then.value if isinstance(rule.then, GraspOutcome) else f"`{rule.then.value}`"
            rows.append(f"| `{phase.value}` | {rule.name} | {then} |")
    return "\n".join(rows) + "\n"


def render() -> str:
    """Return the page with the present table."""
    text = PAGE.read_text(encoding="utf-8")
    return re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: BEGIN + table() + END, text, flags=re.DOTALL)


def grasp() -> list[tuple[float, GraspPhase, HandState]]:
    """Grasp an orange; return time [s], phase and hand of every sample."""
    cell = VirtualCell(1, "power")
    cell.plant.grasp.lifts_itself = False
    cell.home()
    made = task(read_catalogue().products["orange"], "power", cell.check())
    cell.plant.place("orange")
    found = []
    for step, sequence in cell.grasp(made, GraspSettings(lift_window_s=0.5)):
        if step.phase is GraspPhase.LIFT:
            cell.plant.lift()
        if sequence.hand is not None:
            found.append((cell.plant.now_s, sequence.phase, sequence.hand))
    return found


def draw(path: Path) -> None:
    """Draw contact tensions with their thresholds, the log-likelihoods, and the states of the fingers."""
    rows = [row for row in grasp() if row[1] is not GraspPhase.APPROACH]
    times_s = np.array([time_s for time_s, _, _ in rows]) - rows[0][0]
    level = GraspSettings().decision_level(0.01)
    figure, (tensions, ratios, states) = plt.subplots(
        3, 1, figsize=(8.0, 7.0), sharex=True, height_ratios=(3, 2, 1.2), layout="constrained"
    )
    for slot, (name, colour) in enumerate(zip(("index", "middle", "thumb"), ("C0", "C1", "C2"), strict=True)):
        contacts = [hand.contacts[slot] for _, _, hand in rows]
        tensions.plot(times_s, [each.contact_tension_n for each in contacts], colour, label=name)
        tensions.plot(times_s, [each.threshold_n for each in contacts], colour, linestyle=":", linewidth=1)
        ratios.plot(times_s, [each.log_likelihood for each in contacts], colour)
        colours = [COLOURS[each.state] for each in contacts]
        states.scatter(times_s, np.full(len(rows), slot), c=colours, marker="|", s=250)
    tensions.set(ylabel="contact tension [N]", ylim=(-1.0, None))
    tensions.legend(loc="upper left", title="dotted: threshold of one reading")
    ratios.axhline(level, color="k", linewidth=0.8)
    ratios.text(0.0, 1.1 * level, "level: one false contact an hour", fontsize="small")
    ratios.set(ylabel="log-likelihood\nof a contact", yscale="symlog", ylim=(0.0, None))
    states.set(yticks=range(3), yticklabels=("index", "middle", "thumb"), ylim=(-0.6, 2.6), xlabel="time [s]")
    handles = [plt.Line2D([], [], color=colour, linewidth=6, label=state.value) for state, colour in COLOURS.items()]
    states.legend(handles=handles, ncols=len(handles), loc="upper center", bbox_to_anchor=(0.5, -0.45), frameon=False)
    for axes in (tensions, ratios, states):
        for number in range(1, len(rows)):
            if rows[number][1] is not rows[number - 1][1]:
                axes.axvline(times_s[number], color="0.5", linewidth=0.8, linestyle="--")
                if axes is tensions:
                    label = f" {rows[number][1].value}"
                    axes.text(times_s[number], 0.98, label, transform=axes.get_xaxis_transform(), va="top")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> int:
    """Write the table and the figure."""
    PAGE.write_text(render(), encoding="utf-8")
    draw(FIGURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
