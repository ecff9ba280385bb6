# SPDX-License-Identifier: Apache-2.0
"""predict: how a finger of a profile closes, under every friction law side by side."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from softgrip_model import profile
from softgrip_model.finger import Finger, FingerError, JointModel, Solution, close, reason
from softgrip_model.finger.comparison import laws_side_by_side
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.friction.model_file import read_model
from softgrip_model.friction.published import published, published_ids

EPILOG = """\
The profile's own friction model is used unless --friction names another. Its simpler relatives (Capstan, Heap et al.)
are fitted to nine points of it, so that all know the same measurements; 'no friction' slides freely.

examples:
  predict --profile power --pull 20
  predict --profile hook --finger thumb --pull 12 --friction braid-tpu --json hook.json --plot hook.png
"""


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="predict", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--profile", required=True, help="id of a shipped profile, or a profile file (YAML)")
    made.add_argument("--finger", default="index", help="slot (default: %(default)s)")
    made.add_argument(
        "--pull", type=float, default=20.0, metavar="MM", help="pulled length [mm] (default: %(default)s)"
    )
    made.add_argument("--steps", type=int, default=200, help="states along the closing (default: %(default)s)")
    made.add_argument("--rows", type=int, default=10, help="of the printed table (default: %(default)s)")
    made.add_argument(
        "--joint-model",
        choices=tuple(map(str, JointModel)),
        default=str(JointModel.FLEXURE),
        help="rigid links on hinges (mode P), or strips that bend (mode F), docs/finger.md (default: %(default)s)",
    )
    made.add_argument("--friction", metavar="ID|FILE", help=f"one of {', '.join(published_ids())}, or a model file")
    made.add_argument("--profiles", type=Path, metavar="DIR", help="folder of profiles (default: softgrip_bringup's)")
    made.add_argument("--json", type=Path, metavar="FILE", help="write every state of every law here")
    made.add_argument("--plot", type=Path, metavar="FILE", help="draw joints, tip path and tensions (png, svg, pdf)")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; 0 when every law gave a closing, 1 when one broke off, 2 for a request that cannot be met."""
    options = parser().parse_args(args)
    try:
        if not (math.isfinite(options.pull) and options.pull > 0.0 and options.steps >= 1 and options.rows >= 1):
            raise FingerError(f"expected a pull > 0 mm and at least one step, found {options.pull} and {options.steps}")
        chosen = _profile(options.profile, options.profiles)
        finger = Finger.from_profile(chosen, options.finger, JointModel(options.joint_model))
        name, law = _friction(chosen, options.friction)
    except (FingerError, FrictionError, profile.ProfileError) as error:
        print(f"predict: {error}", file=sys.stderr)
        return 2
    pulls = options.pull * np.arange(1, options.steps + 1) / options.steps
    closings = {label: close(finger, its_law, pulls) for label, its_law in laws_side_by_side(law).items()}
    title = f"{chosen.title}: {options.finger} finger, friction {name}"
    _print_table(title, finger, pulls, closings, options.rows)
    if options.json:
        text = json.dumps(_as_data(title, finger, closings), indent=1)
        options.json.write_text(text + "\n", encoding="utf-8")
    if options.plot:
        _draw(title, pulls, closings, options.plot)
    return 1 if any(closing.failed.any() for closing in closings.values()) else 0


def _profile(name: str, directory: Path | None) -> profile.Profile:
    if Path(name).suffix:
        return profile.load(Path(name))
    shipped = profile.load_directory(directory or profile.shipped_directory())
    if name not in shipped:
        raise FingerError(f"unknown profile {name!r}; found {', '.join(sorted(shipped))}")
    return shipped[name]


def _friction(chosen: profile.Profile, requested: str | None) -> tuple[str, FrictionLaw]:
    if requested is None:
        own = assumed_friction(chosen)
        return own.id, own.law
    model = read_model(Path(requested)) if Path(requested).suffix else published(requested)
    return model.id, model.law


def _print_table(title: str, finger: Finger, pulls: np.ndarray, closings: Mapping[str, Solution], rows: int) -> None:
    table = Table(title=title, caption=escape("angles [deg], tip [mm], tension at the actuator and at the tip [N]"))
    angles = tuple(f"J{j}" for j in range(finger.joints))
    for heading in ("pull [mm]", "law", *angles, "tip x", "tip y", "T", "T tip", "remarks"):
        table.add_column(escape(heading), justify="left" if heading in {"law", "remarks"} else "right")
    shown = np.unique(np.linspace(0, len(pulls) - 1, min(rows, len(pulls)) + 1).astype(int)[1:])
    for k in shown:
        for i, (label, closing) in enumerate(closings.items()):
            degrees = (f"{angle:.2f}" for angle in np.degrees(closing.angle_rad[0, k]))
            tip = (f"{value:.1f}" for value in closing.tip_mm[0, k])
            tensions = (f"{closing.tension_n[0, k, end]:.3f}" for end in (0, -1))
            pull = f"{pulls[k]:.2f}" if i == 0 else ""
            table.add_row(pull, label, *degrees, *tip, *tensions, reason(int(closing.status[0, k])))
        table.add_section()
    Console(width=None if sys.stdout.isatty() else 140).print(table)


def _as_data(title: str, finger: Finger, closings: Mapping[str, Solution]) -> dict[str, object]:
    def numbers(array: Any) -> Any:  # JSON has no NaN
        if isinstance(array, float):
            return array if math.isfinite(array) else None
        return [numbers(item) for item in array]

    return {
        "title": title,
        "joints": finger.joints,
        "units": {"angle": "rad", "length": "mm", "tension": "N"},
        "laws": {
            label: {
                "pulled_mm": numbers(closing.pulled_mm[0].tolist()),
                "angle_rad": numbers(closing.angle_rad[0].tolist()),
                "tip_mm": numbers(closing.tip_mm[0].tolist()),
                "tension_n": numbers(closing.tension_n[0].tolist()),
                "remarks": [reason(int(status)) for status in closing.status[0]],
            }
            for label, closing in closings.items()
        },
    }


def _draw(title: str, pulls: np.ndarray, closings: Mapping[str, Solution], path: Path) -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415  the backend has to be chosen first

    figure, (joints, tips, tensions) = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    styles = ("-", "--", ":", "-.", (0, (5, 1)), (0, (1, 3)))
    for colour, (label, closing) in zip(mpl.color_sequences["tab10"], closings.items(), strict=False):
        for j, angle in enumerate(np.degrees(closing.angle_rad[0]).T):
            joints.plot(pulls, angle, color=colour, linestyle=styles[j], label=f"{label}, J{j}")
        tips.plot(*closing.tip_mm[0].T, color=colour, label=label)
        for i, tension in enumerate(closing.tension_n[0].T):
            tensions.plot(pulls, tension, color=colour, alpha=1.0 - 0.8 * i / closing.tension_n.shape[2])
    joints.set(title="joint angles", xlabel="pulled length [mm]", ylabel="angle [deg]")
    joints.legend(fontsize="x-small", ncols=2)
    tips.set(title="tip path", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    tips.legend()
    tensions.set(title="tension in each span, pale towards the tip", xlabel="pulled length [mm]", ylabel="tension [N]")
    figure.suptitle(title)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
