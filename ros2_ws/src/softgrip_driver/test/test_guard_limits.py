# SPDX-License-Identifier: Apache-2.0
"""Each guard at its limits: one sample or one period to either side of what its text promises."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.guard_set import GuardSet
from softgrip_driver.tendon.guards import (
    BreakGuard,
    JumpGuard,
    MedianFilter,
    OverloadGuard,
    ReplySilence,
    SlackGuard,
    StallGuard,
    TensionGuard,
    ThermalGuard,
)
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, Hold, MoveToLength

LIMITS = TendonLimits()
DT = 0.005


def times(duration: float) -> list[float]:
    return [i * DT for i in range(round(duration / DT))]


def view(now: float, tension: float, length: float = 0.02, **others: float) -> DriveObservation:
    return DriveObservation(now, DT, length, 0.0, tension, tension, 35.0, **others)


# --- median, silence, jumps ----------------------------------------------------------------------------------------


def test_the_median_knows_a_lasting_change_after_two_samples() -> None:
    median = MedianFilter()
    for _ in range(10):
        median.step(1.0)
    assert [median.step(9.0) for _ in range(2)] == [1.0, 9.0]


def test_silence_adds_up_what_was_asked_and_ends_with_an_answer() -> None:
    silence = ReplySilence(0.01)
    silence.heard(1.0)
    assert [silence.unanswered(1.0 + 0.01 * i) for i in (1, 2, 3)] == pytest.approx([0.01, 0.02, 0.03])
    silence.heard(1.04)
    assert silence.unanswered(1.05) == pytest.approx(0.01)


def test_a_pause_of_the_computer_counts_as_one_question_of_25_ms() -> None:
    silence = ReplySilence(0.01)
    silence.heard(1.0)
    assert silence.unanswered(6.0) == pytest.approx(0.025)


def test_a_loop_slower_than_that_counts_its_own_period() -> None:
    silence = ReplySilence(0.1)
    silence.heard(1.0)
    assert silence.unanswered(6.0) == pytest.approx(0.1)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_position_is_believed_up_to_four_times_the_speed_and_2_mm(way: float) -> None:
    """50 mm/s: 4 x 50 mm/s x 5 ms = 1 mm, and 2 mm beside it."""
    for jump, believed in ((0.0029, True), (0.0031, False)):
        guard = JumpGuard(LIMITS)
        assert guard.step(0.0, 0.01)
        assert guard.step(DT, 0.01 + way * jump) is believed


def test_glitches_far_apart_lose_no_position() -> None:
    guard = JumpGuard(LIMITS)
    guard.step(0.0, 0.01)
    for i in range(1, 20):
        assert guard.step((2 * i - 1) * DT, 0.5) is False
        assert guard.step(2 * i * DT, 0.01) is True
        assert not guard.lost


def test_three_outliers_in_a_row_are_glitches_the_fourth_is_a_lost_position() -> None:
    guard = JumpGuard(LIMITS)
    guard.step(0.0, 0.01)
    lost = []
    for i in range(1, 5):
        guard.step(i * DT, 0.5)
        lost.append(guard.lost)
    assert lost == [False, False, False, True]


# --- a broken tendon -----------------------------------------------------------------------------------------------


def broken_after(guard: BreakGuard, began: float, tension: Callable[[float], float], **others: float) -> float | None:
    """Return how long after ``began`` [s] the guard speaks, None when it does not within 0.5 s."""
    return next((t for t in times(0.5) if guard.step(began + t, tension(t), 0.01, **others)), None)


def pulled(tension: float, duration: float = 0.3, **others: float) -> BreakGuard:
    guard = BreakGuard(LIMITS, DT)
    for t in times(duration):
        assert not guard.step(t, tension, 0.01, **others)
    return guard


def test_a_break_is_told_when_the_tension_has_stayed_away_for_40_ms() -> None:
    assert broken_after(pulled(8.0), 0.3, lambda _: 0.0) == pytest.approx(0.040, abs=2 * DT)


def test_a_dip_of_20_ms_is_no_break() -> None:
    assert broken_after(pulled(8.0), 0.3, lambda t: 0.0 if t < 0.020 else 8.0) is None


def test_dips_that_come_again_and_again_are_no_break() -> None:
    assert broken_after(pulled(8.0), 0.3, lambda t: 0.0 if t % 0.040 < 0.020 else 8.0) is None


@pytest.mark.parametrize(("before", "found"), [(2.9, False), (3.1, True)])
def test_only_a_tension_of_3_n_or_more_can_be_missed(before: float, found: bool) -> None:
    assert (broken_after(pulled(before), 0.3, lambda _: 0.0) is not None) is found


@pytest.mark.parametrize(("stddev", "found"), [(1.0, True), (3.0, False)])
def test_a_drop_within_four_standard_deviations_is_no_break(stddev: float, found: bool) -> None:
    """8 N that vanish: 4 x 1 N is less, 4 x 3 N is more."""
    guard = pulled(8.0, stddev=stddev)
    assert (broken_after(guard, 0.3, lambda _: 0.0, stddev=stddev) is not None) is found


def test_what_a_braking_motor_shows_is_no_break() -> None:
    assert broken_after(pulled(8.0), 0.3, lambda _: 0.0, acceleration=-0.5) is None


def test_a_tension_seen_for_less_than_120_ms_can_not_be_missed() -> None:
    assert broken_after(pulled(8.0, 0.060), 0.060, lambda _: 0.0) is None


def test_one_late_step_confirms_no_break() -> None:
    """The tension is gone in one sample, and the next comes a second later: 10 ms of it count."""
    guard = pulled(8.0)
    assert not guard.step(0.3, 0.0, 0.01)
    assert not guard.step(1.3, 0.0, 0.01)


@pytest.mark.parametrize(("rest", "found"), [(0.2, True), (4.0, False)])
def test_a_drive_that_ran_away_has_lost_its_tendon_where_nothing_pulls_in_the_end(rest: float, found: bool) -> None:
    """An XL330 with the gears that Rhoban identified (m6), its tendon cut at 10 N; 4 N are a finger without product."""
    guard = pulled(10.0, stddev=0.5)
    for t in times(0.38):
        runs_in, brakes = t < 0.14, 0.14 <= t < 0.28
        acceleration = -0.5 if brakes else 0.42
        tension = 7.8 - 25.0 * t if runs_in else 0.0 if brakes else 6.0
        assert not guard.step(0.3 + t, tension, 0.013, stddev=2.5, acceleration=acceleration)
    assert (broken_after(guard, 0.68, lambda _: rest, stddev=0.5) is not None) is found


def test_a_tendon_that_is_let_out_on_purpose_is_no_break() -> None:
    guard = pulled(8.0)
    guard.step(0.3, 0.0, 0.01)
    assert guard.suspects
    guard.reset()
    assert not guard.suspects
    assert broken_after(guard, 0.31, lambda _: 0.0) is None


# --- the hard limit ------------------------------------------------------------------------------------------------


def exceeded_after(acceleration: float, tension: Callable[[float], float]) -> float | None:
    guard = TensionGuard(LIMITS)
    return next((t for t in times(1.0) if guard.step(t, tension(t), acceleration)), None)


@pytest.mark.parametrize(("tension", "found"), [(44.9, None), (45.1, 0.0)])
def test_45_n_are_allowed_and_more_is_not_at_once(tension: float, found: float | None) -> None:
    assert exceeded_after(0.0, lambda _: tension) == found


def test_while_the_motor_accelerates_more_than_the_limit_must_last_a_tenth_of_a_second() -> None:
    assert exceeded_after(1.0, lambda _: 50.0) == pytest.approx(0.1, abs=2 * DT)


def test_peaks_far_apart_do_not_last() -> None:
    assert exceeded_after(1.0, lambda t: 50.0 if t % 0.10 < 0.05 else 10.0) is None


# --- slack, stall, heat --------------------------------------------------------------------------------------------


def slack_after(tension: Callable[[float], float], acceleration: float = 0.0) -> float | None:
    guard = SlackGuard(LIMITS)
    found = (guard.step(t, 0.012, tension(t), pulling=True, acceleration=acceleration) for t in times(0.5))
    return next((i * DT for i, slack in enumerate(found) if slack), None)


def test_a_slack_tendon_is_told_after_50_ms_and_not_while_the_motor_brakes() -> None:
    assert slack_after(lambda _: 0.1) == pytest.approx(0.050, abs=2 * DT)
    assert slack_after(lambda _: 0.1, acceleration=-0.5) is None
    assert slack_after(lambda t: 0.1 if t % 0.06 < 0.04 else 2.0) is None


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_drive_that_moves_either_way_is_no_stall(way: float) -> None:
    guard = StallGuard(0.4)
    assert not any(guard.step(t, way * 0.001 * t, moving=True) for t in times(2.0))


def test_the_noise_of_an_encoder_is_no_motion() -> None:
    guard = StallGuard(0.4)
    assert any(guard.step(t, 0.01 + 1e-5 * (i % 2), moving=True) for i, t in enumerate(times(0.6)))


def test_a_drive_that_stood_on_purpose_has_all_its_time_when_it_starts() -> None:
    guard = StallGuard(0.4)
    for t in times(1.0):
        guard.step(t, 0.01, moving=False)
    assert not any(guard.step(1.0 + t, 0.01, moving=True) for t in times(0.35))


@pytest.mark.parametrize(("temperature", "share"), [(40.0, 1.0), (55.0, 1.0), (57.5, 0.75), (64.0, 0.3), (90.0, 0.3)])
def test_heat_leaves_at_least_three_tenths_of_the_tension(temperature: float, share: float) -> None:
    assert ThermalGuard(LIMITS).step(temperature) == pytest.approx(share)


def test_a_temperature_that_is_not_known_trips_nothing() -> None:
    guard = ThermalGuard(LIMITS)
    guard.step(math.nan)
    assert not guard.tripped


def test_an_overload_is_over_at_nine_tenths_of_the_heat() -> None:
    """h' = ((18/20)^2 - h) / tau from 1: below 0.9 after tau ln(0.19 / 0.09)."""
    guard = OverloadGuard(20.0)
    while not guard.backed_off:
        guard.step(40.0, DT)
    start, time = guard.heat, 0.0
    while guard.backed_off:
        guard.step(18.0, DT)
        time += DT
    assert time == pytest.approx(20.0 * math.log((start - 0.81) / 0.09), rel=0.01)


# --- all of them together ------------------------------------------------------------------------------------------


def test_what_is_allowed_is_the_least_of_heat_and_overload() -> None:
    watch = GuardSet(LIMITS, 20.0, DT)
    assert watch.allows(60.0, 0.0, DT).tension == pytest.approx(0.5 * 35.0)
    assert watch.allows(30.0, 0.0, DT).tension == pytest.approx(35.0)
    while not (allowed := watch.allows(30.0, 40.0, 0.1)).warnings:
        assert not allowed.too_hot
    assert allowed.tension == pytest.approx(18.0)


def test_a_load_of_the_motor_is_backed_off_and_said() -> None:
    watch = GuardSet(replace(LIMITS, max_load=0.36), 1000.0, DT)
    while not (allowed := watch.allows(30.0, 20.0, 0.01, 0.45)).warnings:
        assert allowed.tension == LIMITS.tension_soft
    assert "36% of the motor's stall" in allowed.warnings[0]
    for _ in range(500):
        allowed = watch.allows(30.0, allowed.tension, 0.01, 0.45)
    assert allowed.tension == LIMITS.tension_hold


def test_a_hold_that_was_reduced_has_lost_no_tendon() -> None:
    watch, hold = GuardSet(LIMITS, 20.0, DT), Hold(0.02, 35.0)
    for t in times(0.3):
        assert watch.finds(view(t, 30.0), hold, 35.0, homed=True) is None
    for t in times(0.3):
        assert watch.finds(view(0.3 + t, 4.0), hold, 4.0, homed=True) is None


def test_a_finger_that_opens_has_lost_no_tendon_and_one_that_holds_has() -> None:
    opening = MoveToLength(0.0, 0.02, 35.0, view(0.0, 8.0), LIMITS)
    for motion, expected in ((opening, None), (Hold(0.02, 35.0), "tendon_broken")):
        watch = GuardSet(LIMITS, 20.0, DT)
        for t in times(0.3):
            assert watch.finds(view(t, 8.0), motion, 35.0, homed=True) is None
        found = [watch.finds(view(0.3 + t, 0.0), motion, 35.0, homed=True) for t in times(0.2)]
        assert next((one[0] for one in found if one), None) == expected


def test_a_drive_without_a_zero_is_not_called_slack_for_a_length_that_means_nothing() -> None:
    closing = MoveToLength(0.03, 0.02, 35.0, view(0.0, 0.0), LIMITS)
    for homed, expected in ((False, None), (True, "tendon_slack")):
        watch = GuardSet(LIMITS, 20.0, DT)
        found = [watch.finds(view(t, 0.0), closing, 35.0, homed=homed) for t in times(0.2)]
        assert next((one[0] for one in found if one), None) == expected


def test_the_hard_limit_is_found_whatever_is_going_on() -> None:
    found = GuardSet(LIMITS, 20.0, DT).finds(view(0.0, 46.0), Hold(0.02, 35.0), 35.0, homed=False)
    assert found is not None
    assert found[0] == "tension_exceeded"


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
@pytest.mark.parametrize("name", ["tension_hard", "no_reply", "travel", "homing_timeout"])
def test_no_limit_is_zero_negative_or_no_number(name: str, value: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"'{name}': expected a number above 0"):
        TendonLimits(**{name: value})


def test_the_driver_stops_5_degrees_before_the_servo_does_and_derates_from_15_before() -> None:
    limits = TendonLimits(temperature_limit=70.0)
    assert (limits.derate_from, limits.stop_at) == (55.0, 65.0)
