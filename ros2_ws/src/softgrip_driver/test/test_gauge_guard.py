# SPDX-License-Identifier: Apache-2.0
"""A gauge that does not feel its tendon: nothing is wound in, on the stage and on the rig, and the cause has a name."""

from __future__ import annotations

import pytest

from softgrip_driver.errors import GaugeFaultError, LimitError
from softgrip_driver.faults import FAULTS
from softgrip_driver.rig.pull import PullSettings, Stroke, record_pull
from softgrip_driver.rig.slide import check_weight_at_rest
from softgrip_driver.stage.gauge_guard import BLIND_M, MAX_NEGATIVE_N, REST_READINGS, GaugeGuard
from softgrip_driver.tendon.motions import MoveOutcome

PROOF = 2.0
REST = [0.02, -0.03, 0.0, 0.05, -0.01]


def guard(*readings: float, proof: float = PROOF) -> str:
    made = GaugeGuard(proof)
    for pull in readings:
        made.observe(pull, 0.0)
    return made.fault[0]


def after_a_hand(*readings: tuple[float, float]) -> GaugeGuard:
    """A guard that a hand has proven, and what the gauge [N] showed where the stage was [m] then."""
    made = GaugeGuard(PROOF)
    for pull in (*REST, PROOF + 0.1, PROOF + 0.5, 0.0):
        made.observe(pull, -0.008)
    for pull, travel in readings:
        made.observe(pull, travel)
    return made


# -- what readings say -------------------------------------------------------------------------------------------------


def test_a_gauge_is_believed_once_a_hand_has_pulled() -> None:
    assert len(REST) == REST_READINGS
    assert guard() == "gauge_unproven"
    assert guard(*REST) == "gauge_unproven"
    assert guard(*REST, PROOF - 0.1) == "gauge_unproven"
    assert guard(*REST, PROOF + 0.1) == ""
    assert guard(*REST, PROOF + 0.1, 0.0, 0.0) == ""


def test_noise_of_a_cut_cell_proves_nothing() -> None:
    assert guard(*[(-1) ** n * 0.9 for n in range(400)]) == "gauge_unproven"


def test_a_reversed_cell_is_named_and_stays_so() -> None:
    assert guard(*REST, -PROOF - 0.1) == "gauge_reversed"
    assert guard(*REST, -PROOF - 0.1, 0.0, 5.0) == "gauge_reversed"


def test_a_taut_tendon_is_pulled_further_and_a_hand_that_lets_go_is_no_reversed_cell() -> None:
    taut = [10.0] * REST_READINGS
    assert guard(*taut, 11.0) == "gauge_unproven"
    assert guard(*taut, 12.1) == ""
    assert guard(*taut, 0.0) == "gauge_unproven"
    assert guard(*taut, 0.0, 2.1) == ""


TAUT_AND_LET_OUT = ((0.0, 0.0), (1.5, 0.010), (6.0, 0.020), (1.2, 0.009), (0.1, 0.007), (0.0, -0.008))


def test_a_gauge_that_shows_nothing_beyond_where_the_tendon_was_taut_has_to_be_proven_again() -> None:
    near, beyond = (0.0, 0.009 + BLIND_M - 1e-6), (0.0, 0.009 + BLIND_M + 1e-6)
    assert after_a_hand(*TAUT_AND_LET_OUT, *[near] * 9).fault == ("", "")
    assert after_a_hand(*TAUT_AND_LET_OUT, beyond, beyond).fault == ("", "")
    for shown in ((1.1, 0.013), near):
        assert after_a_hand(*TAUT_AND_LET_OUT, beyond, beyond, shown, beyond, beyond).fault == ("", "")
    cut = after_a_hand(*TAUT_AND_LET_OUT, beyond, beyond, beyond)
    assert cut.fault[0] == "gauge_unproven"
    assert "since it showed 0.00 N where the tendon was taut before" in cut.fault[1]
    for pull in (*REST, PROOF + 0.1, 0.0):
        cut.observe(pull, 0.020)
    assert cut.fault == ("", "")  # with a hand's pull; a new tendon may be taut elsewhere
    for travel in (0.021, 0.025, 0.030, 0.035):
        cut.observe(0.0, travel)
    assert cut.fault == ("", "")


@pytest.mark.parametrize(
    ("after", "name"),
    [((0.0, 0.020), "gauge_unproven"), ((0.0, 0.0199), "gauge_unproven"), ((0.0, 0.0195), ""), ((6.0, 0.020), "")],
    ids=["nothing where it was taut", "gone back by 0.1 mm", "let out", "still taut"],
)
def test_a_zero_lost_where_nothing_shows_a_taut_tendon_costs_the_proof(after: tuple[float, float], name: str) -> None:
    made = after_a_hand((6.0, 0.020), after)
    assert made.fault == ("", "")
    made.doubt()
    assert made.fault[0] == name


def test_a_hand_that_pulls_while_the_stage_stands_proves_the_gauge_once_more() -> None:
    """As where a finger is changed: the tendon of another one may be taut elsewhere."""
    touched = ((3.0, -0.008), (3.0, -0.008), (0.0, -0.008))
    assert after_a_hand(*TAUT_AND_LET_OUT, *touched, *[(0.0, 0.001 * n) for n in range(40)]).fault == ("", "")


def test_a_hand_that_still_pulls_does_not_show_where_the_tendon_is_taut() -> None:
    assert after_a_hand(*[(0.0, 0.04)] * 9).fault == ("", "")


def test_less_than_nothing_is_a_fault_by_the_third_reading_and_at_any_time() -> None:
    proven, low = (*REST, 3.0), -MAX_NEGATIVE_N - 0.1
    assert guard(*proven, low, low) == ""
    assert guard(*proven, low, low, low) == "gauge_negative"
    assert guard(*proven, low, low, 0.0, low) == ""
    assert guard(low, low, low) == "gauge_negative"
    assert guard(low, low, low, proof=0.0) == "gauge_negative"
    assert guard(*REST, proof=0.0) == ""


def test_every_fault_of_a_gauge_has_a_remedy() -> None:
    for name in ("gauge_unproven", "gauge_reversed", "gauge_negative"):
        assert FAULTS[name].remedy


# -- on the stage ------------------------------------------------------------------------------------------------------


@pytest.fixture
def stage(benches, tmp_path, world):
    """A stage whose gauge must be proven."""
    bench = benches[1](tmp_path, world, "grbl", "raw", PROOF)
    yield bench.open()
    bench.close()


def pull_by_hand(bench, force: float) -> None:
    """Wait a second, pull for one, and let go."""
    for value in (0.0, force, 0.0):
        bench.plant.pull_by_hand(value)
        since = bench.loop.snapshot.time
        assert bench.until(lambda seen, since=since: seen.time - since > 1.0)


def home(bench):
    bench.loop.power(on=True)
    return bench.run(bench.loop.call(lambda c, now: c.home(now, ["pull"])), 25.0)


def drive(bench):
    return bench.loop.snapshot.drives[0]


@pytest.mark.parametrize(
    ("fault", "name"), [("", "gauge_unproven"), ("cell_cut", "gauge_unproven"), ("cell_reversed", "gauge_reversed")]
)
def test_nothing_is_wound_in_before_the_gauge_has_felt_a_hand(stage, fault: str, name: str) -> None:
    if fault:
        stage.cause(fault)
        pull_by_hand(stage, 5.0)
    outcome, reason = home(stage)
    assert outcome is not MoveOutcome.REACHED
    assert drive(stage).fault == name
    assert FAULTS[name].remedy in reason
    assert stage.plant.travel == pytest.approx(0.0, abs=1e-6)
    assert stage.plant.force == 0.0


def test_a_hand_is_enough_to_home(stage) -> None:
    assert stage.until(lambda seen: seen.drives[0].fault == "gauge_unproven")
    pull_by_hand(stage, 5.0)
    assert stage.until(lambda seen: not seen.drives[0].fault)
    outcome, reason = home(stage)
    assert outcome is MoveOutcome.REACHED, reason


def test_a_cell_that_is_cut_after_its_proof_is_found_out_where_the_tendon_was_taut(stage) -> None:
    """Nothing tells it while the tendon is slack; `homing_travel_m` alone would let it pull 25 mm here."""
    pull_by_hand(stage, 5.0)
    outcome, reason = home(stage)
    assert outcome is MoveOutcome.REACHED, reason
    taut_at = stage.plant.travel
    stage.cause("cell_cut")
    outcome, reason = home(stage)
    assert outcome is MoveOutcome.FAULT
    assert drive(stage).fault == "gauge_unproven", reason
    assert FAULTS["gauge_unproven"].remedy in reason
    assert stage.plant.travel - taut_at < 0.010
    stage.clear()
    pull_by_hand(stage, 5.0)
    assert stage.until(lambda seen: not seen.drives[0].fault)


def test_opened_again_it_must_be_proven_again(stage) -> None:
    pull_by_hand(stage, 5.0)
    assert stage.until(lambda seen: not seen.drives[0].fault)
    stage.cause("unplugged", port="gauge")
    assert stage.until(lambda seen: seen.drives[0].fault == "port_lost", 5.0)
    stage.clear()
    assert stage.until(lambda seen: seen.drives[0].fault == "gauge_unproven", 10.0)


@pytest.fixture
def board(benches, tmp_path, world):
    """A stage with an HX711 board whose sketch tares itself when it boots."""
    bench = benches[1](tmp_path, world, "grbl", "olkal_read")
    yield bench.open()
    bench.close()


def test_a_board_that_tared_itself_under_load_is_found_out_before_anything_is_wound_in(board) -> None:
    """It boots with 8 N on its cell and shows 0 N: whoever believed it would pull 8 N more than asked for."""
    board.hold_taut(8.0)
    pulled_n = board.plant.force
    board.cause("board_reset")
    assert board.until(lambda seen: seen.drives[0].fault == "gauge_restarted", 10.0), drive(board)
    assert board.until(lambda seen: seen.drives[0].tension < 0.1, 5.0), drive(board)
    board.loop.reset(power=True)
    outcome, reason = home(board)
    assert outcome is MoveOutcome.FAULT
    assert "gauge reads less than nothing" in reason
    assert board.plant.force < pulled_n + 0.1


# -- on the rig --------------------------------------------------------------------------------------------------------


def rest(tension: float) -> Stroke:
    return Stroke(*([value] * 9 for value in (0.0, 0.0, tension)))


def test_the_hung_weight_must_be_felt_as_a_pull_before_the_rig_moves() -> None:
    check_weight_at_rest(rest(5.9), 0.6)
    check_weight_at_rest(rest(1.1), 0.6)  # friction at the largest angle hides four fifths
    check_weight_at_rest(rest(-0.2), 0.0)
    with pytest.raises(GaugeFaultError, match="the load cell is cut"):
        check_weight_at_rest(rest(0.02), 0.6)
    with pytest.raises(GaugeFaultError, match="change the sign of counts_per_newton"):
        check_weight_at_rest(rest(-5.9), 0.6)


class Rig:
    """A stage that goes where it is sent at once, and a gauge that shows what a test sets."""

    def __init__(self, tension: float) -> None:
        self.where, self.moved, self.shows = 0.0, 0, tension

    def travel(self) -> float:
        return self.where

    def tension(self) -> float:
        return self.shows

    def start(self, target: float, speed: float) -> None:
        assert speed > 0.0
        self.where, self.moved = target, self.moved + 1

    def stop(self) -> None:
        pass


class Clock:
    """Time passes while somebody waits."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def wait(self, duration: float) -> bool:
        self._now += duration
        return False


@pytest.mark.parametrize("tension", [0.0, -3.0])
def test_a_pull_whose_gauge_feels_nothing_never_begins(tension: float) -> None:
    rig = Rig(tension)
    with pytest.raises((GaugeFaultError, LimitError)):
        record_pull(rig, rig, PullSettings(), Clock(), lambda _: None, lambda still: check_weight_at_rest(still, 0.6))
    assert rig.moved == 0


def test_a_gauge_that_turns_negative_stops_the_pull() -> None:
    rig = Rig(-1.5)
    with pytest.raises(LimitError, match="reversed or its zero has drifted"):
        record_pull(rig, rig, PullSettings(), Clock(), lambda _: None)
    assert rig.moved == 0
