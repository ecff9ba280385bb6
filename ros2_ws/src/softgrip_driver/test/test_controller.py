# SPDX-License-Identifier: Apache-2.0
"""The controller stepped by hand over a finger in closed form: no bus, no clock, no thread."""

import dataclasses
import re

import numpy as np
import pytest

from softgrip_driver.tendon.gripper import Block, GripperController, MoveMode, MoveRequest, Policies, StopPolicy
from softgrip_driver.tendon.homing import HomingSample, knee
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, MoveOutcome
from softgrip_driver.tendon.trajectory import TendonTrajectory

DT = 0.005
LIMITS = TendonLimits()


def length_move(*targets, names=(), speed=LIMITS.speed, tension_limit=LIMITS.tension_soft, **others):
    return MoveRequest(names, MoveMode.LENGTH, list(targets), speed, tension_limit, **others)


def tension_move(target):
    return MoveRequest([], MoveMode.TENSION, [target], LIMITS.speed)


class Rig:
    """A gripper of closed-form fingers and its controller, with time passed in."""

    def __init__(self, finger, reading, names=("a", "b"), policies=None, grippers=None):
        self.fingers = {name: finger() for name in names}
        self.reading, self.now = reading, 0.0
        self.block = None
        self.controller = GripperController(
            dict.fromkeys(names, LIMITS), policies or Policies(), grippers, block=lambda: self.block
        )
        self.others = {name: {} for name in names}
        self.silent, self.actions = set(), {}
        self.cycle()

    def on(self, homed=True):
        for name, drive in self.controller.drives.items():
            drive.switch_on()
            if homed:
                drive.set_zero(self.fingers[name].taut, 1)
        return self

    def cycle(self):
        self.now += DT
        readings = {}
        for name, finger in self.fingers.items():
            finger.time = self.now
            if name not in self.silent:
                readings[name] = finger.read(self.reading, **self.others[name])
        self.actions = self.controller.step(self.now, readings)
        for name, action in self.actions.items():
            if action.setpoint is not None and name not in self.silent:
                self.fingers[name].advance(DT, action.setpoint)

    def run(self, ticket, deadline=20.0):
        end = self.now + deadline
        while self.controller.result(ticket)[0] is None and self.now < end:
            self.cycle()
        return self.controller.result(ticket)

    def pass_time(self, duration):
        for _ in range(round(duration / DT)):
            self.cycle()

    def move(self, length, names=(), **others):
        return self.controller.move(length_move(length, names=names, **others), self.now)

    def drive(self, name="a"):
        return self.controller.drives[name]


@pytest.fixture
def rig(spring_finger, reading):
    return Rig(spring_finger, reading).on()


def test_a_move_ends_at_its_target(rig):
    outcome, reason = rig.run(rig.move(0.010))
    assert outcome is MoveOutcome.REACHED, reason
    for name, finger in rig.fingers.items():
        assert finger.position - finger.taut == pytest.approx(0.010, abs=LIMITS.position_tolerance)
        assert rig.drive(name).state is DriveState.HOLDING


def test_a_move_that_needs_nearly_all_it_may_pull_does_not_stand_short_of_target_and_limit(spring_finger, reading):
    """A servo under proportional control gives way to its load; between the two it would be taken for jammed."""

    class Yielding(spring_finger):
        def __init__(self):
            super().__init__(stiffness=500.0)

        def advance(self, dt, setpoint):
            goal = (setpoint.position + 0.06 * self.taut) / 1.06  # gives way by 0.12 mm a newton
            super().advance(dt, dataclasses.replace(setpoint, position=goal))

    rig = Rig(Yielding, reading, ("a",)).on()
    outcome, reason = rig.run(rig.move(0.0302, tension_limit=16.0))
    assert outcome is MoveOutcome.REACHED, reason
    outcome, reason = rig.run(rig.move(0.0320, tension_limit=16.0))
    assert outcome is MoveOutcome.TENSION_LIMIT, reason


def test_a_move_stops_at_its_tension_limit(rig):
    outcome, reason = rig.run(rig.move(0.020, tension_limit=6.0))
    assert outcome is MoveOutcome.TENSION_LIMIT
    assert "6.0 N" in reason
    assert all(finger.tension <= 6.05 for finger in rig.fingers.values())


def test_a_move_to_a_tension_gets_there_from_both_sides(rig):
    for target in (12.0, 4.0):
        ticket = rig.controller.move(tension_move(target), rig.now)
        outcome, reason = rig.run(ticket)
        assert outcome is MoveOutcome.REACHED, reason
        rig.pass_time(0.2)
        assert rig.fingers["a"].tension == pytest.approx(target, rel=0.15)


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (length_move(0.01, names=["c"]), r"out of \['a', 'b'\]"),
        (length_move(0.05), "between 0 and 0.035 m, found 0.05 m"),
        (length_move(float("nan")), "between 0 and"),
        (length_move(0.01, speed=0.0), "a speed above 0 and up to"),
        (length_move(0.01, speed=float("nan")), "a speed above 0 and up to"),
        (length_move(0.01, tension_limit=0.0), "a tension limit above 0 and up to"),
        (length_move(0.01, tension_limit=float("nan")), "a tension limit above 0 and up to"),
        (tension_move(99.0), "between 0 and 35 N"),
        (length_move(0.01, speed=9.0), "a speed above 0 and up to"),
        (length_move(0.01, tension_limit=99.0), "a tension limit above 0 and up to"),
        (length_move(0.01, 0.01, 0.01), "one target or 2"),
    ],
)
def test_a_wrong_request_is_refused_with_its_reason_and_moves_nothing(rig, request_, text):
    ticket = rig.controller.move(request_, rig.now)
    outcome, reason = rig.controller.result(ticket)
    assert outcome is MoveOutcome.REFUSED
    assert re.search(text, reason)
    assert not rig.drive().busy


def test_nothing_moves_before_homing_or_without_power(spring_finger, reading):
    rig = Rig(spring_finger, reading)
    assert "not powered" in rig.move(0.01).refusal
    rig.on(homed=False)
    assert "not homed" in rig.move(0.01).refusal
    assert "nothing to release" in rig.controller.release(rig.now).refusal


@pytest.mark.parametrize("taut", [-0.006, 0.0, 0.004, 0.015])
def test_homing_finds_where_the_tendon_gets_taut(spring_finger, reading, taut):
    rig = Rig(spring_finger, reading, names=("a",)).on(homed=False)
    rig.fingers["a"].taut = taut
    outcome, reason = rig.run(rig.controller.home(rig.now))
    assert outcome is MoveOutcome.REACHED, reason
    assert rig.drive().zero == pytest.approx(taut, abs=3e-4)
    assert rig.fingers["a"].position == pytest.approx(taut, abs=6e-4)


def test_homing_gives_up_within_its_travel_and_says_why(spring_finger, reading):
    rig = Rig(spring_finger, reading, names=("a",)).on(homed=False)
    rig.fingers["a"].broken = True
    outcome, reason = rig.run(rig.controller.home(rig.now))
    assert outcome is MoveOutcome.FAULT
    assert "is the tendon attached" in reason
    assert rig.fingers["a"].position <= LIMITS.homing_travel - LIMITS.slack_travel + 1e-3
    assert not rig.drive().homed


def test_the_knee_of_a_hinge_is_found_in_noise():
    rng = np.random.default_rng(2)
    lengths = np.linspace(0.0, 0.012, 240)
    forces = 0.4 + 1100.0 * np.maximum(0.0, lengths - 0.0107) + rng.normal(0.0, 0.1, 240)
    samples = [HomingSample(x, 0.0, f) for x, f in zip(lengths, forces, strict=True)]
    assert knee(samples, 0.012) == pytest.approx(0.0107, abs=3e-4)


def test_too_few_samples_show_no_knee():
    assert knee([HomingSample(0.001 * i, 0.0, 0.1 * i) for i in range(7)], 0.007) is None


def test_a_streamed_trajectory_is_followed_and_a_successor_takes_over_smoothly(spring_finger, reading):
    rig = Rig(spring_finger, reading, policies=Policies(stream_timeout=1.0)).on()
    first = TendonTrajectory.checked([0.5], [0.010], [], LIMITS.travel, LIMITS.speed)
    rig.controller.follow({"a": first}, rig.now)
    rig.pass_time(0.25)
    before = rig.fingers["a"].position
    second = TendonTrajectory.checked([0.5], [0.012], [], LIMITS.travel, LIMITS.speed)
    ticket = rig.controller.follow({"a": second}, rig.now)
    rig.cycle()
    assert abs(rig.fingers["a"].position - before) < LIMITS.speed * DT * 1.5
    outcome, reason = rig.run(ticket)
    assert outcome is MoveOutcome.REACHED, reason
    rig.pass_time(0.3)
    assert rig.fingers["a"].position - rig.fingers["a"].taut == pytest.approx(0.012, abs=5e-4)


def test_a_newer_command_cancels_the_older(rig):
    older = rig.move(0.030)
    rig.pass_time(0.05)
    newer = rig.move(0.005)
    assert rig.controller.result(older)[0] is MoveOutcome.CANCELLED
    assert rig.run(newer)[0] is MoveOutcome.REACHED


def test_the_end_of_a_lease_stops_what_its_owner_moves_but_no_slow_release(rig):
    lease, _ = rig.controller.ownership.acquire("manager", [], 30.0, rig.now)
    moving = rig.controller.move(length_move(0.020, lease=lease.token), rig.now)
    rig.pass_time(0.05)
    rig.controller.release_lease(lease.token, rig.now)
    assert rig.controller.result(moving)[0] is MoveOutcome.CANCELLED
    lease, _ = rig.controller.ownership.acquire("manager", [], 30.0, rig.now)
    slow = rig.controller.release(rig.now)
    rig.controller.release_lease(lease.token, rig.now)
    outcome, reason = rig.run(slow)
    assert outcome is MoveOutcome.REACHED, reason


def test_release_keeps_its_speed(rig):
    rig.run(rig.move(0.020))
    ticket = rig.controller.release(rig.now)
    fastest = 0.0
    while rig.controller.result(ticket)[0] is None:
        rig.cycle()
        assert rig.drive().state in {DriveState.RELEASING, DriveState.HOLDING}
        fastest = max(fastest, -rig.fingers["a"].velocity)
    assert rig.controller.result(ticket)[0] is MoveOutcome.REACHED
    assert 0.5 * LIMITS.release_speed < fastest < 1.5 * LIMITS.release_speed


def test_estop_lets_go_or_holds_as_the_policy_says_and_stays_until_reset(spring_finger, reading):
    for policy in StopPolicy:
        rig = Rig(spring_finger, reading, policies=Policies(estop=policy)).on()
        rig.move(0.020)
        rig.pass_time(0.1)
        rig.block = Block("call estop_reset", is_stop=True, lets_go=policy is StopPolicy.LET_GO)
        actions = rig.controller.enforce_block()
        assert {action.power for action in actions.values()} == ({False} if policy is StopPolicy.LET_GO else set())
        before = rig.fingers["a"].position
        rig.pass_time(0.3)
        assert abs(rig.fingers["a"].position - before) < 1e-3
        assert rig.drive("a").powered is (policy is StopPolicy.HOLD)
        assert rig.move(0.01).refusal == "call estop_reset"
        rig.block = None
        rig.controller.reset()
        assert rig.drive().fault == ""


def test_a_broken_tendon_stops_its_drive_and_opens_the_others(rig):
    rig.run(rig.move(0.012))
    rig.pass_time(0.4)
    rig.fingers["a"].broken = True
    rig.pass_time(0.2)
    assert rig.drive("a").fault == "tendon_broken"
    assert rig.drive("a").state is DriveState.STOPPED
    assert not rig.drive("a").homed
    assert rig.drive("b").state is DriveState.RELEASING
    rig.pass_time(3.0)
    assert rig.fingers["b"].position == pytest.approx(rig.fingers["b"].taut, abs=1e-3)
    assert "estop_reset, then tendon/home" in rig.move(0.01, ["a"]).refusal


def test_a_fault_concerns_its_own_gripper_only(spring_finger, reading):
    rig = Rig(spring_finger, reading, names=("a", "b", "c"), grippers={"a": "l", "b": "l", "c": "r"}).on()
    rig.run(rig.move(0.012))
    rig.pass_time(0.4)
    rig.fingers["a"].broken = True
    rig.pass_time(0.2)
    assert rig.drive("b").state is DriveState.RELEASING
    assert rig.drive("c").state is DriveState.HOLDING


def test_a_silent_drive_stops_what_moves_with_it_and_comes_back(rig):
    ticket = rig.move(0.030)
    rig.pass_time(0.1)
    rig.silent.add("a")
    rig.pass_time(LIMITS.no_reply + 3 * DT)
    assert rig.drive("a").state is DriveState.DISCONNECTED
    assert rig.drive("b").state is DriveState.HOLDING
    assert rig.controller.result(ticket)[0] is MoveOutcome.FAULT
    rig.silent.clear()
    rig.cycle()
    assert rig.drive("a").fault == ""
    assert rig.run(rig.move(0.010))[0] is MoveOutcome.REACHED


def test_a_lost_session_mark_is_a_reboot_and_demands_homing(rig):
    rig.run(rig.move(0.010))
    rig.others["a"] = {"session_mark": 0}
    rig.cycle()
    assert rig.actions["a"].power is False
    assert rig.drive("a").fault == "rebooted"
    assert not rig.drive("a").homed


def test_a_position_glitch_is_ridden_through_and_a_lasting_one_is_a_fault(rig):
    rig.run(rig.move(0.010))
    rig.fingers["a"].position -= 0.0628
    rig.cycle()
    rig.fingers["a"].position += 0.0628
    rig.pass_time(0.1)
    assert rig.drive("a").fault == ""
    rig.fingers["a"].position -= 0.0628
    rig.pass_time(0.1)
    assert rig.drive("a").fault == "position_jump"
    assert not rig.drive("a").homed


def test_an_overload_shutdown_is_restored_at_once_without_a_zero(rig):
    rig.run(rig.move(0.010))
    rig.others["a"] = {"faults": ("overload",), "hardware_error": 0x20, "powered": False}
    rig.cycle()
    assert rig.actions["a"].restore
    rig.cycle()
    assert not rig.actions["a"].restore
    rig.others["a"] = {"session_mark": 0}
    rig.cycle()
    action = rig.drive("a").restored(success=True)
    assert action.power is True
    assert not rig.drive("a").homed


def test_tension_above_the_hard_limit_is_latched_and_held_with_less(rig):
    rig.run(rig.move(0.010))
    rig.fingers["a"].stiffness = 9000.0
    rig.pass_time(0.1)
    assert rig.drive("a").fault == "tension_exceeded"
    assert rig.actions["a"].setpoint.tension_limit <= LIMITS.tension_hold
    rig.fingers["a"].stiffness = 1000.0
    rig.pass_time(0.1)
    assert rig.drive("a").fault == "tension_exceeded"
    rig.controller.reset()
    assert rig.run(rig.move(0.005))[0] is MoveOutcome.REACHED


def test_heat_reduces_the_tension_then_stops_and_ends_by_itself(rig):
    rig.run(rig.move(0.010))
    rig.others["a"] = {"temperature": 60.0}
    rig.cycle()
    assert rig.actions["a"].setpoint.tension_limit == pytest.approx(0.5 * LIMITS.tension_soft)
    rig.others["a"] = {"temperature": 66.0}
    rig.pass_time(0.05)
    assert rig.drive("a").fault == "over_temperature"
    rig.others["a"] = {"temperature": 50.0}
    rig.cycle()
    assert rig.drive("a").fault == ""


def test_a_drive_that_stays_too_warm_can_be_released(rig):
    """A fault that is told in every cycle does not end what a person asked for in spite of it."""
    rig.run(rig.move(0.010))
    rig.others["a"] = {"temperature": 66.0}
    rig.pass_time(0.05)
    assert "by itself" in rig.move(0.012, ["a"]).refusal
    outcome, reason = rig.run(rig.controller.release(rig.now, ["a"]))
    assert outcome is MoveOutcome.REACHED, reason
    assert rig.drive("a").fault == "over_temperature"
    assert rig.fingers["a"].position == pytest.approx(rig.fingers["a"].taut, abs=1e-3)


def test_without_commands_a_hold_reduces_its_tension_and_releases_later(spring_finger, reading):
    rig = Rig(spring_finger, reading, policies=Policies(command_timeout=1.0, release_after=1.0)).on()
    rig.run(rig.move(0.010))
    rig.pass_time(1.2)
    assert rig.drive().fault == "command_timeout"
    assert rig.actions["a"].setpoint.tension_limit == LIMITS.tension_hold
    rig.pass_time(4.0)
    assert rig.fingers["a"].position == pytest.approx(rig.fingers["a"].taut, abs=1e-3)
    assert rig.run(rig.move(0.005))[0] is MoveOutcome.REACHED
    assert rig.drive().fault == ""


def test_a_jam_is_a_stall_with_its_place(rig):
    rig.fingers["a"].advance = lambda *_: None
    outcome, reason = rig.run(rig.move(0.020, ["a"]))
    assert outcome is MoveOutcome.FAULT
    assert "from the target" in reason
    assert rig.drive("a").fault == "stalled"


def test_a_ramp_in_pieces_is_followed_as_one(spring_finger, reading):
    """A planner sends the rest of its way again and again: each successor goes on from the setpoint, not the drive."""

    def setpoints(period):
        rig, goals = Rig(spring_finger, reading, names=("a",), policies=Policies(stream_timeout=2.0)).on(), []
        for step in range(200):
            if step == 0 or (period and step % period == 0):
                left = 1.0 - step * DT
                path = TendonTrajectory.checked([left], [0.020], [], LIMITS.travel, LIMITS.speed)
                rig.controller.follow({"a": path}, rig.now)
            rig.cycle()
            goals.append(rig.drive()._setpoint)
        return np.array(goals)

    # From the slack finger's -3 mm to 20 mm in a second; the ends of a ramp are rounded.
    line = -0.003 + 0.023 * DT * np.arange(1, 201)
    for period in (0, 10, 20):
        goals = setpoints(period)
        assert np.diff(goals).min() > -1e-9
        assert goals[20:180] == pytest.approx(line[20:180], abs=1e-3)
        assert np.diff(goals).max() < 1.5 * 0.023 * DT


@pytest.mark.parametrize(("end", "speeds"), [(0.0345, (0.25, 0.0, 0.0)), (0.0005, (-0.25, 0.0, 0.0))])
def test_a_curve_that_swings_out_between_its_points_stays_within_the_travel(spring_finger, reading, end, speeds):
    """All its points lie within the travel; a cubic that begins at 250 mm/s leaves it by a centimetre and more."""
    policies = Policies(stream_timeout=2.0)
    rig = Rig(lambda: spring_finger(stiffness=300.0), reading, names=("a",), policies=policies).on()
    rig.run(rig.move(0.015))
    path = TendonTrajectory.checked([0.1, 0.9, 1.4], [0.015, end, end], speeds, LIMITS.travel, 0.25)
    between = [path.length(t) for t in np.linspace(0.1, 0.9, 100)]
    assert max(between) > LIMITS.travel + 0.01 or min(between) < -0.01
    ticket, goals = rig.controller.follow({"a": path}, rig.now), []
    while rig.controller.result(ticket)[0] is None:
        rig.cycle()
        goals.append(rig.drive()._setpoint)
    assert rig.controller.result(ticket)[0] is MoveOutcome.REACHED
    assert min(goals) > -1e-9
    assert max(goals) < LIMITS.travel + 1e-9
    assert goals[-1] == pytest.approx(end, abs=1e-6)


# --- owners ----------------------------------------------------------------------------------------------------------


def lease(rig, duration=1.0):
    return rig.controller.ownership.acquire("manager", [], duration, rig.now)[0]


def test_what_an_owner_moves_stops_with_its_lease_and_a_release_goes_on(rig):
    rig.run(rig.move(0.012))
    owned = lease(rig)
    ticket = rig.move(0.020, lease=owned.token, speed=0.005)
    rig.pass_time(0.2)
    assert rig.controller.release_lease(owned.token, rig.now) == ("a", "b")
    assert rig.controller.result(ticket)[0] is MoveOutcome.CANCELLED
    owned = lease(rig)
    ticket = rig.controller.release(rig.now)
    rig.pass_time(0.1)
    rig.controller.release_lease(owned.token, rig.now)
    assert rig.run(ticket)[0] is MoveOutcome.REACHED


def test_a_silent_owners_motion_stops_within_a_fifth_of_a_second_and_a_release_goes_on(rig):
    rig.run(rig.move(0.012))
    owned = lease(rig, 0.5)
    ticket = rig.move(0.020, lease=owned.token, speed=0.005)
    rig.pass_time(0.7)
    outcome, reason = rig.controller.result(ticket)
    assert outcome is MoveOutcome.FAULT
    assert "no heartbeat of manager" in reason
    lease(rig, 0.5)
    ticket = rig.controller.release(rig.now)
    assert rig.run(ticket)[0] is MoveOutcome.REACHED


def test_heartbeats_keep_a_motion_a_hold_and_a_stream(spring_finger, reading):
    policies = Policies(stream_timeout=0.3, command_timeout=0.5)
    rig = Rig(spring_finger, reading, policies=policies).on()
    owned = lease(rig, 0.4)
    path = TendonTrajectory.checked([2.0], [0.020], [], LIMITS.travel, LIMITS.speed)
    ticket = rig.controller.follow({"a": path}, rig.now, owned.token)
    while rig.controller.result(ticket)[0] is None:
        rig.pass_time(0.1)
        rig.controller.ownership.renew(owned.token, rig.now)
    assert rig.controller.result(ticket)[0] is MoveOutcome.REACHED
    assert rig.drive().fault == ""


def test_an_unfed_stream_stops_although_its_sender_gave_it_an_hour(rig):
    path = TendonTrajectory.checked([3600.0], [0.030], [], LIMITS.travel, LIMITS.speed)
    rig.controller.follow({"a": path}, rig.now)
    rig.pass_time(0.7)
    assert rig.drive().fault == "owner_lost"
    before = rig.fingers["a"].position
    rig.pass_time(1.0)
    assert rig.fingers["a"].position == pytest.approx(before, abs=1e-4)


def test_a_hold_above_the_hold_tension_is_reduced_when_nobody_cares_and_one_below_is_kept(spring_finger, reading):
    policies = Policies(command_timeout=1.0, release_after=100.0)
    for tension, reduced in ((14.0, True), (6.0, False)):
        rig = Rig(spring_finger, reading, policies=policies).on()
        assert rig.run(rig.controller.move(tension_move(tension), rig.now))[0] is MoveOutcome.REACHED
        rig.pass_time(3.0)
        assert (rig.drive().fault == "command_timeout") is reduced
        assert (rig.fingers["a"].tension < 0.9 * tension) is reduced


def test_a_forced_take_over_stops_what_moves(rig):
    owned = lease(rig)
    ticket = rig.move(0.020, lease=owned.token, speed=0.005)
    rig.pass_time(0.1)
    new, taken = rig.controller.ownership.acquire("Ann", ["a"], 1.0, rig.now, force=True, reason="jam")
    rig.controller.stop_taken(taken, new, "jam")
    outcome, reason = rig.controller.result(ticket)
    assert outcome is MoveOutcome.CANCELLED
    assert "taken over by Ann: jam" in reason


def test_a_tendon_that_is_taut_for_an_owner_is_not_homed_by_others(rig):
    rig.run(rig.move(0.012))
    lease(rig)
    assert "owned by manager and taut" in rig.controller.home(rig.now).refusal


def test_a_taut_tendon_without_a_zero_is_homed_once_its_owner_gives_it_back(rig):
    rig.run(rig.move(0.012))
    owned = lease(rig, 10.0)
    rig.fingers["a"].position -= 0.0628  # the encoder has lost turns; the cable pulls as before
    rig.fingers["a"].taut -= 0.0628
    rig.pass_time(0.1)
    assert rig.drive("a").fault == "position_jump"
    rig.controller.reset()
    assert not rig.drive("a").homed
    assert rig.drive("a").holds_tension
    refusal = rig.controller.home(rig.now).refusal
    assert "tendon 'a' is owned by manager and taut or moving; without a zero it cannot be released slowly" in refusal
    rig.controller.release_lease(owned.token, rig.now)
    assert rig.controller.home(rig.now).refusal == ""


def test_a_released_tendon_may_be_homed_though_friction_left_some_tension_in_it(rig):
    rig.run(rig.move(0.012))
    lease(rig, 10.0)
    rig.fingers["a"].taut -= 0.003  # a knot has bedded in: the cable pulls at its zero
    assert rig.run(rig.controller.release(rig.now))[0] is MoveOutcome.REACHED
    assert rig.drive().holds_tension
    assert rig.controller.ownership.owner_of("a", rig.now) == "manager"
    ticket = rig.controller.home(rig.now)
    assert ticket.refusal == ""
    assert rig.run(ticket)[0] is MoveOutcome.REACHED


def test_a_tendon_whose_release_was_cut_short_is_not_homed_by_others(rig):
    rig.run(rig.move(0.012))
    lease(rig)
    ticket = rig.controller.release(rig.now)
    rig.pass_time(0.1)
    rig.controller.cancel(ticket, rig.now)
    rig.cycle()
    assert not rig.drive().busy
    assert "owned by manager and taut" in rig.controller.home(rig.now).refusal


def test_a_tendon_whose_release_a_lock_cut_short_is_not_homed_by_others(rig):
    rig.run(rig.move(0.012))
    lease(rig, 10.0)
    rig.controller.release(rig.now)
    rig.pass_time(0.1)
    rig.block = Block("locked by Ann", is_stop=False, lets_go=False)
    rig.controller.enforce_block()
    rig.cycle()
    rig.block = None
    assert rig.drive().holds_tension
    assert not rig.drive().busy
    assert "owned by manager and taut" in rig.controller.home(rig.now).refusal


def test_what_an_owner_pulls_after_a_release_is_taut_again(rig):
    rig.run(rig.controller.release(rig.now))
    owned = lease(rig, 10.0)
    rig.run(rig.move(0.012, lease=owned.token))
    assert "owned by manager and taut" in rig.controller.home(rig.now).refusal


def test_a_setpoint_that_is_no_number_is_a_fault_that_holds(rig):
    rig.run(rig.move(0.010))
    rig.move(0.020)
    rig.cycle()
    rig.drive()._motion._profile.position = float("nan")
    rig.pass_time(0.2)
    assert rig.drive().fault == "invalid_setpoint"
    assert rig.fingers["a"].position - rig.fingers["a"].taut == pytest.approx(0.010, abs=2e-3)
    assert all(np.isfinite(action.setpoint.position) for action in rig.actions.values())


def test_a_node_that_does_not_answer_stops_what_moves_and_leaves_what_holds(rig):
    """What moves goes no further than it can brake, what holds keeps its tension, and the next order ends the fault."""
    rig.run(rig.move(0.010, ["b"]))
    held = rig.fingers["b"].position
    rig.move(0.030, ["a"])
    rig.pass_time(0.2)
    at = rig.fingers["a"].position
    rig.controller.hold_all("node 'grasp_mix_manager' does not answer")
    rig.pass_time(1.0)
    assert rig.drive("a").fault == "owner_lost"
    assert rig.fingers["a"].position - at < 0.005
    assert (rig.drive("b").fault, rig.drive("b").state) == ("", DriveState.HOLDING)
    assert rig.fingers["b"].position == pytest.approx(held, abs=1e-4)
    outcome, reason = rig.run(rig.move(0.012))
    assert outcome is MoveOutcome.REACHED, reason
