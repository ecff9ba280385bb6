# SPDX-License-Identifier: Apache-2.0
"""A taut tendon of which nothing is felt any more: named whenever it happens, and nothing is wound in meanwhile.

Drives whose tension a gauge reads some ten times a second, where a broken tendon and a cut cell look alike; and an
XL330, whose tension is an estimate.
"""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from softgrip_driver.tendon.gripper import MoveMode
from softgrip_driver.tendon.guard_set import GuardSet
from softgrip_driver.tendon.guards import CollapseGuard
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, Hold, MoveOutcome, MoveToLength

LIMITS = TendonLimits()
DT = 0.1
WHERE = 0.01


def named_at(readings: Iterable[float], way: float = 0.0, *, winds_in: bool = False) -> int | None:
    """Return the number of the reading [N] that names a collapse, ``way`` [m] further in with each; None for none."""
    guard = CollapseGuard(LIMITS)
    for number, pull in enumerate(readings):
        if guard.step(number * DT, pull, WHERE + number * way, is_wound_in=winds_in):
            return number
    return None


# -- what readings say -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "before",
    [[8.0, 8.0], [0.0, 0.0, 0.0, 0.0, 4.5, 9.0], [0.0, 3.1, 8.0], [8.0, 8.0, 6.0, 1.5]],
    ids=["held", "a quick closing", "just above", "a gauge that averages"],
)
def test_two_readings_of_a_tension_and_three_of_nothing_are_a_collapse(before: list[float]) -> None:
    """Third reading of nothing: the number of those before it, and two."""
    assert named_at([*before, 0.0, 0.02, -0.03, 0.0]) == len(before) + 2


@pytest.mark.parametrize(
    "readings",
    [
        [0.0, 8.0, 0.0, 0.0, 0.0, 0.0],
        [8.0, 8.0, 0.0, 0.0, 8.0, 8.0] * 5,
        [8.0, 0.0] * 10,
        [8.0 + 5.5 * (-1) ** number for number in range(40)],
        [8.0 - 0.25 * number for number in range(32)] + [0.0] * 9,
        [2.9, 2.9, 0.0, 0.0, 0.0],
        [8.0, 8.0, 1.1, 1.1, 1.1],
        [8.0, 8.0, -8.0, -8.0, -8.0],
        [0.02 * (-1) ** number for number in range(40)],
    ],
    ids=[
        "one wild reading", "dips of two readings", "every other one", "a tension that pulsates", "one that fades",
        "less than 3 N", "a finger's own joints", "a reversed cell", "a slack tendon",
    ],
)  # fmt: skip
def test_what_is_no_collapse(readings: list[float]) -> None:
    assert named_at(readings) is None


def test_a_little_that_vanishes_while_it_should_grow_is_missed() -> None:
    """Twice the 0.5 N of a slack tendon; at rest a hand that pushes a finger may take as much away."""
    assert named_at([1.1, 1.2, 0.0, 0.0, 0.0], 3e-4, winds_in=True) == 4
    assert named_at([0.9, 0.9, 0.0, 0.0, 0.0], 3e-4, winds_in=True) is None
    assert named_at([1.1, 1.2, 0.0, 0.0, 0.0]) is None


@pytest.mark.parametrize(("way", "named"), [(-1e-5, True), (-3e-4, False), (-1.5e-3, False)])
def test_a_tension_that_was_let_out_has_not_collapsed(way: float, named: bool) -> None:
    """0.2 mm may be an encoder's; in six readings 1.8 mm are let out, or 9 mm."""
    assert (named_at([8.0, 8.0, 0.0, 0.0, 0.0, 0.0], way) is not None) is named


def test_a_drive_that_gives_way_after_the_tension_vanished_has_let_it_out() -> None:
    """As where it lags behind its readings: 0.3 mm more than an encoder's 0.2."""
    for way, named in ((1e-4, True), (3e-4, False)):
        guard = CollapseGuard(LIMITS)
        found = [guard.step(n * DT, pull, WHERE, is_wound_in=False) for n, pull in enumerate([8.0, 8.0, 0.0, 0.0])]
        found += [guard.step(n * DT, 0.0, WHERE - way, is_wound_in=False) for n in range(4, 9)]
        assert any(found) is named
        assert guard.suspects is named


def test_a_reading_that_lags_behind_a_release_has_not_collapsed() -> None:
    """The stage stands, and an amplifier that is 0.3 s late shows the last of 8 N that were let out at 15 mm/s."""
    assert named_at([6.75, 4.5, 2.25, 0.0, 0.0, 0.0, 0.0]) is None


def test_it_takes_no_less_time_than_the_limit_asks_for() -> None:
    """0.04 s: 9 readings at 200 a second."""
    guard = CollapseGuard(LIMITS)
    found = [guard.step(0.005 * n, 8.0 if n < 10 else 0.0, WHERE, is_wound_in=False) for n in range(40)]
    assert found.index(True) == pytest.approx(10 + 8, abs=1)


def seen(now: float, pull: float, **others: bool) -> DriveObservation:
    return DriveObservation(now, DT, WHERE, 0.0, max(0.0, pull), pull, 35.0, **others)


@pytest.mark.parametrize(("before", "fault"), [(8.0, "tendon_broken"), (1.5, "tendon_slack")])
def test_a_gauge_s_collapse_names_the_tendon_and_the_cell_and_what_to_do(before: float, fault: str) -> None:
    watch, motion = GuardSet(LIMITS, 20.0, DT), MoveToLength(0.03, 0.02, 35.0, seen(0.0, before), LIMITS)
    pulls = [before] * 3 + [0.0] * 3
    found = [watch.finds(seen(n * DT, pull, is_gauged=True), motion, 35.0, homed=False) for n, pull in enumerate(pulls)]
    assert found[:-1] == [None] * 5
    assert found[-1] is not None
    name, reason = found[-1]
    assert name == fault
    for text in (f"from {before:.1f} N to 0.0 N", "look at the tendon", "whole and taut", "load cell's cable"):
        assert text in reason


def test_the_next_opening_forgets_a_suspicion() -> None:
    watch, opening = GuardSet(LIMITS, 20.0, DT), MoveToLength(0.0, 0.02, 35.0, seen(0.0, 8.0), LIMITS)
    for n, pull in enumerate([8.0, 8.0, 0.0]):
        watch.finds(seen(n * DT, pull, is_gauged=True), Hold(WHERE, 35.0), 35.0, homed=True)
    assert watch.suspects_collapse
    assert watch.finds(seen(3 * DT, 0.0, is_gauged=True), opening, 35.0, homed=True) is None
    assert not watch.suspects_collapse


# -- on the stages -----------------------------------------------------------------------------------------------------

STAGES = {"mark10": ("mark10", "gcl2", 0.05), "grbl": ("grbl", "raw", 0.1)}
WAITS = [0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0]
#: cycles until the third reading of nothing, and one that had begun
CYCLES = 4


@pytest.fixture(params=STAGES)
def stage(request, benches, tmp_path, world):
    """An opened stage, and its period [s]."""
    kind, gauge, period = STAGES[request.param]
    bench = benches[1](tmp_path, world, kind, gauge).open()
    yield bench, period
    bench.close()


def wind_in(bench, speed: float, force: float) -> None:
    """Wind in at a speed [m/s] until the tendon pulls with a force [N]."""
    bench.loop.power(on=True)
    bench.loop.mark_session("pull", 1)
    bench.loop.call(lambda c, _: c.drives["pull"].set_zero(bench.plant.slack, 1))
    bench.move([0.025], speed)
    assert bench.until(lambda _: bench.plant.force >= force, 10.0)


def watched_from(bench, cause: str, duration: float = 5.0) -> tuple[float, str, float, float]:
    """Cause a fault; return [s] until it is named, its name, and what was wound in [m] and pulled [N] at most after."""
    where, began = bench.plant.travel, bench.cause(cause)
    furthest, force, named = where, 0.0, None
    while bench.now() < began + duration:
        bench.loop.since(bench.loop.snapshot.sequence, 0.1)
        furthest, force = max(furthest, bench.plant.travel), max(force, bench.plant.force)
        snapshot = bench.loop.snapshot
        if named is None and snapshot.drives[0].fault:
            named = (bench.now() - began, snapshot.drives[0].fault)
    assert named is not None, "nobody named it"
    return *named, furthest - where, force


@pytest.mark.parametrize("cause", ["tendon_break", "cell_cut"])
@pytest.mark.parametrize("wait", WAITS)
def test_what_happens_soon_after_the_tension_was_reached_is_named(stage, wait: float, cause: str) -> None:
    bench, period = stage
    bench.hold_taut(8.0)
    if wait:
        bench.pass_time(wait)
    after, name, way, force = watched_from(bench, cause)
    assert name == "tendon_broken"
    assert after <= CYCLES * period
    assert way < 1e-4, "a stage that holds has no reason to wind in"
    assert force < 8.8
    assert "the load cell's cable" in bench.drive("pull").fault_reason


@pytest.mark.parametrize("cause", ["tendon_break", "cell_cut"])
@pytest.mark.parametrize("speed", [0.003, 0.005, 0.010, 0.015])
@pytest.mark.parametrize("force", [4.0, 8.0])
def test_what_happens_while_winding_in_stops_it_at_the_first_reading_of_nothing(
    stage, force: float, speed: float, cause: str
) -> None:
    """What is wound in: one period, with the setpoint's speed and the fifth by which the stage is faster."""
    bench, period = stage
    # Two readings have to show it.
    wind_in(bench, speed, max(force, 3.0 + 2 * period * speed * 1500.0))
    before = bench.plant.force
    after, name, way, pulled = watched_from(bench, cause)
    assert name == "tendon_broken"
    assert after <= CYCLES * period
    assert way <= 1.2 * speed * period + 1e-4
    assert pulled <= before + 1500.0 * way + 0.1


def test_a_cell_cut_at_little_tension_stops_the_stage_too(stage) -> None:
    """9 mm and 14 N where only a length without tension tells it."""
    bench, period = stage
    wind_in(bench, 0.003, 2.0)
    after, name, way, force = watched_from(bench, "cell_cut")
    assert (name, after <= CYCLES * period) == ("tendon_slack", True)
    assert way < 1e-3
    assert force < 4.0
    ticket = bench.move([0.02], 0.003)
    assert bench.run(ticket)[0] is MoveOutcome.FAULT
    assert bench.plant.force < 4.0, "the next command must not go on blind"


def test_after_a_collapse_nothing_is_homed_before_a_hand_has_proven_the_cell(benches, tmp_path, world) -> None:
    bench = benches[1](tmp_path, world, "grbl", "raw", 2.0).open()
    for force in (0.0, 5.0, 0.0):
        bench.plant.pull_by_hand(force)
        bench.pass_time(1.0)
    bench.loop.power(on=True)
    assert bench.run(bench.loop.call(lambda c, now: c.home(now)), 25.0)[0] is MoveOutcome.REACHED
    assert bench.run(bench.move([8.0], 0.01, mode=MoveMode.TENSION))[0] is MoveOutcome.REACHED
    watched_from(bench, "cell_cut")
    bench.reset()
    assert bench.until(lambda now: now.drives[0].fault == "gauge_unproven"), bench.drive("pull")
    held = bench.plant.force
    assert bench.run(bench.loop.call(lambda c, now: c.home(now)), 25.0)[0] is MoveOutcome.REFUSED
    assert bench.plant.force == pytest.approx(held, abs=0.1)
    bench.close()


@pytest.mark.parametrize(
    ("kind", "gauge", "stiffness"),
    [("mark10", "gcl2", 1500.0), ("grbl", "raw", 1500.0), ("grbl", "olkal_read", 1500.0), ("mark10", "gcl2", 300.0)],
)
def test_closings_reversals_and_openings_that_are_cut_short_lose_no_tension(
    benches, tmp_path, world, kind, gauge, stiffness
) -> None:
    rng = random.Random(7)
    bench = benches[1](tmp_path, world, kind, gauge)
    bench.plant._stiffness = stiffness
    bench.open()
    wind_in(bench, 0.005, 1.0)
    faults = set()
    for _ in range(60):
        if rng.random() < 0.4:
            ticket = bench.move([rng.uniform(0.0, 8.0)], rng.uniform(0.002, 0.015), mode=MoveMode.TENSION)
        else:
            ticket = bench.move([rng.uniform(-0.003, 0.008)], rng.uniform(0.002, 0.015), rng.choice([3.0, 8.0, 15.0]))
        if rng.random() < 0.5:
            bench.pass_time(rng.uniform(0.05, 1.0))
        else:
            bench.run(ticket)
        if rng.random() < 0.1:
            bench.loop.call(lambda c, _: c.drives["pull"].cancel_motion("a test"))
        faults.add(bench.drive("pull").fault)
    bench.close()
    assert not faults & {"tendon_broken", "tendon_slack"}


# -- an estimate -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wait", WAITS)
def test_an_xl330_names_a_break_whenever_it_comes(bench, wait: float) -> None:
    """40 ms that it must last, the median's two samples, and the motor that runs away first: 0.1 s."""
    bench.hold_taut(8.0)
    if wait:
        bench.pass_time(wait)
    began = bench.cause("tendon_break", slot="index")
    assert bench.until(lambda now: now.drives[0].fault == "tendon_broken", 5.0)
    assert bench.now() - began < 0.11


def test_an_xl330_stops_soon_after_a_break_while_it_winds_in(bench) -> None:
    """Beyond 8 mm a tendon without tension is slack; which of the two it is called is open."""
    bench.hold_taut(0.0)
    bench.move([0.030] * 3, 0.02)
    assert bench.until(lambda _: bench.plant.bank.tension_n[0] >= 8.0, 10.0)
    began = bench.cause("tendon_break", slot="index")
    assert bench.until(lambda now: now.drives[0].fault in {"tendon_broken", "tendon_slack"}, 5.0)
    assert bench.now() - began < 0.15
    assert "load cell" not in bench.drive("index").fault_reason
