# SPDX-License-Identifier: Apache-2.0
"""Draws what an XL330's two currents say of the tension, for docs/driver.md: of the winding, and of the supply."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.tendon.units import TorqueModel

FIGURE = Path(__file__).resolve().parents[2] / "docs/figures/driver_current.svg"
#: of the shipped spool [m]; tensions that are drawn, and those that are marked [N]
RADIUS_M, TENSIONS_N, MARKED_N = 0.01, np.linspace(0.0, 20.0, 81), (5.0, 10.0, 20.0)


def currents(tension_n: float) -> tuple[float, float]:
    """Return winding and supply current [A] of a shaft that came to rest winding in, at the rated voltage."""
    motor = MODELS["XL330-M288"]
    winding = TorqueModel(motor.torque_per_ampere, motor.no_load_current).current(tension_n, RADIUS_M)
    return winding, motor.resistance * winding**2 / motor.rated_voltage


def draw() -> plt.Figure:
    """Return the figure."""
    figure, axes = plt.subplots(figsize=(7.2, 3.0), layout="constrained")
    drawn = np.array([currents(float(tension)) for tension in TENSIONS_N])
    for column, name, colour, above in (
        (0, "in the winding: makes the torque", "#0b6e4f", 6),
        (1, "from the supply: what is read", "#b2432c", -13),
    ):
        axes.plot(TENSIONS_N, drawn[:, column], color=colour, label=name)
        for tension in MARKED_N:
            value = currents(tension)[column]
            axes.plot(tension, value, "o", color=colour, markersize=4)
            side = "right" if tension == MARKED_N[-1] else "center"
            text = {"fontsize": 8, "textcoords": "offset points", "ha": side, "color": colour}
            axes.annotate(f"{1e3 * value:.0f} mA", (tension, value), (0, above), **text)
    axes.set(xlabel="tension at rest [N]", ylabel="current [A]", xlim=(0.0, TENSIONS_N[-1]), ylim=(-0.06, None))
    axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def main() -> int:
    """Write the figure."""
    plt.rcParams["svg.hashsalt"] = "softgrip"  # the same file each time
    draw().savefig(FIGURE, metadata={"Date": None})
    return 0


if __name__ == "__main__":
    sys.exit(main())
