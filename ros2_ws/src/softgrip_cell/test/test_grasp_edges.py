# SPDX-License-Identifier: Apache-2.0
"""What a grasp does at the edges: samples that come twice, hands that do not move, predictions that are none."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from softgrip_cell.errors import CatalogueError
from softgrip_cell.grasp.commands import Close, Stop, TensionControl
from softgrip_cell.grasp.contact import ContactEstimator, TipTest
from softgrip_cell.grasp.hand import HandEstimator
from softgrip_cell.grasp.reference import FreeReference, learn_reference
from softgrip_cell.grasp.sequence import GraspSequence
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase
from softgrip_cell.observation import SeenTip, TendonFault

SETTINGS = GraspSettings(lift_window_s=1.0)
EVERYWHERE = (0.008, 0.009, 0.0085)
SECOND = 1_000_000_000


def with_free(pair, **changes):  # type: ignore[no-untyped-def]  # a pair of the bench
    return replace(pair, free=replace(pair.free, **changes))


def with_sample(pair, **changes):  # type: ignore[no-untyped-def]
    return replace(pair, sample=replace(pair.sample, **changes))


def closing(task, bench, **options):  # type: ignore[no-untyped-def]
    """A grasp whose fingers have just begun to close."""
    sequence, made = GraspSequence(task("orange", **options), SETTINGS), bench(contact_m=EVERYWHERE)
    made.obey(sequence.start())
    while sequence.phase is not GraspPhase.CLOSE:
        made.obey(sequence.observe(made.pair()))
    return sequence, made


# --- the sequence --------------------------------------------------------------------------------------------------


def test_one_sample_that_comes_again_and_again_decides_nothing(task, bench) -> None:
    """Closed on nothing takes three samples, as any decision does."""
    sequence, made = closing(task, bench)
    sequence.closing_ended()
    pair = made.pair()
    assert all(sequence.observe(pair).verdict is None for _ in range(100))
    for _ in range(2):
        step = sequence.observe(made.pair())
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.EMPTY


def test_fingers_that_follow_what_creeps_away_have_not_gripped_it_yet(task, bench) -> None:
    """It creeps by 8 mm/s when the second of watching is over, and stands after 1.6 mm."""
    sequence, made = GraspSequence(task("orange", confirm_lift=True), SETTINGS), bench(contact_m=EVERYWHERE)
    step = sequence.start()
    made.obey(step)
    lifted_ns = 0
    while step.verdict is None:
        step = sequence.observe(made.pair())
        made.obey(step)
        if step.phase is GraspPhase.LIFT:
            lifted_ns = lifted_ns or made.now_ns
            if 0.85 < (made.now_ns - lifted_ns) / SECOND < 1.05:
                made.contact_m = tuple(contact + 0.008 * 0.005 for contact in made.contact_m)
                made.pulled_length_m = [pulled + 0.008 * 0.005 for pulled in made.pulled_length_m]
    assert step.verdict.outcome is GraspOutcome.GRIPPED
    assert (made.now_ns - lifted_ns) / SECOND > 1.15


def test_what_was_touched_and_gets_away_before_it_is_enclosed_was_there(task, bench) -> None:
    """Index and thumb meet it where their checked paths end, which proves no grip; the middle finger closes on."""
    made, full = bench(contact_m=(0.0094, math.inf, 0.0094), stiffness_n_per_m=8000.0), task("orange")
    short = replace(
        full.references[0],
        pulled_length_m=full.references[0].pulled_length_m[:11],
        offset_n=full.references[0].offset_n[:11],
        tension_n=full.references[0].tension_n[:11],
    )
    sequence = GraspSequence(replace(full, references=(short, full.references[1], short)), SETTINGS)
    step = sequence.start()
    made.obey(step)
    while step.verdict is None and made.pulled_length_m[1] < 0.019:
        step = sequence.observe(made.pair())
        made.obey(step)
        if made.pulled_length_m[1] > 0.013:
            made.contact_m = (math.inf,) * 3
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.SLIPPED
    assert "got away while closing" in step.verdict.reason


def test_a_prediction_that_says_not_to_be_trusted_ends_the_grasp(task, bench) -> None:
    sequence, made = closing(task, bench)
    step = sequence.observe(with_free(made.pair(), objection="no friction model"))
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.ABORTED
    assert "cannot be predicted: no friction model" in step.verdict.reason
    assert step.commands == (Stop(),)


def test_the_hand_closes_only_when_all_its_fingers_are_open(task, bench) -> None:
    sequence, made = GraspSequence(task("orange"), SETTINGS), bench()
    sequence.start()
    for pulled_length_m in ((0.0, 0.0, 0.004), (0.0, 0.004, 0.0), (0.004, 0.0, 0.0)):
        step = sequence.observe(with_sample(made.pair(), pulled_length_m=pulled_length_m))
        assert (step.phase, step.commands) == (GraspPhase.APPROACH, ())
    step = sequence.observe(with_sample(made.pair(), pulled_length_m=(0.001,) * 3))
    assert step.phase is GraspPhase.CLOSE
    assert isinstance(step.commands[0], Close)


def time_until_aborted(sequence, made, **sample) -> tuple[float, str]:  # type: ignore[no-untyped-def]
    began_ns = made.now_ns
    for _ in range(20_000):
        step = sequence.observe(with_sample(made.pair(), **sample))
        if step.verdict is not None:
            assert step.verdict.outcome is GraspOutcome.ABORTED
            return (made.now_ns - began_ns) / SECOND, step.verdict.reason
    raise AssertionError("100 s have passed without an end")


def test_a_hand_that_does_not_open_ends_the_grasp_in_twice_its_path_and_two_seconds(task, bench) -> None:
    sequence, made = GraspSequence(task("orange"), SETTINGS), bench()
    recipe = task("orange").recipe
    sequence.start()
    seconds, reason = time_until_aborted(sequence, made, pulled_length_m=(0.010,) * 3)
    assert seconds == pytest.approx(2.0 + 2.0 * recipe.pull_limit_m / recipe.closing_speed_m_per_s, abs=0.02)
    assert "the fingers do not open" in reason


def test_a_hand_that_never_comes_to_an_end_ends_the_grasp(task, bench) -> None:
    """It trembles by a millimetre, so it does not stand; it touches nothing."""
    sequence, made = closing(task, bench)
    for number in range(20_000):
        pulled = 0.006 + 0.001 * (number // 20 % 2)
        pair = with_sample(
            made.pair(), pulled_length_m=(pulled,) * 3, tension_n=(1.12 * (400 * pulled + 2e4 * pulled**2),) * 3
        )
        pair = with_free(pair, pulled_length_m=(pulled,) * 3, tension_n=(400 * pulled + 2e4 * pulled**2,) * 3)
        step = sequence.observe(pair)
        if step.verdict is not None:
            break
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.ABORTED
    assert "do not come to an end" in step.verdict.reason


@pytest.mark.parametrize(
    "end",
    [
        lambda sequence, now_ns: sequence.fault(TendonFault("index", "overload", "cut its torque"), now_ns),
        lambda sequence, now_ns: sequence.abort("somebody cancelled", now_ns),
    ],
    ids=["fault", "abort"],
)
def test_whatever_ends_a_grasp_without_a_grip_stops_the_fingers(task, bench, end) -> None:
    sequence, made = closing(task, bench)
    assert end(sequence, made.now_ns).commands == (Stop(),)


def test_a_grip_keeps_its_tension_and_its_verdict(run, task, bench) -> None:
    sequence, made = GraspSequence(task("orange"), SETTINGS), bench(contact_m=EVERYWHERE)
    last = list(run(sequence, made))[-1]
    assert last.verdict is not None
    assert last.verdict.outcome is GraspOutcome.GRIPPED
    assert not any(isinstance(command, Stop) for command in last.commands)
    for late in (sequence.abort("too late"), sequence.fault(TendonFault("index", "stalled", ""), made.now_ns)):
        assert (late.phase, late.verdict, late.commands) == (GraspPhase.DONE, None, ())


def test_three_single_samples_of_a_slack_tendon_are_no_broken_one(task, bench) -> None:
    sequence, made = closing(task, bench)
    made.contact_m = (math.inf,) * 3
    for number in range(150):
        pair = made.pair()
        lost = number % 30 == 29
        step = sequence.observe(with_sample(pair, tension_n=(0.0,) * 3) if lost else pair)
        made.obey(step)
        assert step.verdict is None or step.verdict.outcome is not GraspOutcome.TENDON_FAULT


@pytest.mark.parametrize(("gone_s", "broken"), [(0.15, False), (0.25, True)])
def test_a_tendon_has_to_pull_nothing_for_a_fifth_of_a_second(task, bench, gone_s: float, broken: bool) -> None:
    sequence, made = closing(task, bench)
    made.contact_m = (math.inf,) * 3
    while made.pulled_length_m[0] < 0.011:
        made.obey(sequence.observe(made.pair()))
    for _ in range(round(gone_s / 0.005)):
        pair = made.pair()
        step = sequence.observe(with_sample(pair, tension_n=(0.0, *pair.sample.tension_n[1:])))
        if step.verdict is not None:
            break
    assert (step.verdict is not None and step.verdict.outcome is GraspOutcome.TENDON_FAULT) is broken


def test_a_finger_that_meets_a_product_alone_stops_before_it_hurts_it(run, task, bench) -> None:
    """6 N are 12.6 N of excess tension by virtual work: the tip goes 4.19 m a metre pulled, the contact half of it."""
    one = task("orange")
    one = replace(one, recipe=replace(one.recipe, hold_contact_tension_n=100.0, force_limit_n=6.0))
    made = bench(contact_m=(0.008, math.inf, math.inf))
    last = list(run(GraspSequence(one, SETTINGS), made))[-1]
    assert last.verdict is not None
    assert last.verdict.outcome is GraspOutcome.EMPTY
    assert made.peak_contact_tension_n < 6.0 * 4.19 / 2.0


def hand_of(made) -> HandEstimator:  # type: ignore[no-untyped-def]
    estimator = ContactEstimator(made.slots, made.references, made.paths_m, SETTINGS)
    return HandEstimator(made, SETTINGS, TensionControl(made, SETTINGS, estimator))


@pytest.mark.parametrize("is_short", [False, True])
def test_fingers_that_press_on_their_own_stops_enclose_nothing(task, contact, is_short: bool) -> None:
    state = hand_of(task("orange")).estimate(SECOND, (contact(is_short=is_short),) * 3)
    assert state.has_opposing_contact
    assert state.is_enclosing is is_short


@pytest.mark.parametrize(("contact_tension_n", "is_gone"), [(0.2, False), (0.15, True)])
def test_a_late_sample_does_not_make_a_contact_go(task, contact, contact_tension_n: float, is_gone: bool) -> None:
    """Half of a punctual drive's 0.35 N decides, whatever a late one adds to what is uncertain."""
    late = replace(contact(contact_tension_n=contact_tension_n), threshold_n=4.0)
    assert hand_of(task("orange")).estimate(SECOND, (late,) * 3).has_no_contact is is_gone


def test_two_fingers_without_the_thumb_are_no_hand_but_for_a_hook(task, contact) -> None:
    free = replace(contact(contact_tension_n=0.0), is_touching=False)
    for opposed in (True, False):
        hand = hand_of(replace(task("orange"), opposed=opposed))
        assert hand.estimate(SECOND, (contact(), contact(), free)).is_enclosing is not opposed
        assert not hand.estimate(2 * SECOND, (free, free, contact())).is_enclosing


def test_what_a_late_drive_shows_within_its_uncertainty_was_not_pressed(task, contact) -> None:
    """3 N are more than 15 % of the holding tension; while the threshold is 4 N they prove nothing."""
    for threshold_n, was_pressed in ((4.0, False), (0.5, True)):
        pressed = replace(contact(contact_tension_n=3.0), threshold_n=threshold_n)
        assert hand_of(task("orange")).estimate(SECOND, (pressed,) * 3).was_pressed is was_pressed


def test_a_touch_without_the_holding_force_is_no_grip(task, contact) -> None:
    hand = hand_of(task("orange"))
    states = [hand.estimate(number * 5_000_000, (contact(),) * 3) for number in range(1, 200)]
    assert states[-1].has_opposing_contact
    assert not any(state.is_gripping for state in states)


# --- readings, references ------------------------------------------------------------------------------------------


def test_a_prediction_that_is_no_number_leaves_the_reference_of_the_check(task, bench) -> None:
    references = task("orange").references
    pair = with_sample(bench().pair(), pulled_length_m=(0.010,) * 3, tension_n=(20.0,) * 3)
    estimator = ContactEstimator(("index", "middle", "thumb"), references, (0.020,) * 3, SETTINGS)
    found = estimator.estimate(with_free(pair, tension_n=(math.nan,) * 3))
    assert all(math.isfinite(one.contact_tension_n) and one.is_at_threshold for one in found)
    assert found[0].free_n == pytest.approx(references[0].tension(0.010))


def test_excess_and_force_limits_are_each_other_s_inverse(task, bench) -> None:
    """Whatever the lever is: a force of F needs an excess of which the reading says that it can mean F."""
    made = task("orange")
    estimator = ContactEstimator(made.slots, made.references, made.paths_m, SETTINGS)
    pair = with_sample(bench().pair(), pulled_length_m=(0.010,) * 3)
    for number, force_n in enumerate((1.0, 6.0)):
        pair = with_sample(pair, stamp_ns=(2 * number + 1) * SECOND)
        contact_tension_n = estimator.contact_tension_limit_n(0, force_n)
        free_n = estimator.estimate(pair)[0].free_n
        found = estimator.estimate(
            with_sample(pair, stamp_ns=(2 * number + 2) * SECOND, tension_n=(free_n + contact_tension_n,) * 3),
            commanded=(0, 1, 2),
        )[0]
        assert found.force_n == pytest.approx(force_n, rel=1e-6)
        # At the start: a lever of 2 and contacts that may be twice as near to the base.
        assert contact_tension_n == pytest.approx(force_n * 2.0 / 2.0)


@pytest.mark.parametrize("column", ["offset_n", "tension_n", "stddev_n"])
def test_a_reference_with_a_number_that_is_none_is_refused(column: str) -> None:
    good = FreeReference((0.0, 0.01), (0.0, 0.1), (0.0, 5.0), 0.05, "model")
    bad = math.nan if column == "stddev_n" else (0.0, math.nan)
    with pytest.raises(CatalogueError, match="finite"):
        replace(good, **{column: bad})


def test_wild_samples_of_a_check_teach_nothing() -> None:
    """Ten samples a millimetre, one of them 5 N off: the difference stays the 0.5 N of the others."""
    pulled = [0.005 + 1e-5 * i for i in range(10)]
    measured = [4.5] * 9 + [9.0]
    learned = learn_reference(pulled, measured, [4.0] * 10, "model")
    assert learned.offset(0.005) == pytest.approx(0.5)


# --- the camera ----------------------------------------------------------------------------------------------------


def is_deflected(task, bench, off_m: float, stddev_m: float = 0.0, age_s: float = 0.0) -> bool:  # type: ignore[no-untyped-def]
    tips, pair = TipTest(("index", "middle", "thumb"), task().references, SETTINGS), bench().pair()
    tips.predict(pair)
    x, y = pair.free.tip_m[0]
    tips.observe(SeenTip(pair.sample.stamp_ns, "index", (x + off_m, y), stddev_m))
    return bool(tips.deflected(pair.sample.stamp_ns + round(age_s * SECOND)))


@pytest.mark.parametrize(("age_s", "expected"), [(0.09, True), (0.11, False)])
def test_what_was_seen_over_a_tenth_of_a_second_ago_says_nothing(task, bench, age_s: float, expected: bool) -> None:
    assert is_deflected(task, bench, 0.030, age_s=age_s) is expected


def test_a_camera_that_is_not_sure_says_nothing(task, bench) -> None:
    """15 mm off, 12 mm allowed: five sigma of 2 mm, beside those of a good finger, make it 15.7 mm."""
    assert is_deflected(task, bench, 0.015, stddev_m=0.0005)
    assert not is_deflected(task, bench, 0.015, stddev_m=0.002)


def test_a_tip_that_could_not_be_predicted_leaves_what_was_seen_before(task, bench) -> None:
    tips, made = TipTest(("index", "middle", "thumb"), task().references, SETTINGS), bench()
    pair = made.pair()
    tips.predict(pair)
    x, y = pair.free.tip_m[0]
    tips.observe(SeenTip(pair.sample.stamp_ns, "index", (x + 0.030, y), 0.0))
    later = made.pair()
    tips.predict(with_free(later, tip_m=((math.nan, math.nan),) * 3))
    tips.observe(SeenTip(later.sample.stamp_ns, "index", (x, y), 0.0))
    assert tips.deflected(later.sample.stamp_ns) == {0}
    assert all(math.isfinite(off_m) for off_m in tips.deviation_m(later.sample.stamp_ns).values())


# --- how hard ------------------------------------------------------------------------------------------------------


def control_of(task, product: str, settings: GraspSettings = SETTINGS, **recipe: float) -> TensionControl:  # type: ignore[no-untyped-def]
    made = task(product)
    made = replace(made, recipe=replace(made.recipe, **recipe))
    return TensionControl(made, settings, ContactEstimator(made.slots, made.references, made.paths_m, settings))


def test_a_product_that_bears_less_than_its_recipe_asks_for_is_pressed_with_what_it_bears(task, contact) -> None:
    """6 N of force with the lever at its start, 2, and contacts twice as near: 6 N of excess, not 18."""
    command = control_of(task, "orange", hold_contact_tension_n=18.0, force_limit_n=6.0).press(
        range(3), (contact(),) * 3, SECOND
    )
    assert command.tensions_n == pytest.approx((11.0,) * 3)


def test_no_more_is_ordered_than_the_driver_may_pull(task, contact) -> None:
    settings = replace(SETTINGS, tension_limit_n=20.0)
    one = control_of(task, "orange", settings, hold_contact_tension_n=18.0, force_limit_n=1e3)
    assert one.press(range(3), (contact(),) * 3, SECOND).tensions_n == pytest.approx((20.0,) * 3)
    assert one.close(range(3)).tension_limit_n == pytest.approx(20.0)


def test_a_closing_is_allowed_the_free_motion_at_its_end_and_what_the_product_bears(task, contact) -> None:
    """Free motion at the end of the path by the reference, and 6 N of force as above."""
    references = task("orange").references
    command = control_of(task, "orange", force_limit_n=6.0, pull_limit_m=0.015).close(range(3))
    assert command.tension_limit_n == pytest.approx(references[0].tension(0.015) + 6.0)


def test_no_finger_closes_beyond_what_was_checked(task, contact) -> None:
    command = control_of(task, "orange", pull_limit_m=0.030).close(range(3))
    assert command.targets_m == pytest.approx((task().references[0].reach_m,) * 3)


@pytest.mark.parametrize(("product", "factor"), [("egg", 1.3), ("orange", math.inf)])
def test_what_is_fragile_is_pressed_hardly_faster_than_it_was_met(task, contact, product: str, factor: float) -> None:
    recipe = task(product).recipe
    command = control_of(task, product).press(range(3), (contact(),) * 3, SECOND)
    assert command.speed_m_per_s == pytest.approx(min(0.03, factor * recipe.closing_speed_m_per_s))
