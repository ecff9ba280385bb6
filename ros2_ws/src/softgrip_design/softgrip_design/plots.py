# SPDX-License-Identifier: Apache-2.0
"""Figures of demonstrations and designs."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from softgrip_design.design import HandDesign, Uniform

mpl.use("Agg")
from matplotlib import pyplot as plt

Array = NDArray[np.float64]
COLOURS = mpl.color_sequences["tab10"]
#: of a title, so that it fits its figure
LETTERS_PER_INCH = 10


def draw_design(title: str, design: HandDesign, path: Path) -> None:
    """Draw every followed finger as Fig 4.5 does: joint over whole deflection, human solid, finger dashed."""
    columns = len(design.followed)
    width_in = 3.6 * columns
    figure, axes = plt.subplots(1, columns, figsize=(width_in, 3.9), layout="constrained", squeeze=False)
    for axis, one in zip(axes[0], design.followed, strict=True):
        total = np.degrees(one.target.deflection_rad)
        for j in range(one.target.joints):
            axis.plot(total, np.degrees(one.target.angle_rad[:, j]), color=COLOURS[j], label=f"J{j} hand")
            axis.plot(total, np.degrees(one.closing.angle_rad[0, :, j]), "--", color=COLOURS[j], label=f"J{j} finger")
        axis.set(
            title=f"{one.name}\nerror {one.error_deg:.2f} deg, force {one.force_n:.1f} N",
            xlabel="whole deflection [deg]",
            ylabel="joint angle [deg]",
        )
        axis.legend(fontsize="small")
    figure.suptitle(textwrap.fill(title, int(LETTERS_PER_INCH * width_in), break_on_hyphens=False))
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_uniform(title: str, uniform: Uniform, path: Path) -> None:
    """Draw the joints over the pulled length, as in Fig 3.7."""
    figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
    for j, angles in enumerate(np.degrees(uniform.closing.angle_rad[0]).T):
        axis.plot(uniform.pulls_mm, angles, label=f"J{j}")
    axis.set(title=title, xlabel="pulled length [mm]", ylabel="joint angle [deg]")
    axis.legend()
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_recording(
    times: Array, angles: Mapping[str, Array], motions: Sequence[tuple[float, float, str]], title: str, path: Path
) -> None:
    """Draw a whole recording, one row a finger, motions shaded.

    Args:
        times: (frames,) [s].
        angles: finger -> (frames, joints) [rad], NaN in gaps.
        motions: start [s], end [s] and label of each.
        title: of the figure.
        path: of the image.
    """
    figure, axes = plt.subplots(len(angles), 1, figsize=(14, 2.1 * len(angles)), sharex=True, layout="constrained")
    for axis, (name, values) in zip(np.atleast_1d(axes), angles.items(), strict=True):
        for j, joint in enumerate(np.degrees(values).T):
            axis.plot(times, joint, label=f"J{j}", color=COLOURS[j])
        for start, end, label in motions:
            axis.axvspan(start, end, color="0.5", alpha=0.25)
            axis.text(start, 0.98, label, transform=axis.get_xaxis_transform(), va="top", fontsize="x-small")
        axis.set_ylabel(f"{name} [deg]")
        axis.legend(loc="upper right", fontsize="x-small")
    np.atleast_1d(axes)[-1].set_xlabel("time [s]")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
    plt.close(figure)
