# SPDX-License-Identifier: Apache-2.0
"""Mode F: against CalculiX, against a rod, and its exact gradients against differences."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import root

from softgrip_model.digest import text_digest
from softgrip_model.finger import (
    FRICTIONLESS,
    Control,
    Finger,
    FingerError,
    JointLimit,
    JointModel,
    Kernel,
    MomentLaw,
    PathSettings,
    Plane,
    Status,
    Strip,
    close,
    follow,
)
from softgrip_model.finger.predictor import Configuration
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.finger.replication import replicate
from softgrip_model.finger.session import Session
from softgrip_model.finger.wear import WearSettings
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_model.friction.published import published
from softgrip_model.profile import digest, load_directory, shipped_directory
from softgrip_testing.calculix_flexures import (
    FRICTIONLESS_SEEDS,
    KNOWN_SEEDS,
    OTHER_SEEDS,
    UNSEEN_SEEDS,
    Closing,
    closings,
)
from softgrip_testing.finger_gradients import differences, rows, uneven_finger

finger = functools.partial(uneven_finger, JointModel.FLEXURE)
MATTE = published("braid-tpu-chapter4").law
WIDTH_MM = 15.0
LAWS = {
    "matte": MATTE,
    "matte exact": dataclasses.replace(published("twine-tpu").law, k_reading=KReading.EXACT),
    "capstan": FrictionLaw(Law.CAPSTAN, (0.36,), 3.75),
}


def largest_differences(one: Closing, joint_model: JointModel) -> tuple[float, float]:
    """Return the largest differences to CalculiX of the tip, as a share of the length, and of the tension.

    States pulled by 19 mm or more or with a joint at its stop do not count: flanks pass through each other in CalculiX.
    """
    model = one.finger.with_joint_model(joint_model)
    solution = Kernel([model], MATTE if one.friction else FRICTIONLESS).solve(one.pulled_mm)
    used = ((solution.status[0] & int(Status.STOP_ENGAGED)) == 0) & (one.pulled_mm < 19.0)
    assert not solution.failed[0, used].any()
    tip = np.linalg.norm(solution.tip_mm[0] - one.tip_mm, axis=1) / model.length_from_joint_mm
    tension = np.abs(solution.tension_n[0, :, 0] / one.tension_n - 1.0)
    return float(tip[used].max(initial=0.0)), float(tension[used].max(initial=0.0))


@pytest.mark.parametrize(
    ("seeds", "tip", "tension", "mean"),
    [
        (FRICTIONLESS_SEEDS, 0.010, 0.05, 0.005),
        (OTHER_SEEDS, 0.015, 0.05, 0.007),
        (KNOWN_SEEDS, 0.010, 0.05, 0.005),
        (UNSEEN_SEEDS, 0.010, 0.05, 0.005),
    ],
)
def test_fingers_close_as_in_calculix(seeds: Sequence[int], tip: float, tension: float, mean: float) -> None:
    """None of them was fitted to."""
    found = [one for one in closings() if one.seed in seeds]
    largest = np.array([largest_differences(one, JointModel.FLEXURE) for one in found])
    hinged = np.array([largest_differences(one, JointModel.HINGE) for one in found])
    assert len(found) == len(seeds)
    assert (largest.max(axis=0) <= (tip, tension)).all()
    assert largest[:, 0].mean() <= mean
    assert hinged[:, 0].max() > 0.03  # what mode P leaves


@pytest.mark.parametrize(
    ("control", "target"), [(Control.PULLED_LENGTH, 11.0), (Control.TENSION, 8.0), (Control.DEFLECTION, 1.6)]
)
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize(
    "design",
    [finger(), finger(joints=4, elastic=True), finger(joints=1, moment_law=MomentLaw.NEUTRAL_AXIS)],
    ids=["three", "four", "one"],
)
def test_gradients_are_exact(design: Finger, law: FrictionLaw, control: Control, target: float) -> None:
    """Every column against differences of the solver."""
    if design.joints == 1:
        target *= 0.4

    def solved(finger: Finger, law: FrictionLaw = law, target: float = target) -> np.ndarray:
        return rows(Kernel([finger], law).solve([target], control, march=False))

    gradient = Kernel([design], law).solve([target], control, march=False, gradient=True).gradient
    assert gradient is not None
    strip = design.strip
    expected = {
        "target": differences(lambda x: solved(design, target=x[0]), np.array([target]), 1e-2)[:, 0],
        "thickness": differences(
            lambda x: solved(design.with_design(x, design.routing_mm)), np.array(design.thickness_mm), 1e-3
        ),
        "routing": differences(
            lambda x: solved(design.with_design(design.thickness_mm, x)), np.array(design.routing_mm), 1e-3
        ),
        "friction": differences(lambda x: solved(design, law.with_coefficients(x)), np.array(law.coefficients), 1e-4),
        "stiffness": differences(
            lambda x: solved(
                dataclasses.replace(
                    design,
                    strip=dataclasses.replace(strip, modulus_mpa=tuple(x[0] * m for m in strip.modulus_mpa)),
                )
            ),
            np.array([1.0]),
            1e-3,
        )[:, 0],
    }
    for name, columns in expected.items():
        scale = np.abs(columns).max()
        np.testing.assert_allclose(getattr(gradient, name)[0, 0], columns, atol=2e-6 * scale + 1e-9, err_msg=name)


def rod(design: Finger, tension: float) -> tuple[float, float, float]:
    """Return turn and shift of the end of a strip that a cable pulls together, by shooting for its end.

    Every cross-section obeys the energy of docs/finger.md: E' h w (n^2 / 2 + e^2 / 24 + c n e^2), softened by
    1 + s e^2, and shear. The strip starts at (-length/2, 0) along x; the cable runs from a point fixed to its start to
    one fixed to its end, as routing points of a groove of 90 degrees are.
    """
    study, poisson, modulus = design.study, design.strip.poisson, design.strip.modulus_mpa[2]
    (h,), (length,), (entry, leave) = design.thickness_mm, design.length_mm, design.routing_mm
    held = 1.0 - study.contraction * length / WIDTH_MM
    axial = modulus * (1.0 + held * poisson**2 / (1.0 - poisson**2)) * h * WIDTH_MM
    bending, shear = study.strip * axial * h**2 / 12.0, 5.0 / 6.0 * modulus / (2.0 * (1.0 + poisson)) * h * WIDTH_MM
    depth = np.sqrt(0.5)

    def end_of(guess: np.ndarray) -> np.ndarray:
        force = guess + depth * entry
        force = force * tension / np.linalg.norm(force)

        def slopes(_: float, state: np.ndarray) -> list[float]:
            x, y, heading = state
            c, s = np.cos(heading), np.sin(heading)
            moment = (y + depth * entry) * force[0] - (x + depth * entry) * force[1]
            pressed, sheared = (force[0] * c + force[1] * s) / axial, (force[1] * c - force[0] * s) / shear
            curvature = moment / bending
            for _ in range(30):
                softer = (1.0 + study.softening * (curvature * h) ** 2) / (1.0 + 24.0 * study.elongation * pressed)
                curvature = moment / bending * softer
            longer = 1.0 - pressed + study.elongation * (curvature * h) ** 2
            return [longer * c + sheared * s, longer * s - sheared * c, -curvature]

        return np.asarray(solve_ivp(slopes, (0.0, length), [-0.5 * length, 0.0, 0.0], rtol=1e-9, atol=1e-11).y[:, -1])

    def cable_end(state: np.ndarray) -> np.ndarray:
        x, y, heading = state
        c, s = np.cos(heading), np.sin(heading)
        along, below = depth * leave - 0.5 * length, -depth * leave
        return np.array([x + c * along - s * below, y + s * along + c * below])

    found = root(lambda guess: cable_end(end_of(guess)) - guess, [depth * leave, -depth * leave], tol=1e-11)
    assert found.success
    x, y, heading = end_of(found.x)
    half = 0.5 * length
    return -heading, x - half * np.cos(heading), y - half * np.sin(heading)


@pytest.mark.parametrize(("entry", "leave"), [(8.0, 8.0), (6.0, 11.0), (12.0, 7.0), (5.0, 5.5)])
@pytest.mark.parametrize("thickness", [0.1, 2.5, 3.5, 5.0])
def test_a_strip_between_rigid_links_is_a_rod(thickness: float, entry: float, leave: float) -> None:
    """Three unknowns stand for a strip that is integrated here; a thin one is Euler's elastica."""
    design = Finger(
        link_mm=(40.0,),
        thickness_mm=(thickness,),
        length_mm=(10.0,),
        routing_mm=(entry, leave),
        width_mm=WIDTH_MM,
        strip=Strip((0.0, 0.0, 11.03), MomentLaw.LINEAR),
        stop_moment_nmm=0.0,
        joint_model=JointModel.FLEXURE,
    )
    # the cable pulls at the strip's end, so the root has no length; the link gives nothing
    place, half = np.sqrt(0.5) * leave, 5.0
    attachment = (half - 0.5 * (place + half + np.hypot(place - half, 1.0))) / 10.0
    design = dataclasses.replace(design, study=dataclasses.replace(design.study, link=1e9, attachment=attachment))
    for turn, rel in ((0.4, 0.001), (0.8, 0.002), (1.1, 0.0065)):
        solution = Kernel([design], FRICTIONLESS).solve([turn], Control.DEFLECTION, march=False)
        angle, u, v = rod(design, float(solution.tension_n[0, 0, 0]))
        assert angle == pytest.approx(turn, rel=rel)
        shift = solution.tip_mm[0, 0] - 40.0 * np.array([np.cos(turn), -np.sin(turn)])
        assert np.hypot(*(shift - (u, v))) < 0.07 * np.hypot(u, v)  # a hinge has none


@pytest.mark.parametrize("control", list(Control))
def test_what_is_prescribed_is_met(control: Control) -> None:
    """By a march and from nothing; the cable's bends add up to the whole turn."""
    targets = {
        Control.PULLED_LENGTH: [2.0, 6.0, 14.0],
        Control.TENSION: [1.0, 4.0, 9.0],
        Control.DEFLECTION: [0.3, 1.0, 2.4],
    }
    kernel = Kernel([finger(elastic=True)], MATTE)
    marched, alone = (kernel.solve(targets[control], control, march=march) for march in (True, False))
    np.testing.assert_allclose(marched.tip_mm, alone.tip_mm, atol=1e-8)
    met = {
        Control.PULLED_LENGTH: alone.pulled_mm[0],
        Control.TENSION: alone.actuator_tension_n[0],
        Control.DEFLECTION: alone.angle_rad[0].sum(axis=1),
    }
    np.testing.assert_allclose(met[control], targets[control], rtol=1e-8)
    free = Kernel([finger()], FRICTIONLESS).solve([12.0], march=False)
    assert free.phi_rad[0, 0].sum() == pytest.approx(free.angle_rad[0, 0].sum(), abs=1e-9)


def test_slack_and_random_designs() -> None:
    """Within the thesis' bounds every finger is solved, cold and along a closing."""
    rng = np.random.default_rng(7)
    base = chapter_4_finger("power").with_joint_model(JointModel.FLEXURE)
    kernel = Kernel([base], MATTE).varied(rng.uniform(2.5, 5.0, (300, 3)), rng.uniform(5.0, 13.0, (300, 6)))
    cold, marched = kernel.solve([0.0, 4.0, 12.0], march=False), kernel.solve(np.linspace(0.5, 12.0, 24))
    assert (cold.status[:, 0] == int(Status.SLACK)).all()
    np.testing.assert_allclose(cold.tip_mm[:, 0], [[95.0, 0.0]] * 300)
    assert not cold.failed.any()
    assert not marched.failed.any()
    np.testing.assert_allclose(marched.tip_mm[:, -1], cold.tip_mm[:, -1], atol=1e-6)


@pytest.mark.parametrize("joints", [1, 3, 4])
def test_pulling_along_a_path_is_the_kernels_closing(joints: int) -> None:
    design, pulls = finger(joints=joints, elastic=True), np.arange(0.5, 2.0 + 3.0 * joints, 0.5)
    path, closing = follow(design, MATTE, pulls), close(design, MATTE, pulls)
    np.testing.assert_allclose(path.angle_rad, closing.angle_rad[0], atol=1e-8)
    np.testing.assert_allclose(path.tip_mm, closing.tip_mm[0], atol=1e-7)
    np.testing.assert_allclose(path.tension_n, closing.tension_n[0], rtol=1e-7)
    assert (path.slide == 1).all()


def test_coulombs_law_holds_up_and_down() -> None:
    """The loop of force and length is the work that the bends' slips take; a stuck bend's cable does not slip."""
    step = 0.05
    up = np.arange(step, 10.0 + step / 2, step)
    path = follow(
        finger(elastic=True), MATTE, np.concatenate([up, up[::-1][1:], up[1:]]),
        settings=PathSettings(largest_pull_step_mm=step),
    )  # fmt: skip
    assert not path.failed.any()
    np.testing.assert_allclose(np.diff(path.slip_mm, axis=0)[path.slide[1:] == 0], 0.0, atol=1e-9)
    assert {-1, 0, 1} == set(path.slide.ravel().tolist())
    five = int(np.argmin(np.abs(up - 5.0)))
    cycle = slice(five, 2 * (len(up) - 1) + five + 1)
    pulled, tension, slip = path.pulled_mm[cycle], path.tension_n[cycle], path.slip_mm[cycle]
    work = float(trapezoid(tension[:, 0], pulled))
    taken = sum(float(trapezoid(tension[:, i] - tension[:, i + 1], slip[:, i])) for i in range(slip.shape[1]))
    assert work > 0.0
    # bends turn without slipping, and links give as the tension in them has it: 2 % of the loop
    assert work == pytest.approx(taken, rel=0.02)


PUSHED = {
    "tip": lambda offset: Plane((0.0, 1.0), offset - 50.0),
    "link": lambda offset: Plane((0.0, 1.0), offset - 30.0, link=1, along_mm=20.0),
    "limit": lambda offset: JointLimit(0, np.radians(25.0) - offset),
}


@pytest.mark.parametrize("name", PUSHED)
@pytest.mark.parametrize(("joint_model", "share"), [(JointModel.HINGE, 1e-4), (JointModel.FLEXURE, 0.03)])
def test_objects_and_cable_are_reciprocal(name: str, joint_model: JointModel, share: float) -> None:
    """Without friction all is elastic: what the object's place does to the tension, the pull does to its force.

    In mode F but for the links, which give to their cables and not to objects.
    """
    design = chapter_4_finger("power").with_joint_model(joint_model)
    step = 1e-2 if name != "limit" else 1e-3

    def at(pull: float, offset: float) -> tuple[float, float]:
        path = follow(design, FRICTIONLESS, [2.0, 4.0, 6.0, 8.0, pull], contacts=[PUSHED[name](offset)])
        assert path.contact_force[-1, 0] > 0.0
        assert path.gap[-1, 0] == pytest.approx(0.0, abs=1e-9)
        return float(path.tension_n[-1, 0]), float(path.contact_force[-1, 0])

    tension = (at(10.0, step)[0] - at(10.0, -step)[0]) / (2.0 * step)
    force = (at(10.0 + step, 0.0)[1] - at(10.0 - step, 0.0)[1]) / (2.0 * step)
    assert tension == pytest.approx(force, rel=share)


def test_flexures_unlike_the_studys_are_flagged() -> None:
    """Beyond the bounds of what was compared with CalculiX; a hinge knows no such bounds."""
    inside, outside = finger(), finger().with_design((2.7, 3.1, 3.4), (4.0, 7.3, 8.2, 9.4, 10.5, 11.6))
    for design, flagged in [(inside, False), (outside, True), (outside.with_joint_model(JointModel.HINGE), False)]:
        closing, path = close(design, MATTE, [5.0]), follow(design, MATTE, [5.0])
        assert bool(closing.status[0, 0] & Status.FLEXURE_OUTSIDE) is flagged
        assert bool(path.status[0] & Status.FLEXURE_OUTSIDE) is flagged
    assert Status.FLEXURE_OUTSIDE & Status.EXTRAPOLATED


def test_mode_r_refuses_it() -> None:
    """The thesis' recipe knows hinges alone, and says so."""
    with pytest.raises(FingerError, match="mode R"):
        replicate(finger(), MATTE)
    assert close(finger(), MATTE, [1.0]).failed.sum() == 0


def test_predictions_name_their_mode() -> None:
    """Flexures are the default; hinges keep the digests of older recordings, which name no mode."""
    profiles = load_directory(shipped_directory())
    hinges, flexures = (Configuration(profiles, {"index": "power"}, None, model) for model in JointModel)
    assert flexures.digest == Configuration(profiles, {"index": "power"}, None).digest != hinges.digest
    assert hinges.digest == text_digest(f"index=power:{digest(profiles['power'])}")
    one = Finger.from_profile(profiles["power"], "index")
    assert one.joint_model is JointModel.FLEXURE
    expected = Kernel([one], published(profiles["power"].friction_id).law).solve([12.0], march=False)
    predicted = flexures.closing("index", [0.012])[0]
    np.testing.assert_allclose(predicted.tip, 1e-3 * expected.tip_mm[0, 0])
    session = Session(profiles, {"index": "hook"}, WearSettings(), uncertainty=None)
    session.set_mounted({"index": "power"})
    assert session.configuration.digest == flexures.digest
    assert session.closing("power", "index", "", [0.012])[0].tip == pytest.approx(predicted.tip, abs=1e-12)
