# SPDX-License-Identifier: Apache-2.0
"""The plant's finger: friction that turns round, stops, broken tendons, and the scatter of what is printed."""

import math

import numpy as np
import pytest

from softgrip_emulator.plant.fingers import FingerBank
from softgrip_emulator.plant.truth import draw_finger


def pull(bank, length_m, *, steps=4000, settle=400, dt_s=1e-3):
    start = getattr(bank, "_pulled_by_test", 0.0)
    for step in range(1, steps + 1):
        bank.step(np.full(len(bank.fingers), start + (length_m - start) * step / steps), dt_s)
    for _ in range(settle):
        bank.step(np.full(len(bank.fingers), length_m), dt_s)
    bank._pulled_by_test = length_m


def test_friction_turns_round_when_the_finger_opens(plain_finger):
    bank = FingerBank([plain_finger(mu=0.3, presliding_m=1e-4)])
    pull(bank, 0.010)
    closing_n, closing_q = bank.tension_n[0], bank.q[0].copy()
    pull(bank, 0.020)
    pull(bank, 0.010)
    # With the cable sliding outwards the actuator holds with less than it pulled, and the far joints are more bent.
    assert bank.tension_n[0] < 0.8 * closing_n
    assert bank.q[0, 2] > closing_q[2] + math.radians(3)


def test_a_joint_stops_when_its_groove_is_closed(plain_finger):
    bank = FingerBank([plain_finger((9.0, 9.0, 4.0, 4.0, 4.0, 4.0))])
    pull(bank, 0.0195)
    # The flanks are of TPU: they give by 3 degrees under these 20 N.
    assert math.degrees(bank.q[0].max()) < 91.0
    assert math.degrees(bank.q[0, 0]) > 86.0


def test_a_broken_tendon_pulls_nothing_and_the_finger_opens(plain_finger):
    bank = FingerBank([plain_finger()])
    pull(bank, 0.015)
    bank.broken[0] = True
    for _ in range(1000):
        bank.step(np.array([0.015]), 1e-3)
    assert bank.tension_n[0] == 0.0
    assert np.abs(bank.q).max() < math.radians(1.0)


@pytest.mark.parametrize("dt_s", [0.5e-3, 1e-3, 4e-3])
def test_the_result_does_not_depend_on_the_step(plain_finger, dt_s):
    bank = FingerBank([plain_finger(mu=0.3, presliding_m=1e-4)])
    pull(bank, 0.015, steps=round(4.0 / dt_s), settle=0, dt_s=dt_s)
    fine = FingerBank([plain_finger(mu=0.3, presliding_m=1e-4)])
    pull(fine, 0.015, steps=20000, settle=0, dt_s=2e-4)
    assert bank.q == pytest.approx(fine.q, abs=math.radians(0.3))
    assert bank.tension_n == pytest.approx(fine.tension_n, rel=0.02)


def test_every_shipped_finger_survives_a_jerk(profiles):
    for profile in profiles.values():
        bank = FingerBank(
            [
                draw_finger(
                    profile.finger(slot), profile.material, profile.cable, profile=profile.id, serial="x", seed=3
                )
                for slot in profile.slots
            ]
        )
        for wound_m in (0.03, 0.0, 0.03, -0.01, 0.015):
            for _ in range(200):
                bank.step(np.full(len(bank.fingers), wound_m), 1e-3)
                assert np.isfinite(bank.q).all()
                assert np.isfinite(bank.tension_n).all()
                assert (bank.tension_n >= 0.0).all()


def test_a_serial_is_the_same_finger_again_and_another_is_not(profiles):
    power = profiles["power"]
    draws = [
        draw_finger(power.finger("index"), power.material, power.cable, profile="power", serial=serial, seed=5)
        for serial in ("PW-I-01", "PW-I-01", "PW-I-02")
    ]
    assert np.array_equal(draws[0].stiffness, draws[1].stiffness)
    assert not np.array_equal(draws[0].stiffness, draws[2].stiffness)


def test_the_true_finger_is_near_its_design_and_not_equal(profiles):
    power = profiles["power"]
    truth = draw_finger(power.finger("index"), power.material, power.cable, profile="power", serial="a", seed=1)
    design = power.finger("index")
    off = truth.link_lengths_m - np.array(design.link_lengths_m)
    assert 0.0 < np.abs(off).max() < 0.5e-3
    assert 0.1 < (truth.friction_pressure + truth.friction_adhesion / np.sqrt(5.0)).mean() < 0.5
