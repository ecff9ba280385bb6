# SPDX-License-Identifier: Apache-2.0
"""The plant's finger against finite elements, and how it differs from the predictor when both are given the same.

CalculiX (C3D8I, neo-Hookean, without friction) closed the fingers of softgrip_testing.calculix_flexures. No number of
the plant was fitted to them, and none to the predictor.
"""

from dataclasses import replace

import numpy as np
import pytest

from softgrip_emulator.plant.fingers import FingerBank
from softgrip_model.finger import FRICTIONLESS, JointModel, Kernel
from softgrip_testing.calculix_flexures import FRICTIONLESS_SEEDS, MODULUS_MPA, OTHER_SEEDS, closings
from softgrip_testing.ideal_finger import ideal_finger

#: Joints that are this near to their stop, and pulls beyond the thesis', are left out.
STOP_MARGIN_RAD, LONGEST_MM = 0.12, 19.0


def as_printed(finger):
    """A finger of the kernel without scatter, friction, creep or stretch."""
    joints, radii = finger.joints, np.array(finger.routing_mm) * 1e-3
    return replace(
        ideal_finger(joints),
        link_lengths_m=np.array(finger.link_mm) * 1e-3,
        body_height_m=finger.body_mm * 1e-3,
        opening_rad=np.array(finger.opening_rad),
        entry_radius_m=radii[0::2],
        exit_radius_m=radii[1::2],
        width_m=finger.width_mm * 1e-3,
        strip_lengths_m=np.array(finger.length_mm) * 1e-3,
        thickness_m=np.array(finger.thickness_mm) * 1e-3,
        stress_tension_pa=1e6 * MODULUS_MPA * np.array([1.0, 0.0, 0.0]),
        stress_compression_pa=1e6 * MODULUS_MPA * np.array([1.0, 0.0, 0.0]),
        poisson=finger.strip.poisson,
        cable_stiffness_n=1e6,
    )


def pulled(finger, lengths_mm):
    """Tips (K, 2) [mm], tensions (K,) [N] and joint angles (K, n) of the plant at rest at growing pulled lengths."""
    bank, at_m, states = FingerBank([as_printed(finger)]), 0.0, []
    for length_mm in lengths_mm:
        end_m = 1e-3 * length_mm
        for step in range(1, 301):
            bank.step(np.array([at_m + (end_m - at_m) * step / 300]), 1e-3)
        for _ in range(200):
            bank.step(np.array([end_m]), 1e-3)
        at_m = end_m
        states.append((1e3 * bank.chain()[0][0, -1], bank.tension_n[0], bank.q[0].copy()))
    return (np.array(column) for column in zip(*states, strict=True))


def apart(tip_mm, other_mm, finger):
    """Distances of tips [% of length]."""
    return 100.0 * np.linalg.norm(tip_mm - other_mm, axis=1) / sum(finger.link_mm)


@pytest.fixture(scope="module")
def differences():
    """By seed: plant from CalculiX, hinges from CalculiX, plant from hinges, plant from flexures; tension [%]."""
    found = {}
    for one in closings():
        if one.friction:
            continue
        finger = one.finger
        tip_mm, tension_n, angle_rad = pulled(finger, one.pulled_mm)
        used = angle_rad.max(axis=1) < min(finger.opening_rad) - STOP_MARGIN_RAD
        used &= one.pulled_mm < LONGEST_MM
        hinges, flexures = (
            Kernel([finger.with_joint_model(model)], FRICTIONLESS).solve(one.pulled_mm).tip_mm[0]
            for model in (JointModel.HINGE, JointModel.FLEXURE)
        )
        pairs = (
            (tip_mm, one.tip_mm),
            (hinges, one.tip_mm),
            (tip_mm, hinges),
            (tip_mm, flexures),
            (flexures, one.tip_mm),
        )
        rows = [apart(*pair, finger)[used] for pair in pairs]
        found[one.seed] = np.array([*rows, 100.0 * (tension_n / one.tension_n - 1.0)[used]])
    return found


@pytest.mark.parametrize("seeds", [FRICTIONLESS_SEEDS, OTHER_SEEDS])
def test_beams_close_as_finite_elements_do(differences, seeds):
    tip, *_, tension = np.concatenate([differences[seed] for seed in seeds], axis=1)
    # docs/emulator.md: the tip by 0.4 % of the length in the mean, 2.4 % at most; the tension by 2 to 4 %.
    assert tip.mean() < 0.6
    assert tip.max() < 2.6
    assert abs(tension.mean()) < 5.0
    assert np.abs(tension).max() < 11.0


def test_plant_and_predictor_differ_as_much_as_finite_elements_and_predictor_do(differences):
    """The plant is not the predictor's mechanics: given the same finger it is no nearer to it than the mesh is."""
    columns = np.concatenate(list(differences.values()), axis=1)
    _, hinges_mesh, plant_hinges, plant_flexures, flexures_mesh, _ = columns.mean(axis=1)
    assert plant_hinges > 0.8 * hinges_mesh > 1.0
    assert plant_flexures > 0.8 * flexures_mesh > 0.05


def test_a_cable_creeps_by_its_share_of_the_stretch():
    """After its time constant, 1 - 1/e of the share: as much pull is lost, and comes back with the tension."""
    still = replace(ideal_finger(3), cable_stiffness_n=2000.0)
    share, time_s, pull_m = 0.2, 30.0, 0.010
    length_m = still.lead_length_m + float(still.link_lengths_m.sum())
    creeping = FingerBank([replace(still, cable_creep_share=share, cable_creep_time_s=time_s)])
    other = FingerBank([still])
    for bank in (creeping, other):
        for step in range(1, 301):
            bank.step(np.array([pull_m * step / 300]), 1e-3)
    at_first_n = float(creeping.tension_n[0])
    assert at_first_n == pytest.approx(float(other.tension_n[0]), rel=2e-3)
    for _ in range(round(time_s / 0.01)):
        creeping.step(np.array([pull_m]), 0.01)
    mean_n = 0.5 * (at_first_n + float(creeping.tension_n[0]))
    lost_m = length_m * share * mean_n / still.cable_stiffness_n * (1.0 - np.exp(-1.0))
    assert lost_m > 2e-5
    for _ in range(300):
        other.step(np.array([pull_m - lost_m]), 1e-3)
    fallen_n = at_first_n - float(creeping.tension_n[0])
    assert fallen_n == pytest.approx(at_first_n - float(other.tension_n[0]), rel=0.05)
