# SPDX-License-Identifier: Apache-2.0
"""The phases of a homing on made-up views: what counts as taut, with how much tension, and when it gives up."""

from __future__ import annotations

from itertools import pairwise

import pytest

from softgrip_driver.faults import FAULTS
from softgrip_driver.tendon.homing import ZERO_ACCURACY, Homing, HomingSample, _Phase, knee
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, MotionStep, MoveOutcome
from softgrip_driver.tendon.profile import SpeedProfile

LIMITS = TendonLimits()
DT = 0.005


class Run:
    """A homing, and a drive that is always where its set-point was, or where a test holds it."""

    def __init__(self) -> None:
        self.now, self.length = 0.0, 0.0
        self.homing = Homing(self.view(), LIMITS)

    def view(self, tension: float = 0.0, speed: float = 0.0) -> DriveObservation:
        return DriveObservation(self.now, DT, self.length, speed, tension, tension, 35.0)

    def step(self, tension: float = 0.0, speed: float = 0.0, *, obeys: bool = True) -> MotionStep:
        self.now += DT
        found = self.homing.step(self.view(tension, speed))
        if obeys:
            self.length = found.pulled_length_m
        return found

    def let_out(self) -> list[MotionStep]:
        steps = [self.step()]
        while self.homing._phase is _Phase.LET_OUT and steps[-1].outcome is None:
            steps.append(self.step())
        return steps

    def wind_in(self, way: float) -> None:
        """Let out, and wind in by so much [m] with nothing to see."""
        self.let_out()
        began = self.length
        while self.length < began + way:
            self.step(0.2, 0.01)

    def take_up(self, taut: float, pause: float = 0.0, every: float = DT) -> MotionStep:
        """Let out, and wind in until a tendon of 1 N/mm that is taut there [m] holds; a pause [s] 1 mm before.

        Readings come so far apart [s].
        """
        step = self.let_out()[-1]
        paused = False
        while self.homing._phase is _Phase.TAKE_UP and step.outcome is None:
            if not paused and self.length > taut - 0.001:
                self.now, paused = self.now + pause, True
            self.now += every - DT
            force = 0.2 + 1000.0 * max(0.0, self.length - taut)
            held = force > 1.5
            step = self.step(min(force, 1.5), 0.0 if held else 0.01, obeys=not held)
        return step


def test_it_lets_out_until_slack_with_the_holding_tension_and_no_faster_than_a_release() -> None:
    steps = Run().let_out()
    assert {step.tension_limit for step in steps} == {LIMITS.tension_hold}
    assert steps[-1].pulled_length_m == pytest.approx(-LIMITS.slack_travel)
    fastest = max((a.pulled_length_m - b.pulled_length_m) / DT for a, b in pairwise(steps))
    assert fastest == pytest.approx(LIMITS.release_speed, rel=0.01)


@pytest.mark.parametrize(
    ("tension", "speed", "taut_after"),
    [(1.5, 0.0, 0.15), (1.1, 0.0, 0.15), (1.0, 0.0, None), (0.2, 0.0, None), (1.5, 0.005, None), (1.5, -0.005, None)],
)
def test_taut_is_standing_for_150_ms_with_seven_tenths_of_the_homing_tension(
    tension: float, speed: float, taut_after: float | None
) -> None:
    run = Run()
    run.let_out()
    began = run.now
    found = None
    while run.now < began + 0.6 and found is None:
        step = run.step(tension, speed, obeys=False)
        assert step.tension_limit == LIMITS.homing_tension
        # Nothing was sampled, so it looks for the knee again from further out.
        if run.homing._phase is _Phase.LET_OUT:
            found = run.now - began
    assert found == (None if taut_after is None else pytest.approx(taut_after, abs=2 * DT))


def test_standing_with_tension_while_nobody_looked_is_not_taut() -> None:
    """As read once from servos that were stopped: 3.2 N while it got going, and 262 ms later 1.9 N."""
    run = Run()
    run.wind_in(0.004)
    run.step(3.2, 0.0005, obeys=False)
    run.now += 0.262 - DT
    run.step(1.9, 0.0, obeys=False)
    run.step(1.9, 0.0, obeys=False)
    assert run.homing.zero is None


@pytest.mark.parametrize(("share", "begins_again"), [(0.95, False), (1.05, True)])
def test_no_more_than_a_zero_is_right_to_is_wound_in_unseen(share: float, begins_again: bool) -> None:
    run = Run()
    run.wind_in(0.004)
    run.now += share * ZERO_ACCURACY / LIMITS.homing_speed - DT
    run.step(0.2, 0.01)
    assert (run.homing._phase is _Phase.LET_OUT) is begins_again
    assert (run.homing._samples == []) is begins_again
    if begins_again:
        assert min(step.pulled_length_m for step in run.let_out()) == pytest.approx(-LIMITS.slack_travel)


def test_a_knee_beside_a_pause_is_taken_once_a_second_take_up_agrees() -> None:
    run = Run()
    run.take_up(0.004, pause=0.05)
    assert run.homing.zero is None
    run.take_up(0.0047, pause=0.05)  # as if the pause had hidden 0.7 mm
    assert run.homing.zero is None
    run.take_up(0.0050, pause=0.05)
    assert run.homing.zero == pytest.approx(0.0050, abs=1e-4)


@pytest.mark.parametrize(("pause", "at_once"), [(0.02, True), (0.03, False)])
def test_a_pause_that_hides_less_than_three_tenths_of_a_millimetre_costs_nothing(pause: float, at_once: bool) -> None:
    run = Run()
    run.take_up(0.004, pause)
    assert (run.homing.zero is not None) is at_once
    if not at_once:
        run.take_up(0.004)  # this one is seen well
    assert run.homing.zero == pytest.approx(0.004, abs=1e-4)


def test_an_adapter_that_is_always_slow_costs_nothing() -> None:
    """A latency timer of 16 ms: 21 ms from reading to reading, 34 with a slow item between them."""
    run = Run()
    run.take_up(0.004, pause=0.034 - 0.021, every=0.021)
    assert run.homing.zero == pytest.approx(0.004, abs=1e-4)


def test_knees_that_never_agree_are_a_fault_that_says_how_long_the_pauses_were() -> None:
    run = Run()
    seen = [run.take_up(0.004 + 0.0007 * (number % 2), pause=0.05) for number in range(6)]
    assert seen[0].outcome is None
    step = next(step for step in seen if step.outcome is MoveOutcome.FAULT)
    assert step.fault == "homing_interrupted"
    assert "silent for up to 55 ms in each take-up; at 10.0 mm/s 30 ms show where a tendon becomes taut" in step.reason


def test_a_silence_while_it_lets_out_or_gets_up_to_speed_costs_nothing() -> None:
    run = Run()
    run.now += 1.0
    assert run.step().outcome is None
    run.let_out()
    run.now += 1.0
    run.step(0.2, 0.01)
    assert run.homing._phase is _Phase.TAKE_UP


def test_the_sixth_silence_is_a_fault_that_says_how_long_it_was_and_where() -> None:
    run = Run()
    for number in range(6):
        assert run.homing._phase is not _Phase.GO_TO_ZERO
        run.wind_in(0.004)
        run.now += 0.262 - DT
        step = run.step(0.2, 0.01)
        assert (step.outcome is MoveOutcome.FAULT) is (number == 5)
    assert step.fault == "homing_interrupted"
    assert "the bus was silent for 262 ms at -4.0 mm; at 10.0 mm/s no more than 100 ms are allowed" in step.reason
    assert "loop rate" in FAULTS[step.fault].remedy


def test_a_time_that_silences_used_up_is_not_blamed_on_the_tendon() -> None:
    run = Run()
    run.wind_in(0.004)
    run.now += 0.262
    run.step(0.2, 0.01)
    while (step := run.step(obeys=False, tension=0.2)).outcome is None:
        assert run.now < 16.0
    assert step.fault == "homing_interrupted"


def test_what_was_seen_in_a_try_that_showed_nothing_is_forgotten() -> None:
    run = Run()
    run.let_out()
    run.homing._samples = [HomingSample(-0.020 + 0.001 * number, 0.0, 0.3) for number in range(12)]
    while run.homing._phase is _Phase.TAKE_UP:
        run.step(1.5, obeys=False)
    assert run.homing._samples == []


def test_a_tendon_that_never_gets_taut_ends_it_at_50_mm_and_names_the_tendon() -> None:
    run = Run()
    run.let_out()
    while (step := run.step(speed=LIMITS.homing_speed)).outcome is None:
        assert run.now < 14.0
    assert (step.outcome, step.fault) == (MoveOutcome.FAULT, "homing_failed")
    assert "50 mm wound in without 1.5 N: is the tendon attached?" in step.reason
    assert step.pulled_length_m == pytest.approx(-LIMITS.slack_travel + LIMITS.homing_travel, abs=1e-3)


def test_it_gives_up_after_15_s() -> None:
    run = Run()
    while (step := run.step(obeys=False, tension=0.2)).outcome is None:
        assert run.now < 16.0
    assert run.now == pytest.approx(LIMITS.homing_timeout, abs=2 * DT)
    assert "within 15 s" in step.reason


def test_it_has_ended_only_when_the_finger_is_at_its_zero() -> None:
    run = Run()
    homing = run.homing
    homing.zero, homing._phase, homing._profile, run.length = 0.002, _Phase.GO_TO_ZERO, SpeedProfile(0.006), 0.006
    assert run.step(obeys=False).outcome is None
    for _ in range(400):
        assert run.step(obeys=False).outcome is None, "the finger stands 4 mm from it"
    run.length = 0.002
    assert run.step().outcome is MoveOutcome.REACHED


@pytest.mark.parametrize(("count", "found"), [(7, False), (8, True)])
def test_a_knee_needs_eight_samples(count: int, found: bool) -> None:
    """Slack to 4 mm, then 1 N/mm."""
    lengths = [0.008 * number / (count - 1) for number in range(count)]
    samples = [HomingSample(length, 0.0, 0.2 + 1000.0 * max(0.0, length - 0.004)) for length in lengths]
    place = knee(samples, 0.008)
    assert (place is not None) is found
    if found:
        assert place == pytest.approx(0.004, abs=5e-4)


def test_a_force_that_falls_has_no_knee() -> None:
    assert knee([HomingSample(1e-4 * number, 0.0, 2.0 - 0.02 * number) for number in range(80)], 0.008) is None
