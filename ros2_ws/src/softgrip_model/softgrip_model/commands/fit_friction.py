# SPDX-License-Identifier: Apache-2.0
"""fit_friction: friction laws fitted to measured points, with how far to trust them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from softgrip_model.friction.calibration import Calibration, SurfacePair, calibrate
from softgrip_model.friction.comparison import Comparison, compare, spread_points
from softgrip_model.friction.csv_file import read_csv
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.figures import draw_fits, draw_residuals
from softgrip_model.friction.fit import Loss
from softgrip_model.friction.laws import KReading, Law
from softgrip_model.friction.measurements import Measurements
from softgrip_model.friction.model_file import to_mapping, write_model
from softgrip_model.friction.record import ModelVerdict

EPILOG = """\
The file: one header, one row a point, columns found by name in any order:
  angle [deg] (or [rad]), load [g] (or [kg]) or T2 [N], and T1 [N] or ratio
  e.g.  angle [deg], load [g], T1 [N]
        10, 200, 2.41

exit code: 0 when every model is usable, 1 when one is not, 2 for a file that cannot be used.

examples:
  fit_friction braid_tpu.csv --cable "PE braid 0.25 mm" --surface "TPU printed" --out fits/
  fit_friction braid_tpu.csv --model matte --points 9 --json
"""


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="fit_friction", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("data", type=Path, metavar="DATA.csv", help="measured points")
    made.add_argument("--model", choices=(*Law, "all"), default="all", help="law to fit (default: %(default)s)")
    made.add_argument(
        "--points",
        type=int,
        metavar="N",
        help="fit to N points spread over the file (4, 9, 16, ...) and judge on all: what fewer points would have cost",
    )
    made.add_argument("--out", type=Path, metavar="DIR", help="write models (YAML) and figures here")
    made.add_argument("--cable", default="cable", help="name, kept in the model (default: %(default)s)")
    made.add_argument("--surface", default="surface", help="name, kept in the model (default: %(default)s)")
    made.add_argument(
        "--cable-radius", type=float, default=0.125, metavar="MM", help="[mm] (default: %(default)s, the braid)"
    )
    made.add_argument("--surface-radius", type=float, default=3.0, metavar="MM", help="[mm] (default: %(default)s)")
    made.add_argument(
        "--k-reading",
        choices=tuple(KReading),
        default=KReading.PRINTED,
        help="reading of K in Eq 3.8: as printed, its limit 0, or the exact integral (default: %(default)s)",
    )
    made.add_argument(
        "--loss", choices=tuple(Loss), default=Loss.RELATIVE, help="residuals of ln Rf or of Rf (default: %(default)s)"
    )
    made.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    options = parser().parse_args(args)
    errors = Console(stderr=True)
    try:
        points = read_csv(options.data)
        chosen = points if options.points is None else points.subset(spread_points(points, options.points))
        laws = list(Law) if options.model == "all" else [Law(options.model)]
        pair = SurfacePair(options.cable, options.surface, 1e-3 * options.cable_radius, 1e-3 * options.surface_radius)
        reading, loss = KReading(options.k_reading), Loss(options.loss)
        found, compared = {}, {}
        for law in laws:
            with errors.status(f"fitting {law} to {len(chosen)} points"):
                found[law] = calibrate(chosen, pair, law, k_reading=reading, loss=loss)
            if options.points is not None:
                with errors.status(f"fitting {law} to all {len(points)} points"):
                    compared[law] = compare(
                        points, law, radius_mm=pair.radius_mm, count=options.points, k_reading=reading
                    )
        written = []
        if options.out:
            with errors.status(f"drawing into {options.out}"):
                written = _write(found, options.out)
    except (FrictionError, OSError) as error:
        errors.print(f"[red]fit_friction:[/red] {escape(str(error))}")
        return 2
    for warning in points.warnings:
        errors.print(f"[yellow]warning:[/yellow] {escape(warning)}")
    if options.json:
        print(json.dumps(_as_mapping(found, compared, points, written), indent=2))
    else:
        _print(found, compared, written)
    usable = all(c.model.verdict is ModelVerdict.USABLE for c in found.values())
    return 0 if usable else 1


def _write(found: dict[Law, Calibration], folder: Path) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for law, calibration in found.items():
        path = folder / f"{law}.yaml"
        write_model(calibration.model, path)
        written.append(path)
    fits = {law: calibration.fit for law, calibration in found.items()}
    model = next(iter(found.values())).model
    draw_fits(fits, folder / "fit.png", f"{model.cable} on {model.surface}")
    draw_residuals(fits, folder / "residuals.png")
    return [*written, folder / "fit.png", folder / "residuals.png"]


def _as_mapping(
    found: dict[Law, Calibration], compared: dict[Law, Comparison], points: Measurements, written: list[Path]
) -> dict[str, object]:
    models = {}
    for law, calibration in found.items():
        judged = calibration.assessment
        lack = judged.lack_of_fit
        models[str(law)] = to_mapping(calibration.model) | {
            "widest_interval": _number(judged.widest_interval),
            "condition": _number(calibration.fit.condition),
            "at_bound": list(calibration.fit.at_bound),
            "outliers": [calibration.fit.points.labels[i] for i in judged.outliers],
            "influential": [calibration.fit.points.labels[i] for i in judged.influential],
            "lack_of_fit": None if lack is None else {"method": lack.method, "p_value": _number(lack.p_value)},
        }
        if law in compared:
            c = compared[law]
            models[str(law)]["on_all_points"] = {
                "average_error": c.average_error,
                "maximum_error": c.maximum_error,
                "r_squared": _number(c.r_squared),
                "coefficients_of_all": c.full.law.by_name,
            }
    return {
        "data": points.source,
        "points": len(points),
        "warnings": list(points.warnings),
        "models": models,
        "written": [str(path) for path in written],
    }


def _print(found: dict[Law, Calibration], compared: dict[Law, Comparison], written: list[Path]) -> None:
    console = Console()
    table = Table(title=f"{next(iter(found.values())).fit.points.source}", pad_edge=False)
    coefficients = "coefficients\n(standard deviation)"
    for column in ("law", coefficients, "average", "maximum", "R2", "95 % within", "verdict"):
        table.add_column(column, no_wrap=column == coefficients)
    for law, calibration in found.items():
        fit, judged = calibration.fit, calibration.assessment
        table.add_row(
            str(law),
            _coefficients(calibration),
            f"{fit.average_error:.2%}",
            f"{fit.maximum_error:.2%}",
            f"{fit.r_squared:.3f}",
            f"{judged.widest_interval:.1%}" if np.isfinite(judged.widest_interval) else "unknown",
            str(calibration.model.verdict),
        )
    console.print(table)
    for law, calibration in found.items():
        console.print(f"{law}: {escape(calibration.model.reason)}")
        lack = calibration.assessment.lack_of_fit
        if lack is not None:
            console.print(f"  lack of fit ({lack.method}): p = {lack.p_value:.3f}")
        if law in compared:
            c = compared[law]
            average, maximum = (
                f"{few:.2%} ({100 * (few - full):+.2f} points)"
                for few, full in ((c.average_error, c.full.average_error), (c.maximum_error, c.full.maximum_error))
            )
            console.print(
                f"  on all {len(c.full.points)} points: average {average}, maximum {maximum} against a fit to all"
            )
    for path in written:
        console.print(f"wrote {escape(str(path))}")


def _coefficients(calibration: Calibration) -> str:
    fit = calibration.fit
    stddev = np.full(len(fit.law.names), np.nan) if fit.covariance is None else np.sqrt(np.diag(fit.covariance))
    parts = zip(fit.law.names, fit.law.coefficients, stddev, strict=True)
    return "\n".join(f"{name} {value:.4f}" + (f" ({s:.4f})" if np.isfinite(s) else "") for name, value, s in parts)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


if __name__ == "__main__":
    sys.exit(main())
