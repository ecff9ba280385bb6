# SPDX-License-Identifier: Apache-2.0
"""Products between the fingers: outcomes come from mechanics, and agree with thesis Table 4.2 where they are tested."""

import numpy as np
import pytest

from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.plant.cell import CellPlant
from softgrip_emulator.plant.products import hand, products

SERIALS = {"power": "PW", "pinch": "PI", "hook": "HK"}


class PulledCell(CellPlant):
    """Spools that a hand turns: the tendons are pulled as the test says, without servos."""

    pulled_m = 0.0

    def wound_m(self):
        return self.pulled_m + self.bank.slack_m


@pytest.fixture
def cell(profiles):
    def make(finger_set, seed=1):
        plant = PulledCell(profiles, seed=seed)
        slots = ("index", "middle", "thumb")
        plant.mount(slots, [f"{SERIALS[finger_set]}-{slot}" for slot in slots], [finger_set] * 3)
        return plant

    return make


def close(plant, tension_n, *, travel_m=0.028, speed_m_s=0.015, most_s=4.0, most_n=30.0):
    """Close until the thumb and a finger pull this much or the travel is used up, then hold until it is decided."""
    pulled = np.zeros(3)
    stopped = np.zeros(3, bool)
    for _ in range(round(most_s / 1e-3)):
        pulled = np.where(stopped, pulled, np.minimum(pulled + speed_m_s * 1e-3, travel_m))
        plant.pulled_m = pulled
        plant.step()
        tension = plant.bank.tension_n
        stopped |= tension > most_n
        if tension[2] > tension_n and tension[:2].max() > tension_n:
            stopped[:] = True
        state = plant.grasp.state()
        if state.held or state.slipped:
            break
    for _ in range(300):
        plant.step()
    return plant.grasp.state()


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
    state = close(plant, tension_n)
    assert (state.held, state.slipped, state.crushed) == (True, False, False)
    assert sum(state.contact_forces_n) > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("finger_set", "product", "tension_n"), NOT_HELD)
def test_table_42_failures(cell, finger_set, product, tension_n):
    plant = cell(finger_set)
    plant.place(product)
    assert not close(plant, tension_n).held


def test_too_little_tension_lets_a_heavy_product_slip(cell):
    plant = cell("pinch")
    plant.place("orange")
    state = close(plant, 4.0)
    assert (state.held, state.slipped) == (False, True)
    assert state.product == ""


def test_too_much_tension_crushes_a_soft_one(cell):
    plant = cell("pinch")
    plant.place("cheese_slice")
    assert close(plant, 1000.0, most_n=80.0).crushed


def test_a_product_is_felt_in_the_tension_and_stops_the_finger(cell):
    with_egg, empty = cell("power"), cell("power")
    with_egg.place("egg")
    for plant in (with_egg, empty):
        for step in range(1500):
            plant.pulled_m = 0.012 * step / 1500
            plant.step()
    assert with_egg.grasp.state().touching
    assert with_egg.bank.tension_n[2] > empty.bank.tension_n[2] + 2.0
    assert with_egg.bank.q[0, 0] < empty.bank.q[0, 0] - 0.05


def test_opening_sets_the_product_down(cell):
    plant = cell("power")
    plant.place("orange")
    assert close(plant, 20.0).held
    for _ in range(2000):
        plant.pulled_m = np.maximum(plant.pulled_m - 0.02e-3, 0.0)
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


def test_all_fifteen_products_fit_the_open_hand(cell):
    assert len(products()) == 15
    for finger_set in SERIALS:
        plant = cell(finger_set)
        for name, product in products().items():
            plant.place(name)
            plant.step()
            assert not plant.grasp.state().touching, (finger_set, name)
            _, depth = hand().presented_at(product, finger_set)
            assert depth - product.height_m / 2 >= hand().palm_m


def test_the_same_seed_gives_the_same_grasp(cell):
    states = []
    for _ in range(2):
        plant = cell("pinch", seed=7)
        plant.place("grape")
        states.append(close(plant, 8.0, most_s=1.5))
    assert states[0] == states[1]
