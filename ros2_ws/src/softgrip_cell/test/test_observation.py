# SPDX-License-Identifier: Apache-2.0
"""What counts as silence, and in which order samples, predictions and fingertips are judged."""

from __future__ import annotations

from random import Random
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softgrip_cell.grasp.sequence import GraspSequence, GraspStep
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.observation import (
    FreeMotion,
    Observation,
    ObservationOrder,
    ObservedPair,
    SeenTip,
    StreamSilence,
    TendonSample,
)
from softgrip_testing.arrival_orders import arrive


def sample(stamp_ns: int) -> TendonSample:
    return TendonSample(stamp_ns, (0.0,) * 3, (0.0,) * 3)


def motion(stamp_ns: int) -> FreeMotion:
    return FreeMotion(stamp_ns, (0.0,) * 3, (0.0,) * 3, ((0.0, 0.0),) * 3, "model")


def test_silence_is_counted_in_looks_and_ends_with_a_word() -> None:
    silence = StreamSilence(3)
    assert silence.reached  # nothing was ever heard
    assert not silence.was_heard
    silence.hear()
    states = []
    for _ in range(3):
        states.append(silence.reached)
        silence.pass_period()
    assert states == [False] * 3
    assert silence.reached
    assert silence.was_heard
    silence.hear()
    assert not silence.reached


MS = 1_000_000
START = 1_795_000_000_000 * MS
LATENESS_NS = 50 * MS
SEEDS = st.integers(0, 2**32)


def tip(stamp_ns: int) -> SeenTip:
    return SeenTip(stamp_ns, "index", (0.06, 0.0), 0.0005)


def receive(order: ObservationOrder, item: TendonSample | FreeMotion | SeenTip) -> list[Observation]:
    if isinstance(item, TendonSample):
        return order.add_sample(item)
    return order.add_tips([item]) if isinstance(item, SeenTip) else order.add_prediction(item)


def in_order(streams: dict[str, list[tuple[int, Any]]]) -> list[Observation]:
    """The documented rule, as a definition: sample by sample; before its pair the tips that count from it on."""
    predictions = dict(streams["predictions"])
    tips = [one for _, one in streams["tips"]]
    given: list[Observation] = []
    for stamp, one in streams["samples"]:
        given.append(one)
        if stamp in predictions:
            given += [each for each in tips if each.stamp_ns + LATENESS_NS <= stamp]
            tips = [each for each in tips if each.stamp_ns + LATENESS_NS > stamp]
            given.append(ObservedPair(one, predictions[stamp]))
    return given


@st.composite
def observed(draw: st.DrawFn) -> dict[str, list[tuple[int, Any]]]:
    """Samples of a loop, predictions of most of them, and what a camera saw meanwhile."""
    times = [START + 10 * MS * n for n in range(draw(st.integers(2, 40)))]
    answered = draw(st.lists(st.booleans(), min_size=len(times), max_size=len(times)))
    frames = [START + 33 * MS * n + draw(st.integers(0, 9)) * MS for n in range(len(times) // 3)]
    return {
        "samples": [(stamp, sample(stamp)) for stamp in times],
        "predictions": [(stamp, motion(stamp)) for stamp, has in zip(times, answered, strict=True) if has],
        "tips": [(stamp, tip(stamp)) for stamp in frames],
    }


@settings(max_examples=150, deadline=None)
@given(observed(), SEEDS)
def test_any_order_of_arrival_within_the_lateness_gives_the_order_of_the_rule(
    streams: dict[str, list[tuple[int, Any]]], seed: int
) -> None:
    order, given_out = ObservationOrder(1e-9 * LATENESS_NS), []
    for _, item in arrive(streams, {"samples": 8 * MS, "predictions": LATENESS_NS, "tips": LATENESS_NS}, Random(seed)):
        given_out += receive(order, item)
    expected = in_order(streams)
    assert order.late == 0
    assert given_out == expected[: len(given_out)]
    # only what may still get its prediction waits
    waiting = {one.stamp_ns for one in expected[len(given_out) :] if isinstance(one, TendonSample)}
    assert all(stamp > streams["samples"][-1][0] - LATENESS_NS for stamp in waiting)


@settings(max_examples=100, deadline=None)
@given(observed(), SEEDS)
def test_what_comes_later_is_given_out_when_it_comes_and_counted(
    streams: dict[str, list[tuple[int, Any]]], seed: int
) -> None:
    order, given_out = ObservationOrder(1e-9 * LATENESS_NS), []
    arrivals = arrive(streams, {"samples": 8 * MS, "predictions": 200 * MS, "tips": 200 * MS}, Random(seed))
    for _, item in arrivals:
        given_out += receive(order, item)
    assert order.late > 0 or given_out == in_order(streams)[: len(given_out)]
    samples = [one for one in given_out if isinstance(one, TendonSample)]
    assert samples == [one for _, one in streams["samples"]][: len(samples)]
    pairs = [one.sample.stamp_ns for one in given_out if isinstance(one, ObservedPair)]
    assert pairs == sorted(set(pairs))


def test_a_sample_whose_prediction_never_comes_waits_no_longer_than_the_lateness() -> None:
    order = ObservationOrder(0.05)
    for n in range(5):
        assert order.add_sample(sample(START + 10 * MS * n)) == []
    assert order.add_sample(sample(START + 50 * MS)) == [sample(START)]


def test_without_lateness_nothing_waits() -> None:
    order = ObservationOrder(0.0)
    assert order.add_sample(sample(START)) == [sample(START)]
    assert order.add_tips([tip(START + 5 * MS)]) == [tip(START + 5 * MS)]
    assert order.add_prediction(motion(START)) == [ObservedPair(sample(START), motion(START))]


def test_the_past_is_not_judged_after_the_present() -> None:
    order = ObservationOrder(0.05)
    for n in range(3):
        order.add_sample(sample(START + n * MS))
    given_out = order.add_prediction(motion(START + 2 * MS))
    assert given_out[-1] == ObservedPair(sample(START + 2 * MS), motion(START + 2 * MS))
    assert order.add_prediction(motion(START + MS)) == []


def test_a_driver_that_restarts_with_an_earlier_clock_is_followed() -> None:
    order = ObservationOrder(0.05)
    order.add_sample(sample(START))
    order.add_sample(sample(START - 10_000 * MS))
    pair = ObservedPair(sample(START - 10_000 * MS), motion(START - 10_000 * MS))
    assert order.add_prediction(motion(START - 10_000 * MS)) == [pair.sample, pair]


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=SEEDS)
def test_a_grasp_is_decided_the_same_in_any_order_of_arrival(task: Any, bench: Any, seed: int) -> None:
    """A product slides out while it is lifted; the camera sees the fingertips where free motion has them."""
    made = bench(contact_m=(0.008, 0.009, 0.0085), grip=lambda t: 1.0 if t < 0.5 else 0.0)
    sequence = GraspSequence(task("orange", confirm_lift=True), GraspSettings(lift_window_s=1.0))
    streams: dict[str, list[tuple[int, Any]]] = {"samples": [], "predictions": [], "tips": []}
    expected = []
    step = sequence.start()
    order = ObservationOrder(1e-9 * LATENESS_NS)
    while step.verdict is None:
        made.obey(step)
        pair = made.pair()
        stamp = pair.sample.stamp_ns
        streams["samples"].append((stamp, pair.sample))
        streams["predictions"].append((stamp, pair.free))
        items: list[Any] = [pair.sample, pair.free]
        if len(streams["samples"]) % 7 == 0:
            seen = SeenTip(stamp, "index", pair.free.tip_m[0], 0.0005)
            streams["tips"].append((stamp, seen))
            items.append(seen)
        for item in items:
            step = _feed(sequence, receive(order, item)) or step
        expected.append((step.phase, step.contact, step.verdict))
    again = GraspSequence(task("orange", confirm_lift=True), GraspSettings(lift_window_s=1.0))
    again.start()
    order = ObservationOrder(1e-9 * LATENESS_NS)
    verdicts = []
    for _, item in arrive(streams, {"samples": 4 * MS, "predictions": LATENESS_NS, "tips": LATENESS_NS}, Random(seed)):
        for one in receive(order, item):
            found = _feed(again, [one])
            verdicts += [found.verdict] if found is not None and found.verdict is not None else []
    assert order.late == 0
    assert verdicts == [expected[-1][2]]


def _feed(sequence: GraspSequence, observations: list[Observation]) -> GraspStep | None:
    step = None
    for one in observations:
        if isinstance(one, SeenTip):
            sequence.observe_tip(one)
        else:
            step = sequence.observe_sample(one) if isinstance(one, TendonSample) else sequence.observe(one)
    return step
