# SPDX-License-Identifier: Apache-2.0
"""Products between the fingers: outcomes come from mechanics, and agree with thesis Table 4.2 where they are tested."""

import numpy as np
import pytest

from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.plant.manual_grasp import HandPulledCell
from softgrip_emulator.plant.products import hand, products


@pytest.fixture
def cell(profiles):
    return lambda finger_set, seed=1: HandPulledCell(profiles, finger_set, seed=seed)


# tension [N] that a careful operator would ask for; Table 4.2: 7 = success, ; = failure
HELD = [
    ("power", "egg", 14.0),
    ("power", "orange", 20.0),
    ("power", "muffin", 16.0),
    ("power", "apple", 20.0),
    ("power", "sausage", 16.0),
    ("power", "banana", 16.0),
    ("pinch", "grape", 7.0),
    ("pinch", "cheese_slice", 7.0),
    ("pinch", "cracker_sheet", 8.0),
    ("pinch", "bag_of_chips", 12.0),
    ("pinch", "egg", 10.0),
    ("hook", "tomato_vine", 20.0),
    ("hook", "grape_vine", 20.0),
]
NOT_HELD = [
    ("power", "grape", 20.0),
    ("power", "frozen_pizza", 20.0),
    ("hook", "grape", 20.0),
    ("hook", "frozen_pizza", 20.0),
    ("hook", "egg", 20.0),
    ("pinch", "frozen_pizza", 14.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("finger_set", "product", "tension_n"), HELD)
def test_table_42_successes(cell, finger_set, product, tension_n):
    plant = cell(finger_set)
    plant.place(product)
    state = plant.close(tension_n)
    assert (state.held, state.slipped, state.crushed) == (True, False, False)
    assert sum(state.contact_forces_n) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("finger_set", "product", "tension_n"), NOT_HELD)
def test_table_42_failures(cell, finger_set, product, tension_n):
    plant = cell(finger_set)
    plant.place(product)
    assert not plant.close(tension_n).held


def test_too_little_tension_lets_a_heavy_product_slip(cell):
    plant = cell("pinch")
    plant.place("orange")
    state = plant.close(4.0)
    assert (state.held, state.slipped) == (False, True)
    assert state.product == ""


def test_a_product_lies_where_it_was_put_and_stays_behind_when_it_slips(cell):
    plant = cell("pinch")
    plant.place("orange", 0.004)
    along_m, out_m = plant.grasp.centre_m
    # The pinch set cannot go down to its taught depth: this orange stands on the table.
    height_m = products()["orange"].copy_of(np.random.default_rng([1, 0x5052])).height_m
    assert (along_m, out_m) == pytest.approx((0.004, hand().table_m - height_m / 2))
    assert plant.close(4.0).slipped
    assert plant.grasp.centre_m[1] - out_m > 0.03


def test_too_much_tension_crushes_a_soft_one(cell):
    plant = cell("pinch")
    plant.place("cheese_slice")
    assert plant.close(1000.0, limit_n=80.0).crushed


def test_a_product_is_felt_in_the_tension_and_stops_the_finger(cell):
    with_egg, empty = cell("power"), cell("power")
    with_egg.place("egg")
    for plant in (with_egg, empty):
        for step in range(1500):
            plant.pulled_length_m = np.full(3, 0.012 * step / 1500)
            plant.step()
    assert with_egg.grasp.state().touching
    assert with_egg.bank.tension_n[2] > empty.bank.tension_n[2] + 2.0
    assert with_egg.bank.q[0, 0] < empty.bank.q[0, 0] - 0.05


def test_opening_sets_the_product_down(cell):
    plant = cell("power")
    plant.place("orange")
    assert plant.close(20.0).held
    for _ in range(2000):
        plant.pulled_length_m = np.maximum(plant.pulled_length_m - 0.02e-3, 0.0)
        plant.step()
    state = plant.grasp.state()
    assert (state.held, state.slipped, state.touching, state.product) == (False, False, False, "orange")


def test_taking_away_and_wrong_requests(cell):
    plant = cell("power")
    plant.place("egg", 0.005)
    assert plant.grasp.state().product == "egg"
    plant.place("")
    assert plant.grasp.state().product == ""
    with pytest.raises(EmulatorError, match=r"expected one of .*found 'pear'"):
        plant.place("pear")
    with pytest.raises(EmulatorError, match="offset"):
        plant.place("egg", float("nan"))


def test_all_fifteen_products_and_the_test_cube_fit_the_open_hand(cell):
    assert len(products()) == 15 + 1
    for finger_set in ("power", "pinch", "hook"):
        plant = cell(finger_set)
        for name, product in products().items():
            plant.place(name)
            plant.step()
            assert not plant.grasp.state().touching, (finger_set, name)
            _, depth = hand().presented_at(product, finger_set)
            assert depth - product.height_m / 2 >= hand().palm_m


def test_the_outline_touches_the_pads_that_press(cell):
    """In the finger's own frame, as the camera sees it: the inner side of the pressing links lies on the outline."""
    plant = cell("power")
    assert plant.grasp.outline_m(0).shape == (0, 2)
    plant.place("orange")
    assert plant.close(20.0).held
    outline = plant.grasp.outline_m(0)
    chain, heading = plant.bank.chain()
    depth = plant.mounted[0].body_height_m
    shares = np.linspace(0.05, 1.0, 40)
    inner = [
        chain[0, link] + share * (chain[0, link + 1] - chain[0, link]) - depth * np.array([np.sin(h), np.cos(h)])
        for link, h in enumerate(heading[0])
        for share in shares
    ]
    nearest = np.linalg.norm(np.array(inner)[:, None] - outline, axis=2).min()
    assert nearest < 4e-3


def test_the_same_seed_gives_the_same_grasp(cell):
    states = []
    for _ in range(2):
        plant = cell("pinch", seed=7)
        plant.place("grape")
        states.append(plant.close(8.0, max_s=1.5))
    assert states[0] == states[1]


def test_a_hand_is_put_together_a_little_beside_its_drawing():
    """The play of a foot is 0.2 mm each side (docs/parts.md), which tilts it on 16 mm by 0.025 rad at most."""
    drawn = hand().slots
    cells = [hand().assembled(seed).slots for seed in range(200)]
    assert hand().assembled(7).slots == cells[7]
    assert cells[7] != cells[8]
    for name, place in drawn.items():
        off = np.array([
            (c[name].along_m - place.along_m, c[name].out_m - place.out_m, c[name].across_m - place.across_m)
            for c in cells
        ])  # fmt: skip
        turned = np.array([c[name].rest_angle_rad - place.rest_angle_rad for c in cells])
        expected_m = np.hypot(0.2e-3 / np.sqrt(3), 0.1e-3)  # uniform play, and the printer
        assert off.std(axis=0) == pytest.approx(expected_m, rel=0.15)
        assert np.abs(off.mean(axis=0)).max() < 4.0 * expected_m / np.sqrt(200)
        assert turned.std() == pytest.approx(np.sqrt(2) * 0.2 / np.sqrt(3) / 16, rel=0.15)
        assert {c[name].side for c in cells} == {place.side}
