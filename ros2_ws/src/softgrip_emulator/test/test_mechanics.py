# SPDX-License-Identifier: Apache-2.0
"""The plant's mechanics against laws that hold whatever the code: capstan, virtual work, energy, weight, symmetry."""

from dataclasses import replace

import numpy as np
import pytest

from softgrip_emulator.plant._core import JointLoad
from softgrip_emulator.plant.fingers import FingerBank
from softgrip_emulator.plant.manual_grasp import HandPulledCell
from softgrip_emulator.plant.products import product
from softgrip_emulator.plant.truth import draw_finger

MU = 0.35


def pull(bank, start_m, end_m, *, seconds, dt_s=1e-3, load=None):
    """Wind evenly from one length to another; returns wound lengths and tensions of the first finger."""
    wound = np.linspace(start_m, end_m, round(seconds / dt_s) + 1)[1:]
    tensions = []
    for length in wound:
        bank.step(np.full(len(bank.fingers), length), dt_s, load)
        tensions.append(bank.tension_n[0])
    return wound, np.array(tensions)


@pytest.mark.parametrize("closing", [True, False])
def test_full_slip_gives_the_capstan_ratio_of_the_joints_passed(plain_finger, closing):
    bank = FingerBank([plain_finger(mu=MU, presliding_m=2e-5)])
    pull(bank, 0.0, 0.018, seconds=4.0, dt_s=2e-4)
    if not closing:
        # Far enough back for the outer joints to let go of their cable too.
        pull(bank, 0.018, 0.004, seconds=4.0, dt_s=2e-4)
    # Equal radii: on a link the cable runs along it. So up to there it has been bent by the joints before, one way.
    bends = np.cumsum(bank.q[0])[:2]
    sign = -1.0 if closing else 1.0
    assert bank.span_tension_n[0, [1, 3]] / bank.tension_n[0] == pytest.approx(np.exp(sign * MU * bends), rel=1e-3)


def test_a_finger_without_friction_is_reciprocal(plain_finger):
    """Maxwell: as much as a moment on a link changes the tension, the cable turns that link."""
    finger = plain_finger((9.0, 8.0, 7.0, 8.5, 10.0, 9.5))

    def at_rest(wound_m, force):
        bank = FingerBank([finger])
        load = JointLoad(force, np.zeros((1, 9, 9)))
        pull(bank, 0.0, wound_m, seconds=0.5, load=load)
        pull(bank, wound_m, wound_m, seconds=2.0, load=load)
        return bank

    base = np.zeros((1, 9))
    base[0, 2::3] = 0.010, -0.020, 0.015
    more, less = at_rest(0.0125, base), at_rest(0.0115, base)
    turned = (more.q[0] - less.q[0]) / 0.001
    for joint in range(3):
        step = np.zeros((1, 9))
        step[0, 3 * joint + 2] = 0.002
        tension_n = [at_rest(0.012, base + side * step).tension_n[0] for side in (1.0, -1.0)]
        assert (tension_n[0] - tension_n[1]) / 0.004 == pytest.approx(-turned[joint], rel=5e-3)


def closed_loop_work_j(bank):
    """Work that the spool does in a loop between 8 and 16 mm, after one loop to forget the start."""
    pull(bank, 0.0, 0.008, seconds=2.0)
    for _ in range(2):
        there, pulls = pull(bank, 0.008, 0.016, seconds=4.0)
        _, gives = pull(bank, 0.016, 0.008, seconds=4.0)
    step_m = there[1] - there[0]
    return pulls.sum() * step_m - gives.sum() * step_m, pulls.sum() * step_m


def test_a_closed_loop_creates_no_energy(plain_finger, profiles):
    power = profiles["power"]
    printed = draw_finger(power.finger("index"), power.material, power.cable, profile="power", serial="x", seed=4)
    lossless, pulled = closed_loop_work_j(FingerBank([plain_finger()]))
    # Without friction only the joints' viscosity is lost: little at 2 mm/s.
    assert 0.0 < lossless < 0.02 * pulled
    for finger in (plain_finger(mu=MU), replace(printed, slack_m=0.0)):
        lost, put_in = closed_loop_work_j(FingerBank([finger]))
        assert 0.1 * put_in < lost < put_in


@pytest.mark.parametrize(("finger_set", "name", "tension_n"), [("power", "apple", 20.0), ("pinch", "orange", 16.0)])
def test_a_held_product_is_carried_by_its_contacts(profiles, finger_set, name, tension_n):
    plant = HandPulledCell(profiles, finger_set, seed=1)
    plant.place(name)
    assert plant.close(tension_n).held
    mass_kg = product(name).copy_of(np.random.default_rng([1, 0x5052])).mass_kg
    along_n, down_n = plant.grasp.on_fingers_n.sum(axis=0)
    # The arm's acceleration counts as 15 % of the weight (docs/emulator.md).
    assert down_n == pytest.approx(1.15 * 9.81 * mass_kg, rel=0.01)
    assert abs(along_n) < 0.01 * down_n
    assert plant.grasp.forces_n == pytest.approx(np.linalg.norm(plant.grasp.on_fingers_n, axis=1))


def test_fingers_that_draw_a_product_in_press_it_against_the_palm(profiles):
    plant = HandPulledCell(profiles, "power", seed=1)
    plant.place("cracker_sheet")
    assert plant.close(14.0).held
    for _ in range(750):
        plant.pulled_length_m = plant.pulled_length_m + 8e-6
        plant.step()
    for _ in range(500):
        plant.step()
    sheet = product("cracker_sheet").copy_of(np.random.default_rng([1, 0x5052]))
    depth_m = 0.5 * sheet.height_m - plant.grasp.centre_m[1]
    assert plant.grasp.palm_push_n > 0.5
    assert plant.grasp.palm_push_n == pytest.approx(depth_m / (1.0 / 6000.0 + 1.0 / sheet.stiffness_n_per_m), rel=1e-3)
    _, out_n = plant.grasp.on_fingers_n.sum(axis=0)
    # the fingers carry the weight and what the palm pushes
    assert out_n == pytest.approx(1.15 * 9.81 * sheet.mass_kg + plant.grasp.palm_push_n, rel=0.02)


def test_a_contact_resists_every_motion(profiles):
    plant = HandPulledCell(profiles, "power", seed=1)
    plant.place("apple")
    plant.close(20.0)
    load = plant.grasp.load(plant.bank, plant.wound_m(), 1e-3)
    stiffness = np.reshape(load.stiffness, (3, 3 * plant.bank.joints, 3 * plant.bank.joints))
    assert stiffness == pytest.approx(np.swapaxes(stiffness, 1, 2))
    assert np.linalg.eigvalsh(stiffness).min() > -1e-9
    assert stiffness.max() > 0.0


def test_a_finger_does_not_feel_how_many_joints_its_neighbour_has(plain_finger):
    long = plain_finger(mu=MU)
    two = {
        name: getattr(long, name)[..., :count]
        for count, names in (
            (
                2,
                (
                    "link_lengths_m",
                    "opening_rad",
                    "entry_radius_m",
                    "exit_radius_m",
                    "cable_aside_m",
                    "strip_lengths_m",
                    "thickness_m",
                    "stiffness",
                ),
            ),
            (4, ("clearance_m", "friction_pressure", "friction_adhesion", "wear_per_j")),
        )
        for name in names
    }
    short = replace(long, **two)
    beside, alone = FingerBank([short, long, None]), FingerBank([short])
    for bank in (beside, alone):
        pull(bank, 0.0, 0.010, seconds=0.5)
    assert np.array_equal(beside.q[0, :2], alone.q[0])
    assert np.array_equal(beside.span_tension_n[0, :4], alone.span_tension_n[0])
    assert not beside.q[0, 2]
    assert not beside.span_tension_n[0, 4:].any()
    assert not beside.q[2].any()
    points, headings = beside.chain()
    assert points[0, 3] == pytest.approx(points[0, 2])
    assert headings[0, 2] == headings[0, 1]


def test_a_finger_that_stays_mounted_goes_on_as_if_nothing_had_happened(plain_finger):
    finger = replace(plain_finger(mu=MU), friction_stribeck_share=0.1)
    bank, other = FingerBank([finger, finger]), FingerBank([finger, plain_finger()])
    pull(bank, 0.0, 0.012, seconds=0.5)
    other.adopt(bank, [0])
    for each in (bank, other):
        pull(each, 0.012, 0.010, seconds=0.5)
    assert np.array_equal(other.q[0], bank.q[0])
    assert np.array_equal(other.tension_n[:1], bank.tension_n[:1])


def test_wrong_sizes_are_refused(plain_finger):
    bank = FingerBank([plain_finger(), None])
    with pytest.raises(ValueError, match="one value for each slot"):
        bank.step(np.zeros(3), 1e-3)
    with pytest.raises(ValueError, match="as the bank has"):
        bank.step(np.zeros(2), 1e-3, JointLoad(np.zeros((1, 2)), np.zeros((1, 2, 2))))
    with pytest.raises(ValueError, match=r"stiffness \(F, 3 J, 3 J\)"):
        JointLoad(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="two contacts"):
        FingerBank([replace(plain_finger(), friction_adhesion=np.zeros(3))])
    with pytest.raises(IndexError, match="no such slot"):
        bank.adopt(FingerBank([plain_finger()]), [1])
