# SPDX-License-Identifier: Apache-2.0
"""How hard fingers are told to press again when a product settles, gives way, or hangs."""

from __future__ import annotations

import pytest

from softgrip_cell.grasp.pressing import Pressing
from softgrip_cell.grasp.reading import Reader, Reading
from softgrip_cell.grasp.settings import GraspSettings

SECOND = 1_000_000_000
STANDING = (True, True, True)
#: The orange's recipe asks for 18 N beside the free motion; 25 N of force allow that.
HOLD_N = 18.0


def reading(pulled_m: float, free_n: float, contact_tension_n: float) -> Reading:
    return Reading(
        pulled_m, free_n + contact_tension_n, free_n, contact_tension_n, threshold_n=0.35, force_n=contact_tension_n
    )


@pytest.fixture
def pressing(task) -> Pressing:  # type: ignore[no-untyped-def]  # fixtures
    """All fingers were told to press where they met the product: 8 mm, 5 N of free motion, 2 N beside it."""
    made = task("orange")
    settings = GraspSettings()
    pressing = Pressing(made, settings, Reader(made.references, settings))
    first = pressing.press(range(3), (reading(0.008, 5.0, 2.0),) * 3, SECOND)
    assert first.tensions_n == pytest.approx((5.0 + HOLD_N,) * 3)
    return pressing


def again(pressing: Pressing, found: Reading) -> tuple[float, ...]:
    """Tensions that are told once the fingers have stood with these readings long enough."""
    command: tuple[float, ...] = ()
    for step in range(40):
        for press in pressing.keep_up((found,) * 3, STANDING, 2 * SECOND + step * SECOND // 100):
            assert not command, "told twice within the shortest time between two commands"
            command = press.tensions_n
        if command:
            break
    return command


def test_a_finger_that_closed_further_is_pulled_by_as_much_harder_as_free_motion_needs(pressing: Pressing) -> None:
    assert again(pressing, reading(0.012, 9.0, 10.0)) == pytest.approx((9.0 + HOLD_N,) * 3)


def test_what_hangs_is_never_pulled_harder(pressing: Pressing) -> None:
    pressing.hold_still()
    assert again(pressing, reading(0.012, 9.0, 10.0)) == pytest.approx((5.0 + HOLD_N,) * 3)


def test_what_gives_way_is_not_pulled_harder_and_pressed_hard_enough(pressing: Pressing) -> None:
    """Four millimetres on and no newton more: harder pulls would only go on through it."""
    found = reading(0.012, 9.0, 2.1)
    assert again(pressing, found) == pytest.approx((5.0 + HOLD_N,) * 3)
    assert not pressing.is_full(0, found)
    assert pressing.is_full(0, reading(0.013, 18.7, 2.1))  # 20.8 N, more than 90 % of 23 N


def test_a_finger_that_presses_is_left_alone(pressing: Pressing) -> None:
    assert again(pressing, reading(0.0085, 5.3, HOLD_N)) == ()
    assert pressing.is_full(0, reading(0.0085, 5.3, HOLD_N))
