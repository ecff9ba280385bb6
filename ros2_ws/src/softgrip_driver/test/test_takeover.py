# SPDX-License-Identifier: Apache-2.0
"""A driver that finds servos holding: they go on, with the same pull, and only where all settings agree."""

import numpy as np
import pytest

from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.tendon.blocking import block_of
from softgrip_driver.tendon.gripper import GripperController, Policies, StopPolicy
from softgrip_driver.tendon.motions import DriveState, MoveOutcome

HELD_N = 8.0


def torque(bench):
    return [servo.registers.get("torque_enable") for servo in bench.plant.servos]


@pytest.fixture
def holding(bench):
    """Three tendons held for a while, so that every slow correction has come to rest."""
    bench.backend._hold_unwatched = True
    bench.hold_taut(HELD_N)
    bench.pass_time(1.0)
    bench.safety.set_armed(armed=True)
    return bench


def kill(bench, silence_s=2.0):
    """End the process without a word and leave the bus silent; return the lowest tension of each tendon."""
    bench.loop._runs = False
    lowest = bench.plant.bank.tension_n.copy()
    for _ in range(round(silence_s / 0.01)):
        bench.world.clock.advance(bench.world.now() + 0.01)
        lowest = np.minimum(lowest, bench.plant.bank.tension_n)
    bench.bus.close()
    return lowest


def start_again(bench, unclean_end=StopPolicy.HOLD):
    """A new driver on the same port and servos, as the node does it."""
    policies = Policies(unclean_end=unclean_end)
    bench.safety = type(bench.safety)(bench.safety._store)
    bench.backend = DynamixelBackend(
        bench.bus, bench.servos, watchdog=0.08, hold_unwatched=unclean_end is StopPolicy.HOLD
    )
    limits = {name: drive.limits for name, drive in bench.controller.drives.items()}
    bench.controller = GripperController(limits, policies, None, 0.005, lambda: block_of(bench.safety, policies))
    bench.loop = bench.world.loop(bench.backend, bench.controller, 200.0, 4096)
    bench.backend.connect(keep_torque=unclean_end is StopPolicy.HOLD)
    for tendon in bench.backend.tendons:
        bench.controller.drives[tendon].is_left_holding = bench.backend.is_powered(tendon)
    bench.loop.start()
    assert bench.until(lambda seen: all(drive.time > 0.0 for drive in seen.drives), 5.0)


def test_a_hold_goes_on_through_the_death_of_the_driver_and_its_successor_takes_it_over(holding):
    held = holding.plant.bank.tension_n.copy()
    zeros = {name: drive.zero for name, drive in holding.controller.drives.items()}
    lowest = kill(holding)
    # strips and cable relax by 10 % meanwhile (docs/emulator.md)
    assert (lowest > 0.85 * held).all(), (lowest, held)
    start_again(holding)
    for name, zero in zeros.items():
        holding.loop.call(lambda c, _, n=name, z=zero: c.drives[n].set_zero(z, c.drives[n].session_mark))
    assert holding.loop.take_over() == ["index", "middle", "thumb"]
    for _ in range(300):
        holding.pass_time(0.01)
        lowest = np.minimum(lowest, holding.plant.bank.tension_n)
    assert (lowest > 0.8 * held).all(), (lowest, held)
    assert torque(holding) == [1, 1, 1]
    assert {(d.state, d.fault) for d in holding.loop.snapshot.drives} == {(DriveState.STOPPED, "estop")}
    (reason,) = {d.fault_reason for d in holding.loop.snapshot.drives}
    assert reason.startswith("emergency stop: the driver before this one ended without letting go")
    assert reason.count("make the cell safe") == 1
    assert "estop_reset" in holding.move([0.0]).refusal
    holding.reset()
    holding.pass_time(0.2)
    assert (holding.plant.bank.tension_n > 0.8 * held).all()
    outcome, reason = holding.run(holding.move([0.004]))
    assert outcome is MoveOutcome.REACHED, reason


def test_a_servo_that_moved_when_its_driver_died_stops_by_its_watchdog(bench):
    """The watchdog runs while a servo moves, whatever the policy for holds."""
    bench.backend._hold_unwatched = True
    bench.hold_taut(2.0)
    bench.move([0.030], speed=0.02)
    bench.pass_time(0.3)
    assert [servo.registers.get("bus_watchdog") for servo in bench.plant.servos] == [4, 4, 4]
    kill(bench, 0.5)
    assert [servo.registers.get("bus_watchdog") for servo in bench.plant.servos] == [-1, -1, -1]


def test_the_watchdog_rests_while_a_servo_holds_and_runs_again_before_it_moves(holding):
    assert [servo.registers.get("bus_watchdog") for servo in holding.plant.servos] == [0, 0, 0]
    holding.move([0.0])
    holding.pass_time(0.1)
    assert [servo.registers.get("bus_watchdog") for servo in holding.plant.servos] == [4, 4, 4]


def test_a_servo_whose_settings_differ_is_brought_up_without_torque(holding):
    kill(holding, 0.1)
    holding.plant.servos[1].registers.put("profile_velocity", 7)
    start_again(holding)
    assert torque(holding) == [1, 0, 1]
    assert [holding.backend.is_powered(name) for name in holding.backend.tendons] == [True, False, True]


def test_the_policy_to_let_go_switches_off_what_was_left_holding(holding):
    kill(holding, 0.1)
    start_again(holding, StopPolicy.LET_GO)
    assert torque(holding) == [0, 0, 0]
