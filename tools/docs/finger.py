# SPDX-License-Identifier: Apache-2.0
"""Writes docs/finger.md and its figures: the finger model, what it reproduces of the thesis, and what it does not.

`render()` is the text; a test compares it with the committed file, so that no number in it can grow old.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from string import Template

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from softgrip_model.finger import (
    FRICTIONLESS,
    Control,
    Cylinder,
    Finger,
    JointModel,
    Kernel,
    MomentLaw,
    Solution,
    Status,
    Strip,
    close,
    follow,
)
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import REMEDIES, TO_CALIBRATE, WATCH
from softgrip_model.finger.flexure import FLEXURE_STUDY
from softgrip_model.finger.hypotheses import Cause
from softgrip_model.finger.learning import Expectation, Knowledge, Linearisation
from softgrip_model.finger.parts import strip_moment
from softgrip_model.finger.predictor import room_mm
from softgrip_model.finger.published import (
    CHAPTER_4_MM,
    OPTIMISED_ROUTING_MM,
    TANGENT_MODULUS_MPA,
    UNIFORM_ROUTING_MM,
    chapter_3_finger,
    chapter_4_finger,
)
from softgrip_model.finger.replication import Replica, ReplicationRecipe, replicate
from softgrip_model.finger.uncertainty import PRIOR, STATED, Causes
from softgrip_model.friction.laws import FrictionLaw, LambdaSign, Law
from softgrip_model.friction.published import published
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.calculix_flexures import (
    FITTED_OTHER_SEEDS,
    FITTED_SEEDS,
    FRICTIONLESS_SEEDS,
    KNOWN_SEEDS,
    OTHER_SEEDS,
    UNSEEN_SEEDS,
    closings,
)
from softgrip_testing.virtual_cell import calibrated

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
TEMPLATE = Path(__file__).with_name("finger.md.in")
PULLS = np.linspace(0.1, 20.0, 200)

TWINE = published("twine-tpu").law
TWINE_PRINTED = published("twine-tpu", LambdaSign.PRINTED).law
BRAID = published("braid-tpu-chapter4").law
HEAP = published("twine-tpu-heap").law
CAPSTAN_PUBLISHED = FrictionLaw(Law.CAPSTAN, (0.36,), TWINE.radius_mm)
LAWS = {
    "none": FRICTIONLESS,
    "Capstan 0.40": FrictionLaw(Law.CAPSTAN, (0.40,), TWINE.radius_mm),
    "Heap": HEAP,
    "Matte": TWINE,
}
#: Joint length and passage radius [mm] of the readings of mode R that fit the published facts.
READINGS = ((13.0, 0.9), (10.0, 1.0))
#: The power finger with a cable that gives: 2 kN axial stiffness, 150 mm to the actuator.
ELASTIC_POWER = dataclasses.replace(chapter_4_finger("power"), compliance_per_n=1.0 / 2000.0, lead_mm=150.0)
OBJECT = Cylinder(centre_mm=(55.0, -50.0), radius_mm=20.0)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def degrees(angles: Array, digits: int = 1) -> str:
    """Return angles as text, "J0 / J1 / J2"."""
    return " / ".join(f"{value:.{digits}f}" for value in np.degrees(angles))


def spread_deg(angle_rad: Array) -> float:
    """Return the root mean square over a closing of sum_j (q_j - mean q)^2 [deg]: Eq 3.10 with squares."""
    angle = np.degrees(angle_rad)
    return float(np.sqrt(((angle - angle.mean(axis=1, keepdims=True)) ** 2).sum(axis=1).mean()))


def crossing(pulled: Array, angle_rad: Array) -> str:
    """Return the last pulled length [mm] at which joint 0 overtakes joint 2, as text."""
    overtakes = np.flatnonzero(np.diff(np.sign(angle_rad[:, 0] - angle_rad[:, 2])) > 0)
    return f"{pulled[overtakes[-1] + 1]:.1f}" if len(overtakes) else "never"


def tips(angle_rad: Array, link_mm: float = 35.0) -> Array:
    """Return the tips of a finger with equal links, (K, 2) [mm]."""
    heading = np.cumsum(angle_rad, axis=1)
    return link_mm * np.stack([np.cos(heading).sum(axis=1), -np.sin(heading).sum(axis=1)], axis=1)


def tip_difference_pct(one: Array, other: Array) -> float:
    """Return the mean distance of two tip paths in % of the 105 mm long finger."""
    return float(np.linalg.norm(tips(one) - tips(other), axis=1).mean() / 105.0 * 100.0)


def replicas(routing: tuple[float, ...], law: FrictionLaw) -> list[Replica]:
    """Return the closing by each reading of mode R."""
    return [
        replicate(chapter_3_finger(routing, length), law, recipe=ReplicationRecipe(radius))
        for length, radius in READINGS
    ]


def facts_table() -> str:
    """Return what the thesis publishes about chapter 3 beside mode R and mode P."""
    optimised, uniform = replicas(OPTIMISED_ROUTING_MM, TWINE_PRINTED), replicas(UNIFORM_ROUTING_MM, TWINE_PRINTED)
    p_optimised = close(chapter_3_finger(OPTIMISED_ROUTING_MM), TWINE, PULLS)
    p_uniform = close(chapter_3_finger(UNIFORM_ROUTING_MM), TWINE, PULLS)

    def other_law(law: FrictionLaw) -> list[str]:
        found = [
            tip_difference_pct(theirs.angle_rad, ours.angle_rad)
            for theirs, ours in zip(replicas(UNIFORM_ROUTING_MM, law), uniform, strict=True)
        ]
        theirs = close(chapter_3_finger(UNIFORM_ROUTING_MM), law, PULLS)
        return [f"{value:.1f}" for value in [*found, tip_difference_pct(theirs.angle_rad[0], p_uniform.angle_rad[0])]]

    rows = [
        ["RMSE of the optimised finger [deg]", "4.7", *(f"{spread_deg(r.angle_rad):.2f}" for r in optimised),
         f"{spread_deg(p_optimised.angle_rad[0]):.2f}"],
        ["its J0 overtakes J2 at [mm]", "12.3", *(crossing(r.pulled_mm, r.angle_rad) for r in optimised),
         crossing(PULLS, p_optimised.angle_rad[0])],
        ["uniform finger, tip: Capstan against Matte [%]", "9.74 (against a finger)", *other_law(CAPSTAN_PUBLISHED)],
        ["uniform finger, tip: Heap against Matte [%]", "8.05 (against a finger)", *other_law(HEAP)],
        ["uniform finger at 20 mm [deg]", "-", *(degrees(r.angle_rad[-1]) for r in uniform),
         degrees(p_uniform.angle_rad[0, -1])],
        ["optimised finger at 20 mm [deg]", "-", *(degrees(r.angle_rad[-1]) for r in optimised),
         degrees(p_optimised.angle_rad[0, -1])],
    ]  # fmt: skip
    modes = [f"R, l = {length:g}, passage {radius:g} mm" for length, radius in READINGS]
    return table(["fact", "thesis", *modes, "P, l = 10"], rows)


def laws_table() -> str:
    """Return the uniform and the optimised finger under every law (mode P)."""
    rows = []
    for name, law in LAWS.items():
        for label, routing in (("uniform", UNIFORM_ROUTING_MM), ("optimised", OPTIMISED_ROUTING_MM)):
            found = close(chapter_3_finger(routing), law, [10.0, 20.0])
            ends = [f"{found.tension_n[0, 1, end]:.2f}" for end in (0, -1)]
            rows.append([name, label, degrees(found.angle_rad[0, 0], 2), degrees(found.angle_rad[0, 1], 2), *ends])
    return table(["friction", "routing", "10 mm [deg]", "20 mm [deg]", "T at 20 mm [N]", "at the tip [N]"], rows)


def flexure_table() -> str:
    """Return how far modes P and F are from CalculiX."""
    groups: dict[str, Sequence[int]] = {
        "thesis' bounds, no friction": FRICTIONLESS_SEEDS,
        "thesis' bounds, with friction, known": KNOWN_SEEDS,
        "thesis' bounds, with friction, unseen": UNSEEN_SEEDS,
        "others, no friction": OTHER_SEEDS,
    }
    rows = []
    for name, seeds in groups.items():
        for model in (JointModel.HINGE, JointModel.FLEXURE):
            tips, tensions = [], []
            for one in (one for one in closings() if one.seed in seeds):
                finger = one.finger
                law = BRAID if one.friction else FRICTIONLESS
                flexed = Kernel([finger], law).solve(one.pulled_mm)
                used = ((flexed.status[0] & int(Status.STOP_ENGAGED)) == 0) & (one.pulled_mm < 19.0)
                found = Kernel([finger.with_joint_model(model)], law).solve(one.pulled_mm[used])
                distance = np.linalg.norm(found.tip_mm[0] - one.tip_mm[used], axis=1) / finger.length_from_joint_mm
                tips.append(100.0 * float(np.nanmax(distance)))
                tensions.append(100.0 * float(np.nanmax(np.abs(found.tension_n[0, :, 0] / one.tension_n[used] - 1.0))))
            mode = "P" if model is JointModel.HINGE else "F"
            row = [f"{np.mean(tips):.2f}", f"{np.max(tips):.2f}", f"{np.mean(tensions):.1f}", f"{np.max(tensions):.1f}"]
            rows.append([f"{name} ({len(tips)})", mode, *row])
    head = [
        "fingers",
        "mode",
        "tip [% of length], mean of largest",
        "largest",
        "tension [%], mean of largest",
        "largest",
    ]
    return table(head, rows)


#: h, l [mm], q [deg] of the table of moments.
MOMENTS = ((3.0, 10.0, 60.0), (5.0, 10.0, 60.0), (3.0, 5.0, 60.0), (3.0, 5.0, 90.0))


def secant_moments() -> str:
    """Return Eq 4.3 times the angle, as text."""
    found = []
    for thickness, length, angle in MOMENTS:
        a, _, c = TANGENT_MODULUS_MPA
        curvature = np.radians(angle) / length
        stiffness = 15.0 * thickness**3 / (4.0 * length) * (a * (curvature * thickness) ** 2 / 20.0 + c / 3.0)
        found.append(f"{stiffness * np.radians(angle):.1f}")
    return " / ".join(found)


def moments_table() -> str:
    """Return bending moments by law."""
    rows = []
    for thickness, length, angle in MOMENTS:
        cells = [f"{thickness:g}", f"{length:g}", f"{angle:g}", f"{np.radians(angle) * thickness / 2 / length:.3f}"]
        for law in MomentLaw:
            finger = Finger(
                link_mm=(35.0,), thickness_mm=(thickness,), length_mm=(length,), routing_mm=(8.0, 8.0), width_mm=15.0,
                strip=Strip(TANGENT_MODULUS_MPA, law), joint_model=JointModel.HINGE,
            )  # fmt: skip
            cells.append(f"{strip_moment(finger, 0, float(np.radians(angle)))[0]:.1f}")
        rows.append(cells)
    return table(["h", "l", "q [deg]", "strain", *(str(law).replace("_", " ") for law in MomentLaw)], rows)


def designs_table() -> str:
    """Return the fingers of Fig 4.4 by moment law."""
    rows = []
    for grasp in CHAPTER_4_MM:
        for law in (MomentLaw.SIGNED_TANGENT, MomentLaw.ABSOLUTE_TANGENT, MomentLaw.NEUTRAL_AXIS):
            found = close(chapter_4_finger(grasp, law), BRAID, [10.0, 20.0])
            angles = [degrees(found.angle_rad[0, k], 2) for k in (0, 1)]
            tension = " / ".join(f"{value:.2f}" for value in found.actuator_tension_n[0])
            rows.append([grasp, str(law).replace("_", " "), *angles, tension])
    return table(["design", "moment law", "10 mm [deg]", "20 mm [deg]", "T at 10 / 20 mm [N]"], rows)


def shares_table() -> str:
    """Return each joint's share of the whole deflection, for the qualitative claims of section 4.3.1."""
    rows = []
    requested = np.radians([60.0, 120.0])
    kernel = Kernel([chapter_4_finger(grasp) for grasp in CHAPTER_4_MM], BRAID)
    from_deflection = kernel.solve(requested, control=Control.DEFLECTION, march=False)
    claims = {"power": "all joints together, uniformly", "hook": "J1 and J2, hardly J0", "pinch": "mainly J0"}
    for i, grasp in enumerate(CHAPTER_4_MM):
        shares = 100.0 * from_deflection.angle_rad[i] / requested[:, None]
        rows.append([grasp, claims[grasp], *(" / ".join(f"{s:.0f}" for s in row) for row in shares)])
    return table(["design", "thesis", "share at 60 deg [%]", "share at 120 deg [%]"], rows)


def wear_table() -> str:
    """Return how well a closing of 20 lengths tells a friction factor, with the stiffness unknown (section 4)."""
    lengths = np.arange(1.0, 21.0)
    rows = []
    cases = {
        "uniform, chapter 3": (chapter_3_finger(UNIFORM_ROUTING_MM), TWINE),
        "power, Fig 4.4": (chapter_4_finger("power"), BRAID),
    }
    for name, (finger, law) in cases.items():
        found = Kernel([finger], law).solve(lengths, gradient=True)
        assert found.gradient is not None
        scaled = np.array(law.coefficients) * np.array([1.0, 0.0, 1.0, 1.0])  # ln Rf times a factor
        slopes = np.stack([found.gradient.friction[0] @ scaled, found.gradient.stiffness[0]], axis=-1)
        tension = slopes[:, 5] / (0.05 * found.actuator_tension_n[0])[:, None]
        tip = slopes[:, 3:5].reshape(-1, 2) / 1.0
        angle = slopes[:, :3].reshape(-1, 2) / np.radians(1.0)
        cells = []
        for measured in ([tension], [tip], [angle], [tension, tip], [tension, angle]):
            stacked = np.concatenate(measured)
            cells.append(f"{100.0 * np.sqrt(np.linalg.inv(stacked.T @ stacked)[0, 0]):.1f}")
        rows.append([name, *cells])
    head = ["sd of the friction factor [%]", "T (5 %)", "tip (1 mm)", "angles (1 deg)", "T + tip", "T + angles"]
    return table(head, rows)


def uncertainties() -> dict[str, str]:
    """Return the standard deviations of what a prediction does not know: as stated, and as fingers corrected them."""

    def both(name: str, factor: float = 1.0) -> str:
        stated, used = (factor * getattr(prior, name) for prior in (STATED, PRIOR))
        return f"{stated:g} | {used:g}"

    return {
        "u_friction": both("friction", 100.0),
        "u_stiffness": both("stiffness", 100.0),
        "u_print": both("thickness_mm"),
        "u_zero": both("zero_mm"),
        "u_spool": both("spool", 100.0),
        "u_gain": both("tension_gain", 100.0),
        "u_camera": both("camera_mm"),
        "u_scale": both("camera_scale", 100.0),
        "u_turn": both("camera_turn_rad"),
        "u_model": both("model", 100.0),
        "u_stretch": both("stretch_mm_per_n"),
        "u_room": both("room_mm"),
        "u_share": both("room_share", 100.0),
        "u_scatter": both("scatter_mm"),
        "u_tension": both("tension_error_n"),
    }


#: Pulled lengths [mm] of a closing whose intervals are looked at, and at which one is measured.
INTERVAL_PULLS, MEASURED_PULLS = np.linspace(2.1, 16.0, 60), np.arange(1.0, 16.5)


class IntervalBudget:
    """The tip's variance before anything is learnt of a shipped index finger: where it comes from, what narrows it."""

    def __init__(self, finger_set: str) -> None:
        profile = load_directory(shipped_directory())[finger_set]
        finger = Finger.from_profile(profile, "index")
        friction = calibrated(1)  # nine points with 1 % of scatter
        room = room_mm(profile, "index")
        self.causes = causes = Causes(finger, friction.law, friction.covariance, PRIOR, room)
        self.covariance = causes.expected[1]
        self.tip = self._at(INTERVAL_PULLS)[1]
        p, n = causes.factor, finger.joints
        self.places = {
            "friction, the rig's fit": [*range(p)],
            "friction, beside the rig's": [p],
            "modulus": [p + 1],
            "strips' thickness": [*range(p + 2, p + 2 + n)],
            "routing points": [*range(p + 2 + n, causes.zero)],
            "zero": [causes.zero],
            "spool": [causes.zero + 1],
            "cable's stretch": [causes.stretch],
            "cable's room": [causes.room],
            "kernel's own error": [*range(causes.room + 1, causes.tension.start)],
        }

    def _at(self, pulled_mm: Array) -> tuple[Linearisation, ...]:
        found = Knowledge.prior(self.causes).finger.at(pulled_mm)
        assert found is not None
        return found

    def half_width(self, covariance: Array) -> str:
        """Return the median 95 % half width of x and y [mm]."""
        return f"{1.96 * np.median(np.sqrt(self.tip.variance(covariance, PRIOR.scatter_mm))):.1f}"

    def share(self, source: str) -> str:
        """Return what a source makes of the whole variance, in the mean over the closing [%]."""
        only, here = np.zeros_like(self.covariance), self.places[source]
        only[here, here] = self.covariance[here, here]
        part, whole = self.tip.variance(only, 0.0), self.tip.variance(self.covariance, PRIOR.scatter_mm)
        return f"{100.0 * np.mean(part.sum(axis=1) / whole.sum(axis=1)):.0f}"

    def known(self, **stddevs: float) -> Array:
        """Return the covariance where sources are known to so many of their standard deviations."""
        covariance = self.covariance.copy()
        for source, stddev in stddevs.items():
            here = self.places[source]
            covariance[here, here] = stddev**2
        return covariance

    def closed(self, first: int, last: int) -> Array:
        """Return the covariance after one closing, of whose numbers [samples] those from first to last are seen."""
        _, _, tension = self._at(MEASURED_PULLS)
        samples = [
            ClosingInstant(0, p, np.zeros(2), t, t) for p, t in zip(MEASURED_PULLS, tension.value[:, 0], strict=True)
        ]
        expected = Expectation.of(self.causes, self.causes.expected[0], samples)
        assert expected is not None
        rows = slice(first * len(samples), last * len(samples))
        slope, noise = expected.slope[rows], expected.noise[rows, rows]
        gain = np.linalg.solve(slope @ self.covariance @ slope.T + noise, slope @ self.covariance).T
        return np.asarray(self.covariance - gain @ slope @ self.covariance)


def interval_tables() -> dict[str, str]:
    """Return where intervals come from, and what one measurement makes of them."""
    budgets = [IntervalBudget(name) for name in ("power", "hook", "pinch")]
    head = ["power", "hook", "pinch"]
    shares = [[source, *(one.share(source) for one in budgets)] for source in budgets[0].places]
    zero, cable = 0.05 / PRIOR.zero_mm, 0.005 / PRIOR.stretch_mm_per_n
    strips = 0.02 / PRIOR.thickness_mm
    measurements = {
        "none": lambda one: one.covariance,
        "strips by calliper, 0.02 mm": lambda one: one.known(**{"strips' thickness": strips}),
        "cable by a weight, 0.005 mm/N": lambda one: one.known(**{"cable's stretch": cable}),
        "zero by hand, 0.05 mm": lambda one: one.known(zero=zero),
        "strips, cable and zero": lambda one: one.known(
            **{"strips' thickness": strips, "cable's stretch": cable, "zero": zero}
        ),
        "tensions of one empty closing": lambda one: one.closed(2, 3),
        "one empty closing that the camera sees": lambda one: one.closed(0, 3),
    }
    widths = [
        [name, *(one.half_width(covariance(one)) for one in budgets)] for name, covariance in measurements.items()
    ]
    return {
        "interval_shares": table(["share of the tip's variance [%]", *head], shares),
        "interval_widths": table(["half width over 2 to 16 mm, median [mm], measured:", *head], widths),
    }


#: What each cause alone makes of a finger, where its amount does not decide.
VERDICTS = {Cause.STRIP: "WORN", Cause.CABLE: "WORN", Cause.FRICTION: "RECALIBRATE; WORN beyond 50 %"}


def watch_values() -> dict[str, str]:
    """Return the watch's limits and causes."""
    rows = [
        [str(cause), VERDICTS.get(cause, "RECALIBRATE" if cause in TO_CALIBRATE else "WATCH"), REMEDIES[cause]]
        for cause in Cause
    ]
    return {
        "baseline": str(WATCH.baseline),
        "settled": str(WATCH.settled),
        "windows": f"{', '.join(map(str, WATCH.windows[:-1]))} and {WATCH.windows[-1]}",
        "steady": f"{WATCH.steady_limit:g}",
        "model_errors": ", ".join(f"{100 * error:g}" for error in WATCH.model_errors),
        "misfit_share": f"{100 * WATCH.misfit_share:g}",
        "odds": f"{math.exp(WATCH.expected_odds):.0f}",
        "watch_limit": f"{WATCH.limit:g}",
        "worn_limit": f"{WATCH.worn_limit:g}",
        "misfit": f"{WATCH.misfit_limit:g}",
        "margin": f"{WATCH.margin:g}",
        "causes": "\n".join("| " + " | ".join(row) + " |" for row in rows),
    }


def values() -> dict[str, str]:
    """Return every number and table of the text."""
    frictionless = replicate(chapter_3_finger(UNIFORM_ROUTING_MM), FRICTIONLESS)
    exact = close(chapter_3_finger(UNIFORM_ROUTING_MM), FRICTIONLESS, [20.0])
    rng = np.random.default_rng(1)
    random = Kernel([chapter_4_finger("power")], BRAID).varied(
        rng.uniform(2.5, 5.0, (2000, 3)), rng.uniform(5.0, 13.0, (2000, 6))
    )
    batch = random.solve(PULLS[9::10])
    loop = hysteresis()
    force = follow(chapter_4_finger("power"), BRAID, [14.0], contacts=[OBJECT]).contact_force[0, 0]
    return {
        "facts": facts_table(),
        "laws": laws_table(),
        "moments": moments_table(),
        "secant": secant_moments(),
        "flexure_table": flexure_table(),
        "study_fingers": str(len(FITTED_SEEDS) + len(FITTED_OTHER_SEEDS)),
        "study_others": str(len(FITTED_OTHER_SEEDS)),
        **{name: f"{value:g}" for name, value in dataclasses.asdict(FLEXURE_STUDY).items()},
        **uncertainties(),
        **interval_tables(),
        **watch_values(),
        "designs": designs_table(),
        "shares": shares_table(),
        "wear": wear_table(),
        "frictionless_r": f"{frictionless.tension_n[-1, 0]:.2f}",
        "frictionless_p": f"{exact.tension_n[0, 0, 0]:.2f}",
        "random_designs": str(len(batch.status)),
        "unsolved": str(int((batch.status & Status.NOT_CONVERGED != 0).any(axis=1).sum())),
        "out_of_reach": str(int((batch.status & Status.OUT_OF_REACH != 0).any(axis=1).sum())),
        "reversing": f"{100.0 * float((batch.status & Status.REVERSING != 0).any(axis=1).mean()):.1f}",
        "loop_up": f"{loop[0]:.2f}",
        "loop_down": f"{loop[1]:.2f}",
        "contact_force": f"{force:.1f}",
    }


def hysteresis() -> tuple[float, float]:
    """Return the tension of the power finger at 10 mm on the way up and on the way down from 16 mm [N]."""
    path = follow(ELASTIC_POWER, BRAID, [10.0, 16.0, 10.0])
    return float(path.tension_n[0, 0]), float(path.tension_n[2, 0])


def render() -> str:
    """Return the document."""
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values())


# --- figures ---------------------------------------------------------------------------------------------------------


def draw(folder: Path) -> None:
    """Draw every figure of the document."""
    mpl.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    draw_chapter_3(folder / "finger_chapter_3.png")
    draw_designs(folder / "finger_designs.png")
    draw_paths(folder / "finger_paths.png")


def draw_chapter_3(path: Path) -> None:
    """Uniform and optimised finger: mode R, mode P, and every law's tip path (Figs 3.6 and 3.7)."""
    from matplotlib import pyplot as plt  # noqa: PLC0415  the backend has to be chosen first

    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.9), layout="constrained")
    colours = mpl.color_sequences["tab10"]
    for axis, label, routing in (
        (axes[0], "uniform", UNIFORM_ROUTING_MM),
        (axes[1], "optimised", OPTIMISED_ROUTING_MM),
    ):
        length, radius = READINGS[0]
        replica = replicate(chapter_3_finger(routing, length), TWINE_PRINTED, recipe=ReplicationRecipe(radius))
        found = close(chapter_3_finger(routing), TWINE, PULLS)
        for j in range(3):
            axis.plot(replica.pulled_mm, np.degrees(replica.angle_rad[:, j]), color=colours[j], label=f"J{j}, mode R")
            axis.plot(PULLS, np.degrees(found.angle_rad[0, :, j]), "--", color=colours[j], label=f"J{j}, mode P")
        axis.set(title=f"{label} routing", xlabel="pulled length [mm]", ylabel="angle [deg]", ylim=(0, 90))
        axis.legend(fontsize="small")
    for name, law in LAWS.items():
        axes[2].plot(*close(chapter_3_finger(UNIFORM_ROUTING_MM), law, PULLS).tip_mm[0].T, label=name)
    axes[2].set(title="uniform routing, tip (mode P)", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes[2].legend(fontsize="small")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_designs(path: Path) -> None:
    """The fingers of Fig 4.4 over the whole deflection (Fig 4.5, dashed lines)."""
    from matplotlib import pyplot as plt  # noqa: PLC0415  the backend has to be chosen first

    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.9), layout="constrained", sharey=True)
    for axis, grasp in zip(axes, CHAPTER_4_MM, strict=True):
        for law, style in ((MomentLaw.ABSOLUTE_TANGENT, "-"), (MomentLaw.SIGNED_TANGENT, ":")):
            found: Solution = close(chapter_4_finger(grasp, law), BRAID, PULLS)
            total = np.degrees(found.angle_rad[0].sum(axis=1))
            for j in range(3):
                label = f"J{j}, {str(law).replace('_', ' ')}"
                angle = np.degrees(found.angle_rad[0, :, j])
                axis.plot(total, angle, style, color=mpl.color_sequences["tab10"][j], label=label)
        axis.set(title=grasp, xlabel="J0 + J1 + J2 [deg]", ylabel="angle [deg]")
    axes[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_paths(path: Path) -> None:
    """Hysteresis of tension and joints, and a closing on an object."""
    from matplotlib import pyplot as plt  # noqa: PLC0415  the backend has to be chosen first

    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.9), layout="constrained")
    up = np.arange(0.2, 16.01, 0.1)
    there_and_back = np.concatenate([up, up[::-1]])
    loop = follow(ELASTIC_POWER, BRAID, there_and_back)
    axes[0].plot(loop.pulled_mm, loop.tension_n[:, 0], label="at the actuator")
    axes[0].plot(loop.pulled_mm, loop.tension_n[:, -1], label="at the tip")
    axes[0].set(title="closing and opening: tension", xlabel="pulled length [mm]", ylabel="tension [N]")
    axes[0].legend(fontsize="small")
    for j in range(3):
        axes[1].plot(loop.pulled_mm, np.degrees(loop.angle_rad[:, j]), label=f"J{j}")
    axes[1].set(title="closing and opening: joints", xlabel="pulled length [mm]", ylabel="angle [deg]")
    axes[1].legend(fontsize="small")
    free, held = (follow(chapter_4_finger("power"), BRAID, up, contacts=contacts) for contacts in ([], [OBJECT]))
    axes[2].plot(up, free.tension_n[:, 0], label="tension, free")
    axes[2].plot(up, held.tension_n[:, 0], label="tension, on the cylinder")
    axes[2].plot(up, held.contact_force[:, 0], label="force on the cylinder")
    axes[2].set(title="closing on a cylinder", xlabel="pulled length [mm]", ylabel="[N]")
    axes[2].legend(fontsize="small")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main() -> int:
    """Write the document and its figures."""
    (ROOT / "docs" / "finger.md").write_text(render(), encoding="utf-8")
    draw(ROOT / "docs" / "figures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
