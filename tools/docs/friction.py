# SPDX-License-Identifier: Apache-2.0
"""Writes docs/friction.md and its figures: the friction laws, the thesis' tables beside what synthetic data give.

`render()` is the text; a test compares it with the committed file, so that no number in it can grow old.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.comparison import compare, spread_points
from softgrip_model.friction.design import efficiency, optimal_design
from softgrip_model.friction.figures import draw_fits, draw_residuals
from softgrip_model.friction.fit import capstan_per_load, errors, fit
from softgrip_model.friction.laws import GRAVITY, FrictionLaw, KReading, LambdaSign, Law
from softgrip_model.friction.measurements import Measurements, measurements
from softgrip_model.friction.published import TABLE_3_2, published

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
TEMPLATE = Path(__file__).with_name("friction.md.in")

ANGLES, TENSIONS = (
    a.ravel() for a in np.meshgrid(np.radians(np.arange(10, 91, 10)), GRAVITY * np.array([0.2, 0.4, 0.6, 0.8, 1.0]))
)
DRAWS = 20
NAMES = {"twine-tpu": "Twine & TPU", "twine-pla": "Twine & PLA", "braid-tpu": "Braid & TPU", "braid-pla": "Braid & PLA"}
#: Table 3.1: average error [%], maximum error [%], R2 of Capstan (one mu a load), Heap et al., Matte.
TABLE_3_1 = {
    "twine-tpu": ((4.10, 12.26, 0.902), (4.12, 12.32, 0.902), (2.20, 6.26, 0.966)),
    "twine-pla": ((4.59, 12.56, 0.754), (4.60, 12.59, 0.751), (2.55, 7.73, 0.925)),
    "braid-tpu": ((3.69, 9.95, 0.637), (3.72, 10.00, 0.628), (1.67, 5.09, 0.914)),
    "braid-pla": ((2.13, 7.55, 0.726), (2.19, 7.42, 0.704), (1.07, 3.32, 0.925)),
}
#: Table 3.3: change of average error, maximum error [points] and R2 with nine points.
TABLE_3_3 = {
    "twine-tpu": (-0.04, 0.64, 0.001),
    "twine-pla": (0.39, 1.88, -0.033),
    "braid-tpu": (0.20, 0.06, -0.026),
    "braid-pla": (0.21, 1.02, -0.030),
}
Errors = tuple[float, float, float]


def synthetic(law: FrictionLaw, noise: float) -> Iterator[Measurements]:
    """Yield 45-point data sets of a law, the same scatter for every law and noise."""
    for draw in range(DRAWS):
        scatter = np.random.default_rng(draw).standard_normal(len(ANGLES))
        ratio = np.maximum(law.ratio(ANGLES, TENSIONS) * np.exp(noise * scatter), 0.98)
        yield measurements(ANGLES, TENSIONS, ratio * TENSIONS)


def truth(pair: str, sign: LambdaSign) -> FrictionLaw:
    """Return a published law without its calibrated range."""
    unbounded = (-math.inf, math.inf)
    return dataclasses.replace(published(pair, sign).law, angle_range=unbounded, tension_range=unbounded)


def matte_errors(points: Measurements, radius_mm: float) -> Errors:
    """Return the errors of a Matte fit to the points it was made from."""
    found = fit(points, Law.MATTE, radius_mm=radius_mm)
    return found.average_error, found.maximum_error, found.r_squared


def heap_errors(points: Measurements, radius_mm: float) -> Errors:
    """Return the errors of a fit of Heap et al."""
    found = fit(points, Law.HEAP, radius_mm=radius_mm)
    return found.average_error, found.maximum_error, found.r_squared


def capstan_errors(points: Measurements, _: float) -> Errors:
    """Return the errors of Capstan with one mu for each load."""
    loads, mu = capstan_per_load(points)
    own = mu[np.searchsorted(loads, points.tension_low)]
    return errors(np.exp(own * points.angle), points.ratio)


LAWS = (capstan_errors, heap_errors, matte_errors)


@cache
def noise_for(pair: str, sign: LambdaSign) -> float:
    """Return the relative noise [1] at which the Matte fit has Table 3.1's R2 on average (bisection)."""
    law, expected = truth(pair, sign), TABLE_3_1[pair][2][2]
    low, high = 0.001, 0.2
    for _ in range(14):
        middle = 0.5 * (low + high)
        found = np.mean([matte_errors(points, law.radius_mm)[2] for points in synthetic(law, middle)])
        low, high = (middle, high) if found > expected else (low, middle)
    return 0.5 * (low + high)


@cache
def reproduced(pair: str, sign: LambdaSign) -> tuple[Errors, ...]:
    """Return Table 3.1's row from synthetic data: mean errors of the three laws."""
    law = truth(pair, sign)
    data = list(synthetic(law, noise_for(pair, sign)))
    rows = [np.mean([of(points, law.radius_mm) for points in data], axis=0) for of in LAWS]
    return tuple((float(average), float(maximum), float(r_squared)) for average, maximum, r_squared in rows)


def percent(value: Errors) -> str:
    """Return errors as a cell."""
    return f"{100 * value[0]:.1f} / {100 * value[1]:.0f} / {value[2]:.2f}"


def table_3_1(sign: LambdaSign) -> str:
    """Return the rows of Table 3.1, printed and synthetic."""
    lines = []
    for pair, rows in TABLE_3_1.items():
        printed = " | ".join(f"{a:.2f} / {m:.2f} / {r:.3f}" for a, m, r in rows)
        lines.append(f"| {NAMES[pair]}, printed | {printed} |")
        lines.append(f"| synthetic | {' | '.join(percent(e) for e in reproduced(pair, sign))} |")
    return "\n".join(lines)


def table_sign() -> str:
    """Return R2 of the simpler laws for either sign of lambda."""
    lines = []
    for pair in TABLE_3_2:
        cells = [f"{TABLE_3_1[pair][law][2]:.3f}" for law in (0, 1)]
        for sign in (LambdaSign.FALLING, LambdaSign.PRINTED):
            cells += [f"{reproduced(pair, sign)[law][2]:.2f}" for law in (0, 1)]
        lines.append(f"| {NAMES[pair]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def table_3_3() -> str:
    """Return the rows of Table 3.3, printed and synthetic."""
    lines = []
    for pair in TABLE_3_2:
        law = truth(pair, LambdaSign.FALLING)
        changes = []
        for points in synthetic(law, noise_for(pair, LambdaSign.FALLING)):
            found = compare(points, radius_mm=law.radius_mm)
            changes.append(
                (
                    100 * (found.average_error - found.full.average_error),
                    100 * (found.maximum_error - found.full.maximum_error),
                    found.r_squared - found.full.r_squared,
                )
            )
        mean, lowest, highest = np.mean(changes, axis=0), np.min(changes, axis=0), np.max(changes, axis=0)
        printed = TABLE_3_3[pair]
        lines.append(
            f"| {NAMES[pair]} | {printed[0]:+.2f} / {printed[1]:+.2f} / {printed[2]:+.3f} "
            f"| {mean[0]:+.2f} / {mean[1]:+.2f} / {mean[2]:+.3f} "
            f"| {lowest[0]:+.2f} .. {highest[0]:+.2f} / {lowest[1]:+.2f} .. {highest[1]:+.2f} "
            f"/ {lowest[2]:+.3f} .. {highest[2]:+.3f} |"
        )
    return "\n".join(lines)


def table_readings() -> str:
    """Return Rf of every reading of K at one setting, and the ends of the domain."""
    lines = []
    for pair in TABLE_3_2:
        law = published(pair).law
        values = [
            float(dataclasses.replace(law, k_reading=reading).ratio(np.radians(90), 1.962))
            for reading in (KReading.PRINTED, KReading.LIMIT, KReading.EXACT)
        ]
        as_printed = float(published(pair, LambdaSign.PRINTED).ratio(np.radians(90), 1.962))
        lines.append(
            f"| {NAMES[pair]} | {' | '.join(f'{v:.4f}' for v in values)} | {as_printed:.4f} "
            f"| {np.degrees(law.blow_up_angle(1.962)):.0f} | {law.vanishing_tension:.1f} |"
        )
    return "\n".join(lines)


def table_precision() -> str:
    """Return standard deviations of coefficients and predictions."""
    lines = []
    for pair in TABLE_3_2:
        law = truth(pair, LambdaSign.FALLING)
        noise = noise_for(pair, LambdaSign.FALLING)
        nine = spread_points(next(synthetic(law, noise)))
        for label, at in (("45", slice(None)), ("9", nine)):
            slopes = law.evaluate(ANGLES[at], TENSIONS[at]).d_coefficients
            covariance = noise**2 * np.linalg.inv(slopes.T @ slopes)
            stddev = np.sqrt(np.diag(covariance))
            everywhere = law.evaluate(ANGLES, TENSIONS).d_coefficients
            prediction = np.sqrt(np.einsum("ij,jk,ik->i", everywhere, covariance, everywhere))
            cells = " | ".join(f"{s:.3f}" for s in stddev)
            lines.append(
                f"| {NAMES[pair]}, {label} points | {100 * noise:.1f} % | {cells} "
                f"| {100 * prediction.mean():.1f} / {100 * prediction.max():.1f} % |"
            )
    return "\n".join(lines)


def design_text() -> dict[str, str]:
    """Return what the D-optimal nine are and how the thesis nine compare."""
    law = truth("braid-tpu", LambdaSign.FALLING)
    chosen = optimal_design(law, ANGLES, TENSIONS, 9)
    settings = [(round(float(np.degrees(ANGLES[i]))), round(float(TENSIONS[i] / GRAVITY * 1e3))) for i in chosen]
    counts = {s: settings.count(s) for s in sorted(set(settings))}
    nine = spread_points(next(synthetic(law, 0.01)))
    values = [efficiency(truth(pair, LambdaSign.FALLING), ANGLES, TENSIONS, nine) for pair in TABLE_3_2]
    return {
        "optimal": ", ".join(f"{n} x ({angle} deg, {load} g)" for (angle, load), n in counts.items()),
        "efficiency_low": f"{min(values):.2f}",
        "efficiency_high": f"{max(values):.2f}",
    }


def values() -> dict[str, str]:
    """Return everything that the template asks for."""
    return {
        "readings": table_readings(),
        "table_3_1": table_3_1(LambdaSign.FALLING),
        "sign": table_sign(),
        "table_3_3": table_3_3(),
        "precision": table_precision(),
        "draws": str(DRAWS),
        **design_text(),
    }


def render() -> str:
    """Return the document."""
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values())


def draw(folder: Path) -> None:
    """Draw every figure of the document, from the first synthetic data set of twine on TPU."""
    folder.mkdir(parents=True, exist_ok=True)
    law = truth("twine-tpu", LambdaSign.FALLING)
    points = next(synthetic(law, noise_for("twine-tpu", LambdaSign.FALLING)))
    fits = {kind: fit(points, kind, radius_mm=law.radius_mm) for kind in Law}
    draw_fits(fits, folder / "friction_fits.png", "Twine & TPU, synthetic (compare Fig 3.4)")
    draw_residuals(fits, folder / "friction_residuals.png")


def main() -> None:
    """Write document and figures."""
    draw(ROOT / "docs" / "figures")
    (ROOT / "docs" / "friction.md").write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
