# SPDX-License-Identifier: Apache-2.0
"""Homing as the one motion it is, with what the drive reports written by hand."""

import dataclasses
import math
import random

import pytest

from softgrip_driver.tendon.homing import ZERO_ACCURACY, Homing, HomingSample, _Phase, knee
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, MotionStep

LIMITS = TendonLimits(homing_speed=0.014, release_speed=0.03)
PERIOD = 0.01  # [s]
STIFFNESS = 500.0  # [N/m] of the tendon once it is taut
GEARS = 0.1  # [N] that turning the gears takes
TAUT = 0.002  # [m]


class Finger:
    """A drive that a spring pulls back once it has wound in so far: a mass, a controller of its position, a limit.

    m a = F - c v - k max(0, x - taut), where F = kp (goal - x) - kd v within the limit is what the current shows.

    Args:
        damping: of the controller, as a share of the critical one: below 1 it overshoots where it gets going.
        pauses_at: [m] where the bus pauses once: for that time the drive has an old goal and is not read.
        pauses_for: [s].
        frequency: of the controller [rad/s].
        braking: [N] that is read less while it is more than a tenth too fast.
        teeth: how much harder and easier the gears turn in each millimetre [N].
        away: how long it pauses before each period besides [s].
        taut: [m] where the tendon becomes taut.
        gears: [N] that is read while nothing pulls.
    """

    MASS = 1.5  # [kg] of a spool of 10 mm radius on gears of 288:1
    FRICTION = 20.0  # [N s/m]
    STEP = 0.001  # [s]

    def __init__(
        self,
        damping=1.0,
        pauses_at=None,
        pauses_for=0.1,
        taut=TAUT,
        gears=GEARS,
        frequency=60.0,
        braking=0.0,
        teeth=0.0,
        away=None,
    ):
        self._frequency, self._teeth = frequency, teeth
        self._damping, self._taut, self._gears, self._braking = damping, taut, gears, braking
        self._pauses_at, self._pauses_for, self._away = pauses_at, pauses_for, away or (lambda: 0.0)
        self.length = self.speed = self.force = self.furthest_out = self.now = 0.0

    def view(self, asked):
        """What the drive shows a period after it has been asked for a length [m] and a limit [N]."""
        letting_out = asked.pulled_length_m < self.length
        pauses = self._pauses_at is not None and not letting_out and self.length >= self._pauses_at
        if pauses:
            self._pauses_at = None
        period = PERIOD + pauses * self._pauses_for + self._away()
        self.now += period
        before = self.speed
        for _ in range(round(period / self.STEP)):
            self._live(asked)
        self.furthest_out = min(self.furthest_out, self.length)
        pull = self.force + self._gears - self._braking * (self.speed > 1.1 * LIMITS.homing_speed)
        late = min(period, 2.0 * PERIOD)
        faster = (self.speed - before) / period
        return DriveObservation(
            self.now, late, self.length, self.speed, max(0.0, pull), pull, 45.0, acceleration=faster
        )

    def _live(self, asked):
        damping = 2.0 * self._damping * self.MASS * self._frequency
        force = self.MASS * self._frequency**2 * (asked.pulled_length_m - self.length) - damping * self.speed
        # the device limits its current, which is what is read
        self.force = min(max(force, -asked.tension_limit - self._gears), asked.tension_limit - self._gears)
        held = self.FRICTION * self.speed + STIFFNESS * max(0.0, self.length - self._taut)
        held += self._teeth * math.sin(2.0 * math.pi * self.length / 1e-3)
        self.speed += (self.force - held) / self.MASS * self.STEP
        self.length += self.speed * self.STEP


def home(finger, limits=LIMITS):
    step = MotionStep(0.0, limits.tension_hold)
    homing = Homing(finger.view(step), limits)
    while homing.zero is None:
        assert finger.now < limits.homing_timeout
        step = homing.step(finger.view(step))
    return homing.zero


@pytest.mark.parametrize("damping", [1.0, 0.3, 0.15])
def test_a_drive_that_overshoots_where_it_turns_round_is_not_taken_for_one_that_pulls(damping):
    assert home(Finger(damping)) == pytest.approx(TAUT, abs=4e-4)


@pytest.mark.parametrize("teeth", [0.1, 0.25])
def test_a_drive_that_never_goes_evenly_finds_its_zero(teeth):
    """Gears of which each tooth is felt: the speed goes up and down by 0.5 and by 1.2 mm/s."""
    assert home(Finger(teeth=teeth)) == pytest.approx(TAUT, abs=7e-4)


@pytest.mark.parametrize("gears", [-0.6, -0.2, 0.3])
def test_what_is_read_while_nothing_pulls_does_not_move_the_zero(gears):
    """A current near nothing is read as a little pull, or as a little push: the knee is where it begins to change."""
    assert home(Finger(gears=gears)) == pytest.approx(TAUT, abs=3e-4)


@pytest.mark.parametrize("damping", [1.0, 0.3])
@pytest.mark.parametrize("pauses_for", [0.02, 0.1])
@pytest.mark.parametrize("pauses_at", [-0.004, -0.0006, 0.0, 0.0009, 0.0012, 0.0017, 0.0025])
def test_a_bus_that_pauses_on_the_way_does_not_move_the_zero(pauses_at, pauses_for, damping):
    """The drive stands meanwhile, catches up and is braked; where too little is left to see, it begins again."""
    assert home(Finger(damping, pauses_at, pauses_for)) == pytest.approx(TAUT, abs=5e-4)


@pytest.mark.parametrize(("share", "within"), [(0.1, 5e-4), (0.3, ZERO_ACCURACY)])
@pytest.mark.parametrize("seed", range(10))
def test_a_computer_that_is_taken_away_again_and_again_does_not_move_the_zero(share, within, seed):
    """10 to 35 ms at a time, as a hypervisor does that has promised its processors to others as well."""
    rng = random.Random(seed)
    often = share * PERIOD / 0.0225
    finger = Finger(0.5, away=lambda: rng.uniform(0.010, 0.035) if rng.random() < often else 0.0)
    assert home(finger) == pytest.approx(TAUT, abs=within)


@pytest.mark.parametrize("braking", [0.0, 0.8, 2.0])
def test_braking_after_the_turn_is_not_the_step_of_a_taut_tendon(braking):
    """A slow controller overshoots for long, and gears that their mass drives take less current than it alone would."""
    assert home(Finger(0.15, frequency=15.0, braking=braking)) == pytest.approx(TAUT, abs=5e-4)


@pytest.mark.parametrize(("seen", "again"), [(0.0003, True), (0.0005, True), (0.0012, False), (0.0040, False)])
def test_it_looks_again_from_further_out_where_it_saw_less_than_a_millimetre_of_slack(seen, again):
    """A finger that stood wound in: letting out by the slack's travel leaves little to see behind the run-up.

    What it saw is where it was taut, less where it began to wind in and what it takes to get going.
    """
    began = -LIMITS.slack_travel
    taut = began + Homing.RUN_UP + LIMITS.homing_speed * (PERIOD + Homing.EVEN_FOR) + seen
    finger = Finger(taut=taut)
    assert home(finger) == pytest.approx(taut, abs=5e-4)
    assert bool(finger.furthest_out < began - 1e-3) == again


@pytest.mark.parametrize(("release_speed", "speed"), [(0.020, 0.020), (0.028, 0.028), (0.100, 0.028)])
def test_letting_out_is_as_quick_as_a_release_but_not_quicker_than_twice_the_homing(release_speed, speed):
    """Only the winding in is measured; 8 mm at up to 28 mm/s and the time to get up to speed."""
    limits = dataclasses.replace(LIMITS, release_speed=release_speed)
    finger = Finger()
    step = MotionStep(0.0, limits.tension_hold)
    homing = Homing(finger.view(step), limits)
    began = finger.now
    while step.pulled_length_m > -LIMITS.slack_travel:
        step = homing.step(finger.view(step))
    minimum = LIMITS.slack_travel / speed
    assert minimum < finger.now - began < minimum + 2.0 * speed / LIMITS.acceleration


def wound_in(taut, end, friction=0.0, rise=700.0, braking=0.0, jerk=0.0):
    """Samples of a drive at 14 mm/s and 100 Hz, every 0.14 mm: F = -1 N, and from `taut` on friction and a rise."""
    noise = random.Random(1)
    lengths = [-6e-3 + 1.4e-4 * number for number in range(math.ceil((end + 6e-3) / 1.4e-4))]
    samples = []
    for number, length in enumerate(lengths):
        pulled = friction + rise * (length - taut) if length > taut else 0.0
        # braked for 2 mm after the turn, the last 0.4 of them less and less
        braked = braking * min(1.0, max(0.0, (-4e-3 - length) / 4e-4))
        jerked = jerk if 20 <= number < 26 else 0.0
        samples.append(HomingSample(length, 0.0, -1.0 + pulled - braked + jerked + noise.gauss(0.0, 0.05)))
    return samples


@pytest.mark.parametrize(
    ("end", "what"),
    [
        (4.4e-3, {}),
        (4.4e-3, {"friction": 1.0, "rise": 400.0}),
        (4.4e-3, {"rise": 600.0, "jerk": 2.5}),
        (4.6e-3, {"friction": 0.3, "braking": 0.6}),
        (4.6e-3, {"friction": 0.6, "braking": 0.8}),
        (4.6e-3, {"friction": 1.0, "braking": 1.0}),
    ],
    ids=["rise", "friction", "jerk", "little braking", "braking", "much braking"],
)
def test_the_knee_is_where_the_tendon_begins_to_pull(end, what):
    taut = 3.4e-3 if "braking" in what else 2e-3
    assert knee(wound_in(taut, end, **what), end) == pytest.approx(taut, abs=3e-4)


def seen(kept):
    homing = Homing(Finger().view(MotionStep(0.0, 1.0)), LIMITS)
    homing._samples = [sample for sample in wound_in(2e-3, 5e-3) if kept(sample.pulled_length_m)]
    return homing._shows(2e-3)


@pytest.mark.parametrize(
    ("kept", "shows"),
    [
        (lambda _: True, True),
        (lambda x: x > 1.2e-3, False),
        (lambda x: x < 0.8e-3 or x > 2.1e-3, False),
        (lambda x: x < 1.9e-3 or x > 3.2e-3, False),
        (lambda x: x < 2.8e-3, False),
        (lambda x: x < 2.0e-3, False),
    ],
    ids=["all", "little slack", "gap before", "gap behind", "rise too short", "no rise"],
)
def test_what_samples_have_to_show_of_a_knee(kept, shows):
    assert bool(seen(kept)) == shows


def test_too_few_samples_send_it_further_out():
    """A drive that stands taut at once, wherever it winds in, lets out further the second time."""
    now, length, goals = 0.0, 0.0, []
    homing = Homing(DriveObservation(now, PERIOD, length, 0.0, 0.0, 0.0, 45.0), LIMITS)
    while homing._again == Homing.AGAIN or goals[-1] <= goals[-2]:
        now += PERIOD
        taut = homing._phase is not _Phase.LET_OUT
        tension = LIMITS.homing_tension if taut else 0.0
        goals.append(homing.step(DriveObservation(now, PERIOD, length, 0.0, tension, tension, 45.0)).pulled_length_m)
        length = length if taut else goals[-1]
        assert now < LIMITS.homing_timeout
    assert min(goals) == pytest.approx(-2.5 * LIMITS.slack_travel, abs=1e-4)


def test_what_the_device_limits_is_not_listened_to():
    """The force is constant there, and the tendon's rise goes on."""
    finger, step = Finger(), MotionStep(0.0, LIMITS.tension_hold)
    homing, shown = Homing(finger.view(step), LIMITS), []
    while homing.zero is None:
        view = finger.view(step)
        shown.append(view.pull)
        step = homing.step(view)
    assert max(shown) == pytest.approx(LIMITS.homing_tension)
    assert max(sample.force for sample in homing._samples) < 0.95 * LIMITS.homing_tension


def test_a_spool_that_winds_the_other_way_is_named_before_it_pulls_hard():
    """Letting out winds in then: against the taut tendon the drive needs a force outwards, as no tendon ever does."""
    homing = Homing(DriveObservation(0.0, PERIOD, 0.0, 0.0, 0.0, 0.0, 45.0), LIMITS)
    length, now, hardest = 0.0, 0.0, 0.0
    for _ in range(400):
        now += PERIOD
        length -= 0.02 * PERIOD
        pull = -max(0.0, -STIFFNESS * 3.0 * (length + 0.002))
        step = homing.step(DriveObservation(now, PERIOD, length, -0.02, 0.0, pull, 45.0))
        hardest = max(hardest, -pull)
        if step.outcome is not None:
            break
    assert step.fault == "homing_failed"
    assert "directions" in step.reason
    assert hardest < 8.0
