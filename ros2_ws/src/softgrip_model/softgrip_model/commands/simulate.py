# SPDX-License-Identifier: Apache-2.0
"""simulate: hyperelastic solids from a case file, or a finger closed by its tendon; a table, VTU and PNG."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from softgrip_model import gdfe, profile
from softgrip_model.finger import Finger, FingerError, Solution, close
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe import ConstitutiveLaw, Equilibrium, GdfeError, Mesh, Solver, SolverSettings
from softgrip_model.gdfe.case_file import Case, FingerCase, load_case
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings, ClosingShape
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, FingerMesh, mesh_finger
from softgrip_model.gdfe.march import March, march
from softgrip_model.gdfe.materials import Linear, StressPolynomial
from softgrip_model.gdfe.mesh_file import write_mesh
from softgrip_model.gdfe.picture import draw_shapes
from softgrip_model.gdfe.rigid import check_held
from softgrip_model.gdfe.solid_mesh import ElementSize, mesh_solid
from softgrip_model.gdfe.thesis import ThesisState, force_unit
from softgrip_model.gdfe.thesis_bars import difference, reference_displacements
from softgrip_model.gdfe.validity import warnings_of

Array = NDArray[np.float64]

#: Between two shapes of a solid, at most.
MAX_SOLID_STEP_MM = 2.0

EPILOG = """\
laws:
  calibrated  constant matrix, forces in newtons, path-independent (default of most cases)
  rigorous    Q1P0 finite elements of Ogden materials on the same constant matrix: slower, no calibration
  thesis      shape factors as the thesis writes them: reproduction only, its forces mean nothing

examples:
  simulate rotation
  simulate tension --law rigorous --json tension.json
  simulate my_case.yaml --refine 2 --out results
  simulate finger_closing
  simulate finger_closing --finger pinch/thumb
  simulate finger_closing --finger power/index --solid out/parts/power/finger_index.step --steps 5
"""


@dataclass(frozen=True, eq=False)
class SimulationResult:
    """What a case gave: rows of the table, data for JSON, the shape to draw, and whether it got to its full load."""

    rows: list[tuple[str, str]]
    data: dict[str, object]
    mesh: Mesh
    displacement: Array
    strain: Array
    unit: str
    reference: Array | None
    completed: bool


def shipped_cases() -> dict[str, Path]:
    """Return name -> file of the cases that come with the package."""
    return {path.stem: path for path in sorted((Path(gdfe.__file__).parent / "cases").glob("*.yaml"))}


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="simulate", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("case", help=f"case file (YAML), or one that is shipped: {', '.join(shipped_cases())}")
    made.add_argument("--finger", metavar="PROFILE/FINGER", help="close this one instead of the case's")
    made.add_argument("--law", choices=[str(law) for law in ConstitutiveLaw], help="instead of the case's own")
    made.add_argument("--mesh", type=Path, metavar="FILE", help="hexahedra to use instead of the case's mesh (meshio)")
    made.add_argument("--refine", type=int, default=1, metavar="N", help="N times as many elements each way of a bar")
    made.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder for VTU and PNG (default: here)")
    made.add_argument("--json", type=Path, metavar="FILE", help="write the figures of the table here")
    made.add_argument(
        "--solid", type=Path, metavar="STEP", help="a finger as `parts` made it, beside its own mesh (gmsh)"
    )
    made.add_argument("--element-mm", type=float, metavar="MM", help="largest edge in a solid (default: 3)")
    made.add_argument("--steps", type=int, metavar="N", help="shapes of a closing (default: the case's)")
    made.add_argument("--profiles", type=Path, metavar="DIR", help="folder of profiles (default: softgrip_bringup's)")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; 0 when the full load was reached, 1 when not, 2 for a case that cannot be simulated."""
    options = parser().parse_args(args)
    path = shipped_cases().get(options.case, Path(options.case))
    console = Console()
    try:
        case = load_case(path, mesh_file=options.mesh, refine=options.refine)
        if options.finger:
            case = _of_finger(case, options.finger)
        if isinstance(case, FingerCase):
            result = _finger(case, options)
        else:
            law = ConstitutiveLaw(options.law) if options.law else case.law
            result = _solid(replace(case, law=law), console)
    except (GdfeError, FingerError, profile.ProfileError) as error:
        print(f"simulate: {error}", file=sys.stderr)
        return 2
    table = Table("", "", title=escape(case.title), show_header=False)
    for row in result.rows:
        table.add_row(*(escape(text) for text in row))
    console.print(table)
    options.out.mkdir(parents=True, exist_ok=True)
    stem = options.out / path.stem
    write_mesh(stem.with_suffix(".vtu"), result.mesh, result.displacement, cell_data={"strain": result.strain})
    shape = (case.title, result.displacement, result.strain)
    draw_shapes(stem.with_suffix(".png"), result.mesh, [shape], result.unit, result.reference)
    console.print(escape(f"wrote {stem.with_suffix('.vtu')} and {stem.with_suffix('.png')}"))
    if options.json:
        options.json.write_text(json.dumps(result.data, indent=1), encoding="utf-8")
    return 0 if result.completed else 1


def _of_finger(case: Case | FingerCase, name: str) -> FingerCase:
    """Return the case with the finger of this name, PROFILE/FINGER."""
    if not isinstance(case, FingerCase):
        raise GdfeError(f"--finger: expected a case that closes a finger, found {case.title!r}; try finger_closing")
    chosen, slash, finger = name.partition("/")
    if not (chosen and slash and finger):
        raise GdfeError(f"--finger: expected PROFILE/FINGER, as power/index, found {name!r}")
    title = f"{finger} finger of {chosen}, closed by its tendon"
    return replace(case, profile=chosen, finger=finger, title=title)


def _solid(case: Case, console: Console) -> SimulationResult:
    check_held(case.mesh, case.supports)
    started = time.perf_counter()
    solver = Solver(case.mesh, case.materials, case.supports, case.loads.cables, _settings(case), case.loads.around)
    state = _thesis_state(solver, case) if case.law is ConstitutiveLaw.THESIS else None
    prepared = time.perf_counter()
    increments = case.increments if case.law is ConstitutiveLaw.CALIBRATED else max(10, case.increments)
    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task("load", total=1.0)
        found = march(
            solver,
            case.loading,
            increments,
            tolerance=case.tolerance,
            before=state.before if state else None,
            progress=lambda share: progress.update(bar, completed=share),
        )
    solved = time.perf_counter()
    force = case.newtons if state is None else case.newtons * force_unit(state.moduli, state.omega)
    return _solid_result(case, found, force, prepared - started, solved - prepared)


def _settings(case: Case) -> SolverSettings:
    """Return the method's numbers: bodies loaded by what follows them need a longer memory and bounded steps."""
    thickness = float(np.ptp(case.mesh.nodes, axis=0).min())
    window, limit = 10, 0.0
    if case.law is ConstitutiveLaw.RIGOROUS:
        window, limit = 20, 0.05 * thickness
    elif case.loads.follow_the_body or case.loads.dead is not None:
        window, limit = 30, 0.25 * thickness
    return SolverSettings(law=case.law, volume_shape=case.volume_shape, window=window, step_limit=limit)


def _thesis_state(solver: Solver, case: Case) -> ThesisState:
    if case.loads.dead is not None or case.loads.follow_the_body:
        raise GdfeError("the law 'thesis' takes prescribed displacements only: its forces have no meaning")
    known = [m for m in case.materials if isinstance(m, Linear | StressPolynomial)]
    if len(known) < len(case.materials):
        raise GdfeError("the law 'thesis' needs tangent moduli: linear or polynomial materials only")
    return ThesisState(solver, known)


def _solid_result(case: Case, found: March, newtons: float, prepare_s: float, solve_s: float) -> SimulationResult:
    last = found.last
    largest = float(np.linalg.norm(last.displacement, axis=1).max())
    held = {name: newtons * last.reaction[case.face(name)].sum(axis=0) for name in ("left", "right")}
    data: dict[str, object] = {
        "case": case.title,
        "law": str(case.law),
        "hexahedra": len(case.mesh.hexes),
        "completed": found.completed,
        "reason": found.reason,
        "share_of_load": found.shares[-1],
        "iterations": found.iterations,
        "residual": last.residual,
        "prepare_s": prepare_s,
        "solve_s": solve_s,
        "largest_displacement": largest,
        "unit": case.length_unit,
        "reaction_n": {name: force.tolist() for name, force in held.items()},
        "largest_strain": float(last.strain.max()),
    }
    rows = [
        ("law", f"{case.law}, {len(case.mesh.hexes)} hexahedra"),
        ("load reached", f"{100 * found.shares[-1]:.0f} %  {found.reason}".strip()),
        ("residual", f"{last.residual:.1e} of the reactions, {found.iterations} iterations"),
        ("time", f"{1e3 * prepare_s:.1f} ms to prepare, {1e3 * solve_s:.1f} ms to solve"),
        ("largest displacement", f"{largest:.4g} {case.length_unit}"),
        ("largest equivalent strain", f"{last.strain.max():.3f}"),
    ]
    rows += [(f"force on the {name} face", ", ".join(f"{f:.4g}" for f in force) + " N") for name, force in held.items()]
    acting, acting_data = _acting(case, last)
    rows += acting
    data.update(acting_data)
    joint = _material_border(case, last.displacement)
    if joint is not None:
        data["joint_share"] = joint
        rows.append(("joint of the materials", f"{100 * joint:.2f} % of the length"))
    reference = None
    if case.compare.reference:
        reference = reference_displacements(case.compare.reference)
        if reference.shape == case.mesh.nodes.shape and found.completed:
            mean, maximum = difference(last.displacement, reference)
            data["difference_to_calculix"] = {"mean": mean, "largest": maximum}
            rows.append(
                ("difference to CalculiX", f"mean {100 * mean:.2f} %, largest {100 * maximum:.2f} % of the largest")
            )
        else:
            reference = None
    rows += [(f"published: {what}", text) for what, text in case.compare.published.items()]
    warnings = warnings_of(case.mesh, case.materials, last.displacement, case.law)
    data["warnings"] = warnings
    rows += [("warning", text) for text in warnings]
    return SimulationResult(
        rows, data, case.mesh, last.displacement, last.strain, case.length_unit, reference, found.completed
    )


def _acting(case: Case, last: Equilibrium) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    """Return rows and data of what obstacles and cables do."""
    rows: list[tuple[str, str]] = []
    data: dict[str, Any] = {"contacts": [], "cables": []}
    for number, (obstacle, contact) in enumerate(zip(case.loads.around.obstacles, last.contacts, strict=True)):
        force = case.newtons * contact.total
        text = ", ".join(f"{f:.4g}" for f in force)
        touching, sliding = len(contact.nodes), int(contact.sliding.sum())
        rows.append((f"force of {obstacle.shape} {number}", f"{text} N on {touching} nodes, {sliding} of them sliding"))
        data["contacts"].append({"force_n": force.tolist(), "nodes": touching, "sliding": sliding})
    for number, (tension, shortening) in enumerate(zip(last.tension, last.shortening, strict=True)):
        ends = f"{tension[0]:.4g} N at the actuator, {tension[-1]:.4g} N at the anchor"
        rows.append((f"cable {number}", f"{ends}, shortened by {shortening:.4g} {case.length_unit}"))
        data["cables"].append({"tension_n": list(tension), "shortening": shortening})
    return rows, data


def _material_border(case: Case, displacement: Array) -> float | None:
    """Return where two materials meet along x, as a share of the deformed length; None unless there are two."""
    mesh = case.mesh
    if len(case.materials) != 2:
        return None
    shared = np.intersect1d(mesh.hexes[mesh.materials == 0], mesh.hexes[mesh.materials == 1])
    x = mesh.nodes[:, 0] + displacement[:, 0]
    left, right = x[case.face("left")].mean(), x[case.face("right")].mean()
    return float((x[shared].mean() - left) / (right - left)) if len(shared) else None


@dataclass(frozen=True, eq=False)
class SimulatedClosing:
    """A finger closed step by step, and what that took [s]."""

    path: ClosingPath
    shapes: list[ClosingShape]
    prepare_s: float

    @property
    def converged(self) -> list[ClosingShape]:
        """The shapes that are equilibria."""
        return [shape for shape in self.shapes if shape.converged]


def _finger(case: FingerCase, options: argparse.Namespace) -> SimulationResult:
    chosen = _checked_profile(case, options)
    finger, steps = Finger.from_profile(chosen, case.finger), options.steps or case.steps
    if steps < 1:
        raise GdfeError(f"--steps: expected 1 or more, found {steps}")
    pulls = case.pull_m * np.arange(1, steps + 1) / steps
    resolution = RESOLUTIONS[case.resolution].refined(options.refine)
    settings = ClosingSettings(resolution=resolution, travel_mm=1e3 * case.pull_m)
    shown = own = None
    if options.solid:
        size = ElementSize() if options.element_mm is None else ElementSize(largest_mm=options.element_mm)
        # the printed joint is the apex of its groove: the profile's mesh is compared as it would be printed
        depth_mm = 1e3 * chosen.finger(case.finger).body_height_m
        own = _closed(chosen, case, settings, pulls, mesh_finger(finger, resolution, depth_mm, strip_below=0.0))
        # each shape is a keyframe: a solve of a solid takes seconds
        settings = replace(settings, keyframe_mm=min(1e3 * case.pull_m / steps, MAX_SOLID_STEP_MM), max_iterations=1000)
        shown = _closed(chosen, case, settings, pulls, mesh_solid(options.solid, finger, size))
    shown = shown or _closed(chosen, case, settings, pulls)
    return _finger_result(case, shown, own, close(finger, assumed_friction(chosen).law, 1e3 * pulls))


def _checked_profile(case: FingerCase, options: argparse.Namespace) -> profile.Profile:
    if options.law and options.law != ConstitutiveLaw.CALIBRATED:
        raise GdfeError(f"a finger is computed with the law 'calibrated', found {options.law!r}")
    if case.resolution not in RESOLUTIONS:
        raise GdfeError(f"finger.resolution: expected one of {', '.join(RESOLUTIONS)}, found {case.resolution!r}")
    profiles = profile.load_directory(options.profiles or profile.shipped_directory())
    if case.profile not in profiles:
        raise GdfeError(f"finger.profile: expected one of {', '.join(sorted(profiles))}, found {case.profile!r}")
    return profiles[case.profile]


def _closed(
    chosen: profile.Profile, case: FingerCase, settings: ClosingSettings, pulls: Array, mesh: FingerMesh | None = None
) -> SimulatedClosing:
    started = time.perf_counter()
    body = Body(chosen, case.finger, settings.resolution, finger_mesh=mesh)
    path = ClosingPath(chosen, case.finger, settings, body=body)
    path.keyframes.cover(1e3 * case.pull_m)
    prepared = time.perf_counter()
    return SimulatedClosing(path, [path.shape(float(pull)) for pull in pulls], prepared - started)


def _finger_result(
    case: FingerCase, shown: SimulatedClosing, own: SimulatedClosing | None, rigid: Solution
) -> SimulationResult:
    """Return what a closing gave, beside the profile's own mesh where it is that of a solid."""
    states = [
        {
            "pulled_length_m": shape.pulled_length_m,
            "tip_m": shape.tip.tolist(),
            "tension_n": list(shape.tension),
            "converged": shape.converged,
            "iterations": shape.iterations,
            "solve_s": shape.solve_time,
            "pseudo_rigid_tip_m": (1e-3 * rigid.tip_mm[0, k]).tolist(),
            "pseudo_rigid_tension_n": float(rigid.tension_n[0, k, 0]),
        }
        for k, shape in enumerate(shown.shapes)
    ]
    for state, shape in zip(states, own.shapes if own else [], strict=False):
        state |= {"own_mesh_tip_m": shape.tip.tolist(), "own_mesh_tension_n": shape.tension[0]}
    path, reached = shown.path, shown.converged
    if not reached:
        raise GdfeError(f"no shape converged; the first: {shown.shapes[0].reason}")
    last = reached[-1]
    data = {"case": case.title, "hexahedra": path.hexahedra, "prepare_s": shown.prepare_s, "states": states}
    rows = [
        ("mesh", f"{path.hexahedra} hexahedra, {1e3 * shown.prepare_s:.0f} ms for the keyframes"),
        ("converged up to", f"{1e3 * last.pulled_length_m:.1f} mm of {1e3 * case.pull_m:.1f} mm pulled"),
        ("time of a shape", f"median {1e3 * float(np.median([s.solve_time for s in reached])):.1f} ms"),
    ]
    for state in states[max(0, len(states) // 5 - 1) :: max(1, len(states) // 5)]:
        others = {"predictor": (state["pseudo_rigid_tip_m"], state["pseudo_rigid_tension_n"])}
        if own:
            others = {"profile's mesh": (state["own_mesh_tip_m"], state["own_mesh_tension_n"])} | others
        ours = f"tip {_place(state['tip_m'], state['tension_n'][0])}"
        texts = [ours, *(f"{name} {_place(tip, tension)}" for name, (tip, tension) in others.items())]
        rows.append((f"pulled {1e3 * state['pulled_length_m']:.1f} mm", "; ".join(texts)))
    mesh = path.finger_mesh.mesh
    displacement = 1e3 * last.vertices - mesh.nodes
    return SimulationResult(rows, data, mesh, displacement, last.strain, "mm", None, len(reached) == len(shown.shapes))


def _place(tip_m: Sequence[float], tension_n: float) -> str:
    return f"{1e3 * tip_m[0]:.1f}, {1e3 * tip_m[1]:.1f} mm at {tension_n:.2f} N"


if __name__ == "__main__":
    sys.exit(main())
