# SPDX-License-Identifier: Apache-2.0
"""optimise: from a grasp motion to fingers that repeat it with the least force."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from softgrip_description.hand import shipped_hand
from softgrip_design import hand, plots, trajectory
from softgrip_design.design import HandDesign, Task, design_hand, design_uniform, improve_on_mesh, published_on
from softgrip_design.errors import DesignError
from softgrip_design.objective import Weights
from softgrip_design.optimiser import OptimiserSettings
from softgrip_design.output import follow_report, uniform_report, write_cad_csv
from softgrip_design.parts.printable import problems_of
from softgrip_model import profile
from softgrip_model.finger import FingerError, JointModel, MomentLaw
from softgrip_model.finger.published import CHAPTER_4_ERROR_DEG
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.friction.model_file import read_model
from softgrip_model.friction.published import published, published_ids
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, Resolution

EPILOG = f"""\
Minimises 2 E_T + E_F (Eq 4.4, 4.5): E_T [deg] is the deviation of the joint angles from the demonstration at equal
whole deflection, E_F [N] the tension that the full closing takes. SLSQP with exact gradients, 16 starts.

Writes into --out: <id>.yaml (profile for the cell), <id>_cad.csv (user parameters for a CAD programme), <id>.png (as
Fig 4.5) and <id>.json (error and force of every finger, of the published designs on the same target, and what `parts`
would refuse, which is printed as well). A finger that hardly moves in the demonstration takes
thickness and routing of the index.

TRAJECTORY is a file that `capture` wrote, or one that ships: {", ".join(trajectory.shipped())}.

examples:
  optimise hand_power
  optimise out/capture/motion_02_pinch.csv --finger index --friction braid-tpu
  optimise --objective uniform            the finger of section 3.4: all joints alike over 20 mm
"""
COLUMNS = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
DEFAULT_FRICTION = {"follow": "braid-tpu-chapter4", "uniform": "twine-tpu"}


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="optimise", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("trajectory", nargs="?", metavar="TRAJECTORY", help="joint angles of a grasp motion (CSV)")
    made.add_argument("--objective", choices=("follow", "uniform"), default="follow", help="(default: %(default)s)")
    made.add_argument(
        "--finger", action="append", choices=hand.FINGERS, help="again for more (default: the whole hand)"
    )
    made.add_argument(
        "--friction",
        metavar="ID|FILE",
        help=f"one of {', '.join(published_ids())}, or a model file (default: {DEFAULT_FRICTION['follow']}; "
        f"{DEFAULT_FRICTION['uniform']} for uniform)",
    )
    made.add_argument(
        "--weights", nargs=2, type=float, default=(2.0, 1.0), metavar=("ERROR", "FORCE"), help="of Eq 4.5"
    )
    made.add_argument(
        "--moment-law",
        choices=tuple(map(str, MomentLaw)),
        default=str(MomentLaw.ABSOLUTE_TANGENT),
        help="how the strips bend, docs/finger.md (default: %(default)s)",
    )
    made.add_argument(
        "--joint-model",
        choices=tuple(map(str, JointModel)),
        help=f"mode F or mode P, docs/finger.md (default: {JointModel.FLEXURE}; {JointModel.HINGE} for uniform)",
    )
    made.add_argument(
        "--on-mesh",
        choices=tuple(RESOLUTIONS),
        help="then move every design on to where the finger follows in the mesh (GDFE), not in the kernel alone: "
        "minutes a finger",
    )
    made.add_argument("--starts", type=int, default=16, help="of the search, per finger (default: %(default)s)")
    made.add_argument("--seed", type=int, default=1, help="of the starts (default: %(default)s)")
    made.add_argument("--id", help="of the profile (default: the trajectory's name)")
    made.add_argument("--out", type=Path, default=Path("out/design"), metavar="DIR", help="(default: %(default)s)")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; 0 when fingers were designed, 2 for a request that cannot be met."""
    options = parser().parse_args(args)
    try:
        sound = all(0.0 <= weight < math.inf for weight in options.weights) and sum(options.weights) > 0.0
        if options.starts < 1 or not sound:
            raise DesignError(
                f"expected at least one start and weights of 0 or more, not both 0, found {options.starts} and "
                f"{options.weights}"
            )
        friction_id, law = _friction(options.friction or DEFAULT_FRICTION[options.objective])
        if options.objective == "uniform":
            return _uniform(options, friction_id, law)
        return _follow(options, friction_id, law)
    except (DesignError, FingerError, FrictionError, profile.ProfileError, OSError) as error:
        print(f"optimise: {error}", file=sys.stderr)
        return 2


def _friction(requested: str) -> tuple[str, FrictionLaw]:
    model = read_model(Path(requested)) if Path(requested).suffix else published(requested)
    return model.id, model.law


def _follow(options: argparse.Namespace, friction_id: str, law: FrictionLaw) -> int:
    if options.trajectory is None:
        raise DesignError("expected a TRAJECTORY, found none; `capture` writes them, or name a shipped one")
    path = Path(options.trajectory)
    if not path.suffix:
        path = trajectory.SHIPPED / f"{options.trajectory}.csv"
    demonstration = trajectory.load(path)
    names = tuple(dict.fromkeys(options.finger or [name for name in hand.FINGERS if name in demonstration.angles]))
    task = Task(
        law,
        weights=Weights(*options.weights),
        moment_law=MomentLaw(options.moment_law),
        joint_model=JointModel(options.joint_model or JointModel.FLEXURE),
        search=OptimiserSettings(starts=options.starts, seed=options.seed),
    )
    design = _with_progress(demonstration, names, task)
    if options.on_mesh:
        design = _on_mesh(design, demonstration, task, RESOLUTIONS[options.on_mesh])
    identity = options.id or path.stem
    three_joints = [one for one in design.followed if one.finger.joints == 3]
    compared = {one.name: published_on(task.objective(demonstration, one.name)) for one in three_joints}
    options.out.mkdir(parents=True, exist_ok=True)
    source = (
        f"Designed by softgrip_design from {path.name} ({demonstration.origin.get('source', 'origin not noted')}), "
        f"friction {friction_id}, weights {options.weights[0]:g} and {options.weights[1]:g}, {options.starts} starts "
        f"(seed {options.seed}). Joint length (10 mm) and body height (12 mm) are assumed."
    )
    made = hand.profile(identity, f"Follows {path.stem}", source, friction_id, design.fingers)
    profile.save(made, options.out / f"{identity}.yaml")
    write_cad_csv(design.fingers, options.out / f"{identity}_cad.csv")
    plots.draw_design(f"{path.stem}, friction {friction_id}", design, options.out / f"{identity}.png")
    refused = problems_of(made, shipped_hand())
    report = {
        "trajectory": path.name,
        "friction": friction_id,
        **follow_report(design, compared),
        "not_printable": refused,
    }
    (options.out / f"{identity}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    _print_design(design, compared, options.out / identity)
    for text in refused.values():
        print(f"parts would refuse it for the shipped hand: {text}")
    return 0


def _with_progress(demonstration: trajectory.FingerTrajectory, names: Sequence[str], task: Task) -> HandDesign:
    with Progress(*COLUMNS, console=Console(stderr=True), transient=True) as progress:
        bars = {name: progress.add_task(name, total=task.search.starts) for name in names}
        return design_hand(demonstration, names, task, lambda name: progress.advance(bars[name]))


def _on_mesh(
    design: HandDesign, demonstration: trajectory.FingerTrajectory, task: Task, resolution: Resolution
) -> HandDesign:
    """Return the fingers moved on in the mesh; those that share a design keep the kernel's."""
    with Progress(*COLUMNS, console=Console(stderr=True), transient=True) as progress:
        followed = tuple(
            improve_on_mesh(one, task.objective(demonstration, one.name), task, resolution)
            for one in progress.track(design.followed, description="in the mesh")
        )
    return replace(design, followed=followed)


def _print_design(design: HandDesign, compared: dict[str, dict[str, tuple[float, float]]], stem: Path) -> None:
    count = len(design.followed)
    table = Table(title=f"{count} finger{'s' * (count > 1)} in {design.seconds:.2f} s", caption=f"profile: {stem}.yaml")
    for heading in ("finger", "h [mm]", "r [mm]", "error [deg]", "force [N]", "pull [mm]", "starts within 1 %"):
        table.add_column(escape(heading), justify="left" if heading == "finger" else "right")
    in_mesh = []
    for one in design.followed:
        near = sum(value <= 1.01 * one.optimum.value for value in one.optimum.start_values)
        table.add_row(
            one.name,
            " ".join(f"{value:.2f}" for value in one.finger.thickness_mm),
            " ".join(f"{value:.2f}" for value in one.finger.routing_mm),
            f"{one.error_deg:.2f}",
            f"{one.force_n:.2f}",
            f"{one.closing.pulled_mm[0, -1]:.2f}",
            f"{near}/{len(one.optimum.start_values)}",
        )
        if one.mesh_error_deg:
            before, after = one.mesh_error_deg
            in_mesh.append(f"{one.name} {after:.2f} deg (the kernel's design {before:.2f} deg)")
    for other in design.shared:
        table.add_row(other.name, f"as {other.taken_from}", other.why)
    console = Console(width=None if sys.stdout.isatty() else 130)
    console.print(table)
    if in_mesh:
        console.print(f"error in the mesh: {'; '.join(in_mesh)}")
    if "index" in compared:
        each = (f"{grasp} {error:.2f} deg, {force:.1f} N" for grasp, (error, force) in compared["index"].items())
        console.print("designs of Fig 4.4 on the index's target: " + "; ".join(each))
    thesis = ", ".join(f"{grasp} {error:.2f} deg" for grasp, error in CHAPTER_4_ERROR_DEG.items())
    console.print(f"errors that the thesis reports, on demonstrations of its own: {thesis}")


def _uniform(options: argparse.Namespace, friction_id: str, law: FrictionLaw) -> int:
    if options.trajectory is not None or options.finger:
        raise DesignError("the uniform objective takes no trajectory and no finger: it is the finger of section 3.4")
    if options.joint_model not in {None, str(JointModel.HINGE)}:
        raise DesignError("the uniform objective is the thesis', of hinges; leave --joint-model out")
    uniform = design_uniform(law, OptimiserSettings(starts=options.starts, seed=options.seed))
    identity = options.id or "uniform"
    options.out.mkdir(parents=True, exist_ok=True)
    source = f"Designed by softgrip_design: section 3.4, friction {friction_id}. Joint length (10 mm) is assumed."
    made = hand.profile(identity, "All joints alike", source, friction_id, {"index": uniform.finger})
    profile.save(made, options.out / f"{identity}.yaml")
    write_cad_csv({"index": uniform.finger}, options.out / f"{identity}_cad.csv")
    title = f"spread {uniform.spread_deg:.2f} deg"
    plots.draw_uniform(title, uniform, options.out / f"{identity}.png")
    report = {"friction": friction_id, **uniform_report(uniform)}
    (options.out / f"{identity}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(
        f"routing [mm]: {' '.join(f'{value:.2f}' for value in uniform.finger.routing_mm)}, in {uniform.seconds:.2f} s"
    )
    print(f"spread (Eq 3.10 with squares): {uniform.spread_deg:.3f} deg; routing of the thesis, same model: ", end="")
    print(f"{uniform.published_spread_deg:.3f} deg. Written: {options.out / identity}.*")
    return 0


if __name__ == "__main__":
    sys.exit(main())
