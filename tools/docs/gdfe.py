# SPDX-License-Identifier: Apache-2.0
"""Writes docs/gdfe.md and its figure: what GDFE reproduces of the thesis, beside CalculiX, and what it does not.

`render()` is the text; a test compares it with the committed file, so that no number in it can grow old.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from string import Template
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq

from softgrip_model.finger import Finger, MomentLaw, Strip, close
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe import ConstitutiveLaw, Mesh, Ogden, Solver, SolverSettings, Supports, VolumeShape, bar
from softgrip_model.gdfe.closing import ClosingPath, ClosingSettings, ClosingShape
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, Resolution
from softgrip_model.gdfe.march import Loading, March, march
from softgrip_model.gdfe.materials import (
    Linear,
    SolidMaterial,
    StressPolynomial,
    cheetah,
    cheetah_ogden,
    ninjaflex,
    ninjaflex_ogden,
)
from softgrip_model.gdfe.solver import Metric
from softgrip_model.gdfe.thesis import (
    ThesisState,
    force_unit,
    geometric_ratio_published,
    material_constants,
    shape_factors_closed_form,
    shape_factors_published,
    stiffness_ratio,
)
from softgrip_model.gdfe.thesis_bars import BarCase, difference, five_materials, joint_position, rotation, tension
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.calculix_cable import ClosedFinger, calculix_closings, closing_of, our_closing
from softgrip_testing.calculix_finger import calculix_moments, our_moments, reference_closing
from softgrip_testing.calculix_flexures import MODULUS_MPA

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
TEMPLATE = Path(__file__).with_name("gdfe.md.in")
FORCE_INCREMENTS = (5, 10, 20, 50)
RIGOROUS = SolverSettings(law=ConstitutiveLaw.RIGOROUS, window=20, step_limit=1.0)


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _calibration_rows() -> str:
    rows = []
    for ratio in (10.0, 30.0, 90.0):
        fitted = brentq(lambda r, ratio=ratio: float(geometric_ratio_published(np.array(r))) - ratio, 1.0, 100.0)
        exact = float(stiffness_ratio(np.array(0.9), np.array(0.9 / ratio)))
        rows.append(_row(f"{ratio:.0f}", f"{fitted:.2f}", f"{exact:.2f}"))
    return "\n".join(rows)


def _tension_row(label: str, joint: float) -> str:
    """One row of Table 5.2: the bar's halves of length 1 are drawn to 4 joint and 4 (1 - joint)."""
    return _row(label, f"{100 * joint:.2f}", f"{100 * (4 * joint - 1):.1f}", f"{100 * (4 * (1 - joint) - 1):.1f}")


def _one_dimensional(left: SolidMaterial, right: SolidMaterial) -> float:
    def unbalance(stretch: float) -> float:
        return float(left.nominal_stress(np.array(stretch)) - right.nominal_stress(np.array(4.0 - stretch)))

    return float(brentq(unbalance, 1.05, 1.9)) / 4.0


@functools.cache
def _thesis_tension(shape: VolumeShape, increments: int, hyperelastic: bool = True) -> tuple[float, float]:
    """Return joint and support force [N]-like of the thesis law."""
    materials = (cheetah(), ninjaflex())
    case, used = tension(materials=materials)
    metric = Metric.CENTRING if hyperelastic else Metric.LAPLACIAN
    settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=shape, metric=metric, step_limit=1.0)
    solver = Solver(case.mesh, used, case.supports, settings=settings)
    state = ThesisState(solver, materials, shape_factors_published, previous_shape=hyperelastic, update=hyperelastic)
    found = _completed(
        march(solver, case.loading, increments, tolerance=1e-7, first_guess=case.first_guess, before=state.before)
    )
    force = -found.last.reaction[case.left, 0].sum() * force_unit(state.moduli, state.omega)
    return joint_position(case, found.last.displacement), float(force)


def _completed(found: March) -> March:
    if not found.completed:
        raise RuntimeError(found.reason)
    return found


def _marched(case: BarCase, materials: Sequence[SolidMaterial], settings: SolverSettings, increments: int) -> March:
    solver = Solver(case.mesh, materials, case.supports, settings=settings)
    return _completed(march(solver, case.loading, increments, tolerance=1e-7, first_guess=case.first_guess))


def _tension_rows() -> str:
    rows = [
        _tension_row("one-dimensional, polynomials", _one_dimensional(cheetah(), ninjaflex())),
        _tension_row("one-dimensional, Ogden", _one_dimensional(cheetah_ogden(), ninjaflex_ogden())),
    ]
    rows += [
        _tension_row(f"thesis law, linear, {shape}", _thesis_tension(shape, 1, hyperelastic=False)[0])
        for shape in VolumeShape
    ]
    for shape in VolumeShape:
        rows += [
            _tension_row(f"thesis law, {n} increments, {shape}", _thesis_tension(shape, n)[0]) for n in (5, 10, 20)
        ]
    choices: list[tuple[str, tuple[SolidMaterial, ...], SolverSettings, float, int]] = [
        ("calibrated, polynomials, nu = 0.45", (cheetah(), ninjaflex()), SolverSettings(), 0.45, 2),
        ("calibrated, Ogden, nu = 0.45", (), SolverSettings(), 0.45, 2),
        ("calibrated, Ogden, nu = 0.49", (), SolverSettings(), 0.49, 2),
        ("rigorous, Ogden, nu = 0.49", (), RIGOROUS, 0.49, 10),
    ]
    for label, materials, settings, poisson, increments in choices:
        case, used = tension(materials=materials, poisson=poisson)
        found = _marched(case, used, settings, increments)
        rows.append(_tension_row(label, joint_position(case, found.last.displacement)))
    return "\n".join(rows)


#: What the calibrated law was not calibrated by: axes that are held, stretch along those that are drawn.
_STATES = (
    ("uniaxial tension, stretch 1.3", "", "x", 1.3),
    ("planar, stretch 1.3", "y", "x", 1.3),
    ("both ways, stretch 1.3", "", "xy", 1.3),
    ("compression, stretch 0.8", "", "x", 0.8),
)


def _homogeneous_stress(material: Ogden, law: ConstitutiveLaw, *, held: str, drawn: str, stretch: float) -> float:
    """Return the nominal stress along x [MPa] of a block whose faces stay plane, those of the other axes free."""
    mesh = bar((2.0, 2.0, 2.0), (2, 2, 2))
    ends = {axis: _ends_along(mesh, number) for number, axis in enumerate("xyz")}
    supports = Supports.none(len(mesh.nodes))
    for axis, (low, high) in ends.items():
        supports = supports.with_prescribed(low, axis)
        if axis in held + drawn:
            supports = supports.with_prescribed(high, axis)
    moved = np.zeros_like(mesh.nodes)
    for axis in drawn:
        moved[ends[axis][1], "xyz".index(axis)] = 2.0 * (stretch - 1.0)
    solver = Solver(mesh, [material], supports, settings=SolverSettings(law=law))
    found = _completed(march(solver, lambda share: Loading(share * moved), 10, tolerance=1e-8))
    return float(found.last.reaction[ends["x"][1], 0].sum()) / 4.0


def _ends_along(mesh: Mesh, axis: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    place = mesh.nodes[:, axis]
    return mesh.nodes_where(place == place.min()), mesh.nodes_where(place == place.max())


def _shear_stress(material: Ogden, law: ConstitutiveLaw, shear: float = 0.3) -> float:
    """Return the nominal shear stress of a block in simple shear [MPa]."""
    mesh = bar((2.0, 2.0, 2.0), (2, 2, 2))
    supports = Supports.none(len(mesh.nodes)).with_prescribed(np.arange(len(mesh.nodes), dtype=np.int32))
    solver = Solver(mesh, [material], supports, settings=SolverSettings(law=law))
    moved = np.zeros_like(mesh.nodes)
    moved[:, 0] = shear * mesh.nodes[:, 1]
    return float(solver.internal_force(moved)[_ends_along(mesh, 1)[1], 0].sum()) / 4.0


def _limit_rows() -> str:
    def apart(stress: Callable[[Ogden, ConstitutiveLaw], float]) -> list[str]:
        found = []
        for material in (ninjaflex_ogden(0.45), cheetah_ogden(0.45)):
            calibrated = stress(material, ConstitutiveLaw.CALIBRATED)
            rigorous = stress(material, ConstitutiveLaw.RIGOROUS)
            found.append(f"{round(100.0 * (calibrated / rigorous - 1.0)) + 0:+d} %")
        return found

    rows = [
        _row(name, *apart(functools.partial(_homogeneous_stress, held=held, drawn=drawn, stretch=stretch)))
        for name, held, drawn, stretch in _STATES
    ]
    return "\n".join("  " + row for row in [*rows, _row("simple shear, 0.3", *apart(_shear_stress))])


def _bend_rows() -> str:
    rows = []
    case, materials = five_materials()
    reference = case.reference()
    moving = np.linalg.norm(reference, axis=1) > 1e-9

    def row(label: str, displacement: Array, force: float) -> str:
        mean, largest = difference(displacement, reference)
        gap = np.linalg.norm(displacement - reference, axis=1)[moving] / np.linalg.norm(reference, axis=1)[moving]
        return _row(label, f"{100 * mean:.2f}", f"{100 * largest:.2f}", f"{100 * gap.mean():.1f}", f"{force:.3f}")

    linear = [material for material in materials if isinstance(material, Linear)]
    for shape in VolumeShape:
        for name, factors in (("Eqs 5.7, 5.8", shape_factors_published), ("closed form", shape_factors_closed_form)):
            settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=shape)
            solver = Solver(case.mesh, materials, case.supports, settings=settings)
            state = ThesisState(solver, linear, factors, previous_shape=False, update=False)
            found = _completed(march(solver, case.loading, 1, tolerance=1e-7, before=state.before))
            force = found.last.reaction[case.right, 1].sum() * force_unit(state.moduli, state.omega)
            rows.append(row(f"thesis law, {name}, {shape}", found.last.displacement, force))
    for shape in VolumeShape:
        found = _marched(case, materials, SolverSettings(volume_shape=shape), 1)
        force = found.last.reaction[case.right, 1].sum()
        rows.append(row(f"calibrated, nu = 0.3, {shape}", found.last.displacement, force))
    return "\n".join(rows)


def _rotation_rows() -> str:
    rows = []

    def row(label: str, case: BarCase, found: March) -> str:
        mean, largest = difference(found.last.displacement, case.reference())
        return _row(label, f"{100 * mean:.2f}", f"{100 * largest:.2f}")

    thesis: tuple[StressPolynomial, StressPolynomial] = (cheetah(), ninjaflex())
    for shape in VolumeShape:
        case, _ = rotation()
        settings = SolverSettings(law=ConstitutiveLaw.THESIS, volume_shape=shape, metric=Metric.CENTRING)
        solver = Solver(case.mesh, thesis, case.supports, settings=settings)
        state = ThesisState(solver, thesis, shape_factors_published)
        found = _completed(march(solver, case.loading, 10, tolerance=1e-6, before=state.before, max_iterations=5000))
        rows.append(row(f"thesis law, 10 increments, {shape}", case, found))
    case, materials = rotation()
    rows.append(row("calibrated, Ogden, nu = 0.45", case, _marched(case, materials, SolverSettings(), 5)))
    case, materials = rotation(poisson=0.49)
    rows.append(row("rigorous, Ogden, nu = 0.49", case, _marched(case, materials, RIGOROUS, 10)))
    return "\n".join(rows)


@functools.cache
def _calibrated_force(increments: int) -> float:
    case, used = tension(materials=(cheetah(), ninjaflex()))
    found = _marched(case, used, SolverSettings(), increments)
    return float(-found.last.reaction[case.left, 0].sum())


@functools.cache
def _fingers() -> tuple[tuple[str, float, ClosingShape, Array, float, float], ...]:
    """Return design, pulled length [mm], our shape, the kernel's tip [mm] and tension [N], the finger's length [mm]."""
    found = []
    pulls_mm = np.array([5.0, 10.0, 15.0, 18.0])
    for name, profile in sorted(load_directory(shipped_directory()).items()):
        finger = Finger.from_profile(profile, "index")
        kernel = close(finger, assumed_friction(profile).law, pulls_mm)
        closing = ClosingPath(profile, "index", ClosingSettings(RESOLUTIONS["fine"], travel_mm=19.0, tolerance=1e-5))
        for k, pull in enumerate(pulls_mm):
            shape = closing.shape(1e-3 * pull)
            other = kernel.tip_mm[0, k], float(kernel.tension_n[0, k, 0])
            found.append((name, float(pull), shape, *other, finger.length_from_joint_mm))
    return tuple(found)


def _finger_rows() -> str:
    rows = []
    for name, pull, shape, other, kernel_n, length in _fingers():
        tip = 1e3 * shape.tip[:2]
        rows.append(
            _row(
                name,
                f"{pull:.0f}",
                f"{tip[0]:.1f}, {tip[1]:.1f}" if shape.converged else "not converged",
                f"{other[0]:.1f}, {other[1]:.1f}",
                f"{100 * float(np.linalg.norm(tip - other)) / length:.1f}",
                f"{shape.tension[0]:.2f}",
                f"{kernel_n:.2f}",
            )
        )
    return "\n".join(rows)


class _Beside(NamedTuple):
    """One finger at one pulled length: in CalculiX by element type, in our mesh, and in the kernel (mode F)."""

    design: str
    pulled_mm: float
    calculix: dict[str, ClosedFinger]
    mesh: ClosedFinger
    kernel_tip_mm: Array
    length_mm: float


@functools.cache
def _beside_calculix() -> tuple[_Beside, ...]:
    theirs, found = calculix_closings(), []
    profiles = load_directory(shipped_directory())
    for design in sorted({key[0] for key in theirs}):
        closing = closing_of(design)
        finger = dataclasses.replace(
            Finger.from_profile(profiles[design], "index"), strip=Strip((0.0, 0.0, MODULUS_MPA), MomentLaw.LINEAR)
        )
        pulls = sorted({key[2] for key in theirs if key[0] == design})
        kernel = close(finger, assumed_friction(profiles[design]).law, np.array(pulls))
        for k, pull in enumerate(pulls):
            calculix = {element: theirs[design, element, pull] for element in ("C3D8", "C3D8I")}
            ours = our_closing(closing, pull)
            found.append(_Beside(design, pull, calculix, ours, kernel.tip_mm[0, k], finger.length_from_joint_mm))
    return tuple(found)


def _calculix_rows() -> str:
    rows = []
    for one in _beside_calculix():
        solid, incompatible = one.calculix["C3D8"], one.calculix["C3D8I"]
        if not np.isfinite(solid.tension_n):
            rows.append(_row(one.design, f"{one.pulled_mm:g}", *["not converged"] * 7))
            continue
        gaps = [
            100.0 * float(np.linalg.norm(tip - solid.tip_mm)) / one.length_mm
            for tip in (one.mesh.tip_mm, incompatible.tip_mm, one.kernel_tip_mm)
        ]
        joint = float(np.degrees(np.abs(one.mesh.joint_rad - solid.joint_rad).max()))
        tensions = (one.mesh.tension_n, solid.tension_n, incompatible.tension_n)
        cells = [f"{solid.tip_mm[0]:.1f}, {solid.tip_mm[1]:.1f}", *(f"{gap:.1f}" for gap in gaps), f"{joint:.1f}"]
        cells += [" / ".join(f"{tension:.2f}" for tension in tensions)]
        rows.append(_row(one.design, f"{one.pulled_mm:g}", *cells).replace("nan", "not converged"))
    return "\n".join(rows)


def _strip_rows() -> str:
    theirs, closing, rows = calculix_moments(), reference_closing(), []
    for pull in (4.0, 8.0, 12.0):
        ours = our_moments(closing, pull)
        cells = [f"{a:.2f} / {b:.2f}" for a, b in zip(-ours, -theirs[pull], strict=True)]
        apart = ", ".join(f"{100 * (a / b - 1):.1f}" for a, b in zip(ours, theirs[pull], strict=True))
        rows.append(_row(f"{pull:g}", *cells, apart))
    return "\n".join(rows)


def _refinement() -> tuple[str, str]:
    """Return the rows of the refinement study and the observed order p of |tip(h) - tip| ~ h^p, h = 1, 2/3, 1/2."""
    profile = load_directory(shipped_directory())["power"]
    rows, tips = [], []
    for parts in (2, 3, 4):
        resolution = Resolution(*(count * parts // 2 for count in (6, 2, 4, 4, 4)))
        settings = ClosingSettings(resolution, travel_mm=8.0, keyframe_mm=2.0, tolerance=1e-6, max_iterations=4000)
        closing = ClosingPath(profile, "index", settings)
        shape = closing.shape(0.008)
        tips.append(1e3 * shape.tip[:2])
        rows.append(_row(f"{closing.hexahedra}", f"{tips[-1][0]:.2f}", f"{tips[-1][1]:.2f}", f"{shape.tension[0]:.2f}"))
    ratio = float(np.linalg.norm(tips[1] - tips[0]) / np.linalg.norm(tips[2] - tips[1]))

    def gap(p: float) -> float:
        return (1.0 - (2.0 / 3.0) ** p) / ((2.0 / 3.0) ** p - 0.5**p) - ratio

    order = f"{brentq(gap, 0.1, 6.0):.1f}" if gap(0.1) * gap(6.0) < 0.0 else "not in its asymptotic range"
    return "\n".join(rows), order


@functools.cache
def render() -> str:
    """Return the text of docs/gdfe.md."""
    refinement_rows, order = _refinement()
    values = {
        "nu_01": f"{material_constants(0.1)[1]:.2f}",
        "nu_09": f"{material_constants(0.9)[1]:.2f}",
        "calibration_rows": _calibration_rows(),
        "tension_rows": _tension_rows(),
        "bend_rows": _bend_rows(),
        "rotation_rows": _rotation_rows(),
        "limit_rows": _limit_rows(),
        "thesis_forces": " | ".join(f"{_thesis_tension(VolumeShape.PROJ, n)[1]:.0f}" for n in FORCE_INCREMENTS),
        "calibrated_forces": " | ".join(f"{_calibrated_force(n):.0f}" for n in FORCE_INCREMENTS),
        "finger_hexes": "2,088",
        "finger_rows": _finger_rows(),
        "calculix_rows": _calculix_rows(),
        "strip_rows": _strip_rows(),
        "refinement_rows": refinement_rows,
        "order": order,
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values)


def draw(folder: Path) -> None:
    """Draw the figures into a folder."""
    mpl.use("Agg")
    _draw_forces(folder / "gdfe_forces.png")
    _draw_fingers(folder / "gdfe_fingers.png")
    _draw_calculix(folder / "gdfe_calculix.png")


def _draw_forces(path: Path) -> None:
    figure = Figure(figsize=(6.0, 3.5), layout="constrained")
    axes = figure.add_subplot()
    for shape in VolumeShape:
        forces = [_thesis_tension(shape, n)[1] for n in FORCE_INCREMENTS]
        axes.loglog(FORCE_INCREMENTS, forces, "o-", label=f"thesis law, {shape}")
    axes.loglog(FORCE_INCREMENTS, [_calibrated_force(n) for n in FORCE_INCREMENTS], "s-", label="calibrated law")
    axes.set(xlabel="increments to 100 % elongation", ylabel="support force [N]")
    axes.set_xticks(FORCE_INCREMENTS, [str(n) for n in FORCE_INCREMENTS])
    axes.minorticks_off()
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def _draw_fingers(path: Path) -> None:
    """Tips as the fingers close, of mesh and predictor."""
    figure = Figure(figsize=(6.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for colour, design in zip(("C0", "C1", "C2"), sorted({row[0] for row in _fingers()}), strict=True):
        own = [row for row in _fingers() if row[0] == design and row[2].converged]
        tips, others = np.array([1e3 * row[2].tip[:2] for row in own]), np.array([row[3] for row in own])
        axes.plot(*tips.T, "o-", color=colour, label=f"{design}, mesh")
        axes.plot(*others.T, "x--", color=colour, label=f"{design}, predictor")
    axes.set(xlabel="tip x [mm]", ylabel="tip y [mm]", aspect="equal")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _draw_calculix(path: Path) -> None:
    """Tips as the fingers close, of CalculiX, our mesh and the predictor."""
    figure = Figure(figsize=(6.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for colour, design in zip(("C0", "C1", "C2"), sorted({one.design for one in _beside_calculix()}), strict=True):
        own = [one for one in _beside_calculix() if one.design == design]
        for style, name, tips in (
            ("s", "CalculiX C3D8", [one.calculix["C3D8"].tip_mm for one in own]),
            ("^", "CalculiX C3D8I", [one.calculix["C3D8I"].tip_mm for one in own]),
            (".-", "mesh", [one.mesh.tip_mm for one in own]),
            ("x--", "predictor", [one.kernel_tip_mm for one in own]),
        ):
            axes.plot(*np.array(tips).T, style, color=colour, fillstyle="none", label=f"{design}, {name}")
    axes.set(xlabel="tip x [mm]", ylabel="tip y [mm]", aspect="equal")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize="x-small")
    figure.savefig(path, dpi=120)


def main() -> None:
    """Write the document and its figure."""
    figures = ROOT / "docs" / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    draw(figures)
    (ROOT / "docs" / "gdfe.md").write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
