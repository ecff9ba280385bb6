# SPDX-License-Identifier: Apache-2.0
"""Each guard on made-up samples: it speaks when it must and is silent when it must be."""

import math

import pytest

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.guards import (
    BreakGuard,
    JumpGuard,
    MedianFilter,
    OverloadGuard,
    ShutdownGuard,
    SlackGuard,
    StallGuard,
    ThermalGuard,
)
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import TorqueModel

LIMITS = TendonLimits()
DT = 0.005


def steps(duration):
    return [i * DT for i in range(round(duration / DT))]


def test_one_wild_sample_does_not_pass_the_median():
    median = MedianFilter()
    assert [median.step(x) for x in (1.0, 1.1, 99.0, 1.2)] == [1.0, pytest.approx(1.05), 1.1, 1.2]


def test_a_glitch_is_dropped_and_a_lasting_jump_is_a_lost_position():
    guard = JumpGuard(LIMITS)
    assert guard.step(0.0, 0.010)
    assert not guard.step(DT, 0.010 - 0.0628)
    assert not guard.lost
    assert guard.step(2 * DT, 0.010)
    for i in range(3, 7):
        assert not guard.step(i * DT, -0.0528)
    assert guard.lost


def test_the_fastest_motion_is_no_jump():
    guard = JumpGuard(LIMITS)
    assert all(guard.step(t, LIMITS.speed * t) for t in steps(0.5))


@pytest.mark.parametrize("rest", [0.0, 0.3, 1.9])
def test_tension_that_vanishes_is_a_broken_tendon_within_the_confirmation(rest):
    guard = BreakGuard(LIMITS)
    assert not any(guard.step(t, 8.0, 0.01) for t in steps(0.3))
    spoke = [t for t in steps(0.2) if guard.step(0.3 + t, rest, 0.01)]
    assert spoke[0] == pytest.approx(LIMITS.break_confirm, abs=2 * DT)


@pytest.mark.parametrize(
    "tension",
    [
        lambda t: 8.0 - 10.0 * t if t < 0.5 else 3.0,
        lambda t: 2.5 if t < 0.3 else 0.0,
        lambda t: 8.0 if abs(t - 0.3) > 0.5 * LIMITS.break_confirm else 0.0,
        lambda t: 9.0 if 0.30 < t < 0.34 else 0.2,
    ],
    ids=["slow relief", "never enough tension to tell", "a dip that recovers", "a spike of acceleration"],
)
def test_what_is_no_break(tension):
    guard = BreakGuard(LIMITS)
    assert not any(guard.step(t, tension(t), 0.01) for t in steps(1.0))


def test_a_drop_within_the_uncertainty_is_no_break():
    guard = BreakGuard(LIMITS)
    assert not any(guard.step(t, 3.8, 0.01, stddev=1.0) for t in steps(0.3))
    assert not any(guard.step(0.3 + t, 0.2, 0.01, stddev=1.0) for t in steps(0.2))


@pytest.mark.parametrize(("rest", "found"), [(0.0, True), (1.5, True), (2.5, True), (3.6, False), (5.0, False)])
def test_a_product_that_slips_out_leaves_the_finger_its_own_tension(rest, found):
    """22 N on a heavy product; the joints of a closed finger pull with some 4 N, what gears can feign is 1.77 N, and a
    hold whose trim still pulls at them shows a little more."""
    model = TorqueModel(0.52 / 1.47, 0.05)

    def stddev(tension):
        return model.pull(tension * 0.010 / model.torque_per_ampere, 0.0, 0.010)[1]

    guard = BreakGuard(LIMITS)
    assert not any(guard.step(t, 22.0, 0.012, stddev=stddev(22.0)) for t in steps(0.3))
    assert any(guard.step(0.3 + t, rest, 0.012, stddev=stddev(rest)) for t in steps(0.3)) is found


@pytest.mark.parametrize("pause", [0.06, 0.2, 3.0])
def test_a_break_while_nobody_looked_is_found_afterwards(pause):
    guard = BreakGuard(LIMITS, DT)
    assert not any(guard.step(t, 8.0, 0.01) for t in steps(0.3))
    assert any(guard.step(0.3 + pause + t, 0.0, 0.01) for t in steps(0.1))


def test_a_break_is_found_by_a_loop_that_is_always_late():
    guard = BreakGuard(LIMITS, DT)
    late = [0.06 * i for i in range(60)]
    assert not any(guard.step(t, 8.0, 0.01) for t in late[:40])
    assert any(guard.step(t, 0.0, 0.01) for t in late[40:])


@pytest.mark.parametrize(("retreat", "found"), [(0.0, True), (1e-4, True), (3e-4, False), (2e-3, False)])
def test_tension_that_vanished_because_the_drive_gave_way_is_no_break(retreat, found):
    """A rigid object on a short tendon, 10 N/mm, needs 0.3 mm to give back the 3 N that a break begins at."""
    guard = BreakGuard(LIMITS, DT)
    assert not any(guard.step(t, 8.0, 0.01) for t in steps(0.3))
    assert any(guard.step(0.3 + t, 0.0, 0.01 - retreat) for t in steps(0.2)) is found


def test_a_drive_that_gives_way_steadily_breaks_nothing():
    """At 4 mm/s the last samples that lie no further in are too few to be missed."""
    guard = BreakGuard(LIMITS, DT)
    assert not any(guard.step(t, 8.0, 0.01 - 0.004 * t) for t in steps(0.3))
    assert not any(guard.step(0.3 + t, 0.0, 0.01 - 0.004 * 0.3) for t in steps(0.2))


def test_no_more_can_vanish_than_the_drive_may_pull():
    guard = BreakGuard(LIMITS, DT)
    assert not any(guard.step(t, 30.0, 0.01, allowed=35.0) for t in steps(0.3))
    assert not any(guard.step(0.3 + t, 5.0, 0.01, allowed=5.0) for t in steps(0.3))


def test_slack_needs_travel_pulling_and_time():
    def spoke(pulled, tension, pulling, duration):
        guard = SlackGuard(LIMITS)
        return any(guard.step(t, pulled, tension, pulling=pulling) for t in steps(duration))

    assert spoke(0.012, 0.1, True, 0.1)
    assert not spoke(0.002, 0.1, True, 0.1)
    assert not spoke(0.012, 0.1, False, 0.1)
    assert not spoke(0.012, 2.0, True, 0.1)
    assert not spoke(0.012, 0.1, True, 0.03)


def test_a_stall_is_standing_although_moving():
    still, crawling, idle = (StallGuard(0.4) for _ in range(3))
    assert next(t for t in steps(0.6) if still.step(t, 0.01, moving=True)) == pytest.approx(0.4, abs=2 * DT)
    assert not any(crawling.step(t, 0.001 * t, moving=True) for t in steps(2.0))
    assert not any(idle.step(t, 0.01, moving=False) for t in steps(2.0))


def test_heat_derates_stops_and_releases_with_hysteresis():
    guard = ThermalGuard(LIMITS)
    assert guard.step(math.nan) == 1.0
    assert guard.step(54.0) == 1.0
    assert guard.step(60.0) == pytest.approx(0.5)
    guard.step(65.0)
    assert guard.tripped
    guard.step(60.0)
    assert guard.tripped
    guard.step(54.9)
    assert not guard.tripped


def test_overload_backs_off_in_the_time_of_its_differential_equation_and_never_below_what_holds():
    guard = OverloadGuard(20.0)
    time = 0.0
    while guard.step(40.0, DT) == math.inf:
        time += DT
    # h' = (4 - h) / tau from 0: h = 1 at tau ln(4/3).
    assert time == pytest.approx(OverloadGuard.TIME_CONSTANT * math.log(4.0 / 3.0), rel=0.01)
    assert guard.step(40.0, DT) == pytest.approx(18.0)
    for _ in range(int(30.0 / DT)):
        guard.step(18.0, DT)
    assert not guard.backed_off


@pytest.mark.parametrize(
    ("load", "allowed_s"),
    [(0.3601, 3.0), (0.41, 3.0 * 0.36 / 0.41), (0.72, 1.5), (0.355, math.inf), (math.nan, math.inf)],
)
def test_a_load_near_what_sets_off_a_shutdown_stands_for_seconds(load, allowed_s):
    guard, time = ShutdownGuard(0.36, 10.0), 0.0
    while not guard.backed_off and time < 60.0:
        guard.step(load, 20.0, 0.01)
        time += 0.01
    assert time == pytest.approx(min(allowed_s, 60.0), abs=0.03)
    assert guard.backed_off == math.isfinite(allowed_s)


@pytest.mark.parametrize("hidden", [0.0, 0.1, 0.25])
@pytest.mark.parametrize("pulled", [0.37, 0.5, 0.7])
def test_what_it_takes_away_ends_the_load_soon_and_gently_whatever_the_gears_add(hidden, pulled):
    """A user saw a shutdown after 5 s above 40 %. The drive stalls at 50 N, and gears add to what is pulled."""
    guard, stall, tension = ShutdownGuard(0.36, 5.0), 50.0, 50.0 * pulled
    above, seen = 0.0, []
    for _ in range(6000):
        load = tension / stall * (1.0 + hidden)
        above += 0.01 * (load > 0.40)
        seen.append(tension)
        tension = min(50.0 * pulled, guard.step(load, tension, 0.01))
    assert above < 4.0
    assert tension / stall * (1.0 + hidden) == pytest.approx(0.9 * 0.36, abs=0.005)
    falls = [before - after for before, after in zip(seen, seen[10:], strict=False)]
    assert max(falls) < 0.06 * seen[0], "in a tenth of a second half of a grip is lost where a product slips"
    assert sorted(seen, reverse=True) == seen, "it would pull and slip for ever"


def test_without_a_largest_load_nothing_is_taken_away():
    guard = ShutdownGuard(1.0, 10.0)
    assert {guard.step(1.2, 30.0, 0.01) for _ in range(1000)} == {math.inf}


def test_a_little_is_left_in_any_case():
    """A motor that pushes against something that jams shows a load without a tension."""
    guard = ShutdownGuard(0.36, 10.0)
    for _ in range(1000):
        allowed = guard.step(0.9, 0.0, 0.01)
    assert allowed == 10.0


def test_all_is_given_back_after_a_rest():
    guard = ShutdownGuard(0.36, 10.0)
    while guard.step(0.6, 30.0, 0.01) == math.inf:
        pass
    rested = 0.0
    while guard.backed_off:
        guard.step(0.1, 5.0, 0.01)
        rested += 0.01
    assert rested == pytest.approx(30.0, abs=0.2)


def test_loads_of_which_each_is_short_add_up():
    """A servo's own watch may forget slowly; a second of rest makes up for a tenth of a second."""
    guard = ShutdownGuard(0.36, 10.0)
    borne = 0.0
    while not guard.backed_off:
        for load in (0.3601, 0.1):
            for _ in range(100):
                guard.step(load, 25.0, 0.01)
                borne += 0.01 * (load > 0.36 and not guard.backed_off)
    assert borne == pytest.approx(3.3, abs=0.15)


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ConfigurationError, match="tension_soft <= tension_hard"):
        TendonLimits(tension_soft=50.0, tension_hard=45.0)
    with pytest.raises(ConfigurationError, match="above 0"):
        TendonLimits(speed=0.0)
