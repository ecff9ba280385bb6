# SPDX-License-Identifier: Apache-2.0
"""What a computer that is late must not cost: a tendon that breaks meanwhile is still named, and nothing else is."""

import pytest

from softgrip_driver.tendon.gripper import MoveMode
from softgrip_driver.tendon.motions import DriveState


def freeze(bench, duration):
    """The driver does nothing for a while; servos and fingers go on."""
    bench.world.clock.advance(bench.now() + duration)


@pytest.fixture
def holding(bench):
    bench.hold_taut(8.0)
    bench.pass_time(0.3)
    return bench


# Below and above the 80 ms of silence after which the servos stop by themselves.
@pytest.mark.parametrize("late", [0.0, 0.06, 0.1, 0.5])
@pytest.mark.parametrize("bench", [{"seed": 3}, {"seed": 7}], indirect=True)
def test_a_tendon_that_breaks_while_the_computer_is_late_is_named(holding, late):
    holding.cause("tendon_break", slot="index")
    freeze(holding, late)
    assert holding.until(lambda _: holding.drive("index").fault == "tendon_broken", 1.0)
    assert holding.until(lambda _: holding.drive("middle").state is DriveState.RELEASING)


def test_a_tendon_that_breaks_while_its_servo_is_silent_is_named(holding):
    holding.cause("servo_silent", slot="index")
    assert holding.until(lambda _: holding.drive("index").fault == "no_reply")
    end_of_silence = holding.undo.pop()
    holding.cause("tendon_break", slot="index")
    holding.pass_time(0.5)
    end_of_silence()
    assert holding.until(lambda _: holding.drive("index").fault == "tendon_broken", 2.0)


@pytest.mark.parametrize("bench", [{"rate": 30.0}], indirect=True)
def test_a_slow_loop_names_a_broken_tendon(holding):
    holding.cause("tendon_break", slot="index")
    assert holding.until(lambda _: holding.drive("index").fault == "tendon_broken", 2.0)


@pytest.mark.parametrize("late", [0.03, 0.06, 0.1, 0.5])
def test_lateness_alone_is_no_broken_tendon(bench, late):
    """Homing, moves and holds with pauses at every turn."""
    bench.loop.power(on=True)
    tickets = [
        lambda: bench.loop.call(lambda controller, now: controller.home(now)),
        lambda: bench.move([0.010]),
        lambda: bench.move([8.0], mode=MoveMode.TENSION),
        lambda: bench.move([4.0], mode=MoveMode.TENSION),
        lambda: bench.move([0.004]),
    ]
    faults = set()
    for start in tickets:
        ticket = start()
        for _ in range(200):
            freeze(bench, late)
            seen = bench.pass_time(0.05)
            faults |= {drive.fault for one in seen for drive in one.drives}
            if bench.result(ticket)[0] is not None:
                break
    assert faults <= {"", "bus_watchdog", "no_reply"}
