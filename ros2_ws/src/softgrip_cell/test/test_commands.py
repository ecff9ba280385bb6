# SPDX-License-Identifier: Apache-2.0
"""How hard fingers are told to press again when a product settles, gives way, or hangs."""

from __future__ import annotations

import pytest

from softgrip_cell.grasp.commands import TensionControl
from softgrip_cell.grasp.contact import ContactEstimator, FingerContact
from softgrip_cell.grasp.settings import GraspSettings

SECOND = 1_000_000_000
STANDING = (True, True, True)
#: The orange's recipe asks for 18 N beside the free motion; 25 N of force allow that.
HOLD_N = 18.0


@pytest.fixture
def control(task, contact) -> TensionControl:  # type: ignore[no-untyped-def]  # fixtures
    """All fingers were told to press where they met the product: 8 mm, 5 N of free motion, 2 N beside it."""
    made = task("orange")
    settings = GraspSettings()
    control = TensionControl(made, settings, ContactEstimator(made.slots, made.references, made.paths_m, settings))
    first = control.press(range(3), (contact(),) * 3, SECOND)
    assert first.tensions_n == pytest.approx((5.0 + HOLD_N,) * 3)
    return control


def again(control: TensionControl, found: FingerContact) -> tuple[float, ...]:
    """Tensions that are told once the fingers have stood with these readings long enough."""
    command: tuple[float, ...] = ()
    for step in range(40):
        for press in control.keep_up((found,) * 3, STANDING, 2 * SECOND + step * SECOND // 100):
            assert not command, "told twice within the shortest time between two commands"
            command = press.tensions_n
        if command:
            break
    return command


def test_a_finger_that_closed_further_is_pulled_by_as_much_harder_as_free_motion_needs(
    control: TensionControl, contact
) -> None:
    assert again(control, contact(0.012, 9.0, 10.0)) == pytest.approx((9.0 + HOLD_N,) * 3)


def test_what_hangs_is_never_pulled_harder(control: TensionControl, contact) -> None:
    control.hold_still()
    assert again(control, contact(0.012, 9.0, 10.0)) == pytest.approx((5.0 + HOLD_N,) * 3)


def test_what_gives_way_is_not_pulled_harder_and_pressed_hard_enough(control: TensionControl, contact) -> None:
    """Four millimetres on and no newton more: harder pulls would only go on through it."""
    found = contact(0.012, 9.0, 2.1)
    assert again(control, found) == pytest.approx((5.0 + HOLD_N,) * 3)
    assert not control.is_full(0, found)
    assert control.is_full(0, contact(0.013, 18.7, 2.1))  # 20.8 N, more than 90 % of 23 N


def test_a_finger_that_presses_is_left_alone(control: TensionControl, contact) -> None:
    assert again(control, contact(0.0085, 5.3, HOLD_N)) == ()
    assert control.is_full(0, contact(0.0085, 5.3, HOLD_N))
