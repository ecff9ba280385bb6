# SPDX-License-Identifier: Apache-2.0
"""The test for contact: its false-alarm rate, how long a contact takes to be decided, creep, late drives."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from softgrip_cell.grasp.commands import Press
from softgrip_cell.grasp.contact import ContactEstimator, ContactState, CreepFilter, LateDrive, RiseTest
from softgrip_cell.grasp.sequence import GraspSequence
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome
from softgrip_time.units import NANOSECONDS

SETTINGS = GraspSettings()
PERIOD_S = 0.01
PERIOD_NS = 10_000_000
NOISE_N = 0.06
MODEL_N = 0.05

#: What a closing of 10 mm/s pulls in a period [m].
TRAVEL_M = 1e-4


def decided_after(values_n: Sequence[float], settings: GraspSettings = SETTINGS, noise_n: float = NOISE_N) -> int:
    """Number of readings after which a contact is decided, 0 for never."""
    test = RiseTest(settings)
    for number, value_n in enumerate(values_n, start=1):
        test.observe(number * PERIOD_NS, value_n, noise_n, MODEL_N, PERIOD_S)
        if test.is_decided:
            return number
    return 0


# --- the test ------------------------------------------------------------------------------------------------------


def false_alarms(settings: GraspSettings, readings: int, seed: int) -> int:
    """Count how often free motion is called a contact; its errors are as large as the test is told."""
    rng, test, found, was_decided = random.Random(seed), RiseTest(settings), 0, False
    model_n = 0.0
    for number in range(readings):
        if number % 10 == 0:  # one error of the model per window of the test
            model_n = rng.gauss(0.0, MODEL_N)
        test.observe(number * PERIOD_NS, model_n + rng.gauss(0.0, NOISE_N), NOISE_N, MODEL_N, PERIOD_S)
        found += test.is_decided and not was_decided
        was_decided = test.is_decided
    return found


def test_false_alarms_come_no_more_often_than_the_settings_say() -> None:
    """One in 0.5 s is stated: a rate that can be counted. 20,000 readings are 200 s, so at most 400 of them."""
    often = replace(SETTINGS, false_alarm_s=0.5, min_contact_tension_n=0.1)
    found = false_alarms(often, 20_000, seed=1)
    assert 20 < found <= 400  # the bound holds, and is not kept by never deciding anything


def test_free_motion_is_called_free_for_minutes() -> None:
    assert false_alarms(SETTINGS, 30_000, seed=2) == 0


@pytest.mark.parametrize(("strength_n", "readings"), [(5.0, 3), (1.0, 3), (0.5, 3)])
def test_a_strong_contact_takes_three_readings(strength_n: float, readings: int) -> None:
    """exp(-4.6) of all readings are wild; the level of one false alarm an hour is ln(360,000) = 12.8."""
    assert decided_after([strength_n] * 20) == readings


def test_a_weak_contact_takes_as_many_readings_as_it_takes_to_average_the_noise() -> None:
    """0.5 N with a noise of 0.3 N: 12.8 = 0.5^2 / 2 (0.05^2 + 0.3^2 / n) for n = 12.4; the window has 20."""
    long = replace(SETTINGS, test_window_s=0.2)
    assert decided_after([0.5] * 20, long, noise_n=0.3) == 13
    assert decided_after([0.5] * 20, replace(long, false_alarm_s=1.0), noise_n=0.3) < 13


def test_one_wild_reading_is_no_contact_however_wild() -> None:
    assert decided_after([0.0, 0.0, 30.0, 0.0, 0.0, 0.0, 30.0, 0.0]) == 0
    assert decided_after([30.0], replace(SETTINGS, wild_share=1e-9)) == 1


def test_an_error_that_all_readings_share_does_not_add_up() -> None:
    """Three sigma of the model's error stay three sigma in every reading: 0.15 N for a second decide nothing."""
    assert decided_after([3.0 * MODEL_N] * 100, replace(SETTINGS, min_contact_tension_n=0.05)) == 0


def test_what_is_below_the_smallest_contact_is_none_however_sure() -> None:
    assert decided_after([0.34] * 100, noise_n=0.001) == 0
    assert decided_after([0.36] * 100, noise_n=0.001) == 3


def test_a_contact_that_ends_has_to_begin_again_and_one_reading_ends_none() -> None:
    test, since = RiseTest(SETTINGS), []
    for number, value_n in enumerate([0.0, 2.0, 2.0, 2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0]):
        test.observe(number, value_n, NOISE_N, MODEL_N, PERIOD_S)
        since.append(test.since_ns if test.is_decided else None)
    assert since == [None, None, None, 1, 1, 1, 1, 1, None, None, None, 9]


def test_the_strength_is_what_no_reading_of_a_decision_lacks() -> None:
    test, strength_n = RiseTest(SETTINGS), []
    for number, value_n in enumerate([3.0, 3.0, 1.0, 2.0, 2.5]):
        test.observe(number, value_n, NOISE_N, MODEL_N, PERIOD_S)
        strength_n.append(test.strength_n)
    assert strength_n == [-math.inf, -math.inf, 1.0, 1.0, 1.0]


# --- states --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pulled_length_m", "contact_n", "state"),
    [
        (0.002, 5.0, ContactState.UNKNOWN),
        (0.010, 0.0, ContactState.FREE),
        (0.010, 5.0, ContactState.BLOCKED),
        (0.0193, 9.0, ContactState.CONTACT),
        (0.0193, 0.0, ContactState.FREE),
        (0.020, 9.0, ContactState.END_STOP),
        (0.020, 0.0, ContactState.END_STOP),
    ],
)
def test_where_a_finger_is_and_what_it_feels_make_its_state(
    task, bench, pulled_length_m: float, contact_n: float, state: ContactState
) -> None:
    """The path ends at 20 mm; nearer to it than 0.8 mm a finger's own stops may hold it."""
    references = task("orange").references
    estimator = ContactEstimator(("index", "middle", "thumb"), references, (0.020,) * 3, SETTINGS)
    made = bench()
    for _ in range(4):
        pair = made.pair()
        tension_n = references[0].tension(pulled_length_m)
        predicted_n = tension_n - references[0].offset(pulled_length_m)
        pair = replace(
            pair,
            sample=replace(pair.sample, pulled_length_m=(pulled_length_m,) * 3, tension_n=(tension_n + contact_n,) * 3),
            free=replace(pair.free, pulled_length_m=(pulled_length_m,) * 3, tension_n=(predicted_n,) * 3),
        )
        contacts = estimator.estimate(pair, commanded=(0, 1, 2))
    assert [contact.state for contact in contacts] == [state] * 3


# --- creep ---------------------------------------------------------------------------------------------------------


def followed(differences_n: Sequence[float], prepared_n: Sequence[float] = ()) -> CreepFilter:
    """The filter after these differences, one a period of a closing."""
    creep = CreepFilter(SETTINGS)
    for difference_n in prepared_n:
        creep.prepare(difference_n)
    for sample, difference_n in enumerate(differences_n):
        creep.follow(difference_n, 0.003 + sample * TRAVEL_M, NOISE_N**2, 0.5)
    return creep


def test_creep_is_followed_no_faster_than_creep_can_be() -> None:
    """A fall of 0.5 N in one sample is not creep: 120 N/m times 0.1 mm are, a sample."""
    assert followed([0.0] * 10 + [-0.5] * 3).value_n == pytest.approx(-3 * 120.0 * TRAVEL_M)


def test_a_closing_that_begins_with_a_fall_starts_from_before_it() -> None:
    assert followed([-0.5], [-0.1, -0.2, -0.1, -0.2, -0.5, -0.5]).value_n == pytest.approx(-0.2)
    assert followed([-0.4]).value_n == pytest.approx(-0.4)


@pytest.mark.parametrize("slope", [-100.0, 100.0])
def test_creep_along_the_path_is_followed_within_its_stated_deviation(slope: float) -> None:
    """0.1 N a millimetre either way, what TPU at its worst loses over a path."""
    creeping = [slope * TRAVEL_M * sample for sample in range(100)]
    creep = followed(creeping)
    assert abs(creep.value_n - creeping[-1]) < 3.0 * math.sqrt(creep.variance_n2)
    assert math.sqrt(creep.variance_n2) < NOISE_N


def test_the_deviation_grows_while_a_contact_hides_the_creep() -> None:
    before = followed([0.0] * 50).variance_n2
    hidden = followed([0.0] * 50 + [5.0] * 20)
    assert hidden.value_n == pytest.approx(0.0)
    assert hidden.variance_n2 - before == pytest.approx(20 * (120.0 * TRAVEL_M) ** 2, rel=1e-6)


@pytest.mark.parametrize(("first_n", "taken_n"), [(5.0, 0.3), (-5.0, -2.0), (0.1, 0.1)])
def test_what_a_closing_begins_with_is_taken_for_creep_within_bounds_only(first_n: float, taken_n: float) -> None:
    """A product that is touched from the start must not count as this finger's own tension."""
    assert followed([first_n], [first_n] * 7).value_n == pytest.approx(taken_n)


# --- late drives ---------------------------------------------------------------------------------------------------


def deviation_after(intervals_ms: Sequence[float], speed_m_per_s: float = 0.01) -> list[float]:
    """Standard deviation that the late drive adds after each interval [N]."""
    late, found, now_ns, pulled_length_m = LateDrive(SETTINGS), [], 0, 0.0
    late.observe(now_ns, (pulled_length_m,))
    for interval_ms in intervals_ms:
        now_ns += round(interval_ms * 1e6)
        pulled_length_m += speed_m_per_s * interval_ms * 1e-3
        late.observe(now_ns, (pulled_length_m,))
        found.append(late.stddev_n[0])
    return found


def test_a_late_sample_widens_the_uncertainty_by_what_the_drive_is_behind_and_it_dies_away() -> None:
    """10 ms late at 10 mm/s are 0.1 mm behind: 0.45 N; e times less after 60 ms."""
    found = deviation_after([10.0] * 9 + [20.0] + [10.0] * 6)
    assert found[8] == 0.0
    assert found[9] == pytest.approx(4500.0 * 1e-4, rel=1e-6)
    assert found[15] == pytest.approx(4500.0 * 1e-4 / math.e, rel=1e-3)


def test_a_punctual_drive_or_one_that_stands_is_as_certain_as_ever() -> None:
    assert deviation_after([10.0] * 30) == [0.0] * 30
    assert deviation_after([10.0] * 9 + [50.0] * 3, speed_m_per_s=0.0) == [0.0] * 12


def surge(*from_m: float) -> Callable[[float], float]:
    """Tension [N] that a late drive shows beside its tendon's, by pulled length: a surge that dies in 0.2 mm."""

    def beside_n(pulled_length_m: float) -> float:
        behind_m = min((pulled_length_m - each for each in from_m if pulled_length_m >= each), default=math.inf)
        return 0.9 * math.exp(-behind_m / 0.0002)

    return beside_n


@pytest.mark.parametrize("is_shown", [True, False], ids=["late stamps", "punctual stamps"])
def test_the_surge_of_a_late_drive_presses_on_nothing_where_its_stamps_show_it(task, bench, is_shown: bool) -> None:
    """0.9 N is 0.2 mm behind; the same surge with punctual stamps is a contact: nothing else speaks against it."""
    from_m = (0.0060, 0.0085, 0.0110)
    made, sequence = bench(drive_n=surge(*from_m), noise_n=0.04, seed=1), GraspSequence(task("egg"), SETTINGS)
    made.obey(sequence.start())
    late = list(from_m)
    touched = False
    while made.pulled_length_m[0] < 0.0125:
        if is_shown and late and made.pulled_length_m[0] + 0.0001 >= late[0]:
            late.pop(0)
            speed = made._goal.speed_m_per_s
            made.now_ns += round(0.0002 / speed * 1e9)
            made.pulled_length_m = [pulled + 0.0002 for pulled in made.pulled_length_m]
        step = sequence.observe(made.pair())
        made.obey(step)
        touched = touched or step.contact
        if step.verdict is not None:
            break
    assert touched is not is_shown


@pytest.mark.parametrize("seed", [2, 30, 36])
def test_samples_that_come_late_are_no_loss_of_what_is_pressed(task, bench, seed: int) -> None:
    """One of five comes 20 to 100 ms late while the drives go on, as on a busy computer; the object stays."""
    made, jitter = bench(contact_m=(0.008, 0.009, 0.0085), seed=seed), random.Random(seed)
    sequence = GraspSequence(task("orange"), SETTINGS)
    step, end_ns = sequence.start(), made.now_ns + 30 * NANOSECONDS
    while step.verdict is None and made.now_ns < end_ns:
        made.obey(step)
        late = jitter.randint(4, 20) if jitter.random() < 0.2 else 0
        step = sequence.observe(made.pair((1 + late) * 5_000_000))
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.GRIPPED, step.verdict.reason


@pytest.mark.parametrize("seed", range(3))
def test_a_contact_is_pressed_not_before_it_is_there(run, task, bench, seed: int) -> None:
    made = bench(contact_m=(0.008,) * 3, noise_n=0.04, seed=seed)
    for step in run(GraspSequence(task("orange"), SETTINGS), made):
        if any(isinstance(command, Press) for command in step.commands):
            assert min(made.pulled_length_m) >= 0.008
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.GRIPPED
