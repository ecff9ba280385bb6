# SPDX-License-Identifier: Apache-2.0
"""What a driving message is answered with hangs on stamps, not on the order of arrival."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softgrip_nodekit.event_time import LatchedInputs
from softgrip_testing.arrival_orders import arrive

MS = 1_000_000
LATENESS_S = 0.2
LATENESS_NS = 200 * MS
START = 1_795_000_000_000 * MS

Stream = list[tuple[int, int]]


class Node:
    """Answers each driving message with what holds."""

    def __init__(self) -> None:
        self.answers: list[tuple[int, dict[str, int]]] = []
        self.late: list[tuple[str, int, int]] = []
        self._holds: dict[str, int] = {}
        self._inputs = LatchedInputs(LATENESS_S, lambda *note: self.late.append(note))

    def receive(self, topic: str, stamp: int) -> None:
        if topic == "driver":
            self._inputs.advance(stamp)
            self.answers.append((stamp, dict(self._holds)))
        else:
            self._inputs.put(topic, stamp, lambda: self._holds.update({topic: stamp}))


def answers_by_rule(streams: dict[str, Stream]) -> list[tuple[int, dict[str, int]]]:
    """The documented rule, as a definition: the last input of each topic whose stamp plus the lateness is reached."""
    answers = []
    for stamp, _ in streams["driver"]:
        reached = {
            t: [s for s, _ in items if s + LATENESS_NS <= stamp] for t, items in streams.items() if t != "driver"
        }
        answers.append((stamp, {topic: stamps[-1] for topic, stamps in reached.items() if stamps}))
    return answers


SEEDS = st.integers(0, 2**32)


def stamps(min_size: int, max_size: int) -> st.SearchStrategy[Stream]:
    steps = st.lists(st.integers(1, 80), min_size=min_size, max_size=max_size)
    return steps.map(lambda gaps: [(START + MS * sum(gaps[: n + 1]),) * 2 for n in range(len(gaps))])


STREAMS = st.fixed_dictionaries({"driver": stamps(5, 60), "friction": stamps(0, 6), "cell": stamps(0, 20)})


@settings(max_examples=80, deadline=None)
@given(STREAMS, SEEDS)
def test_any_order_of_arrival_within_the_lateness_gives_the_answers_of_the_rule(
    streams: dict[str, Stream], seed: int
) -> None:
    node = Node()
    for topic, stamp in arrive(
        streams, {"driver": 50 * MS, "friction": LATENESS_NS, "cell": LATENESS_NS}, Random(seed)
    ):
        node.receive(topic, stamp)
    assert node.late == []
    assert node.answers == answers_by_rule(streams)


@settings(max_examples=80, deadline=None)
@given(STREAMS, SEEDS)
def test_with_what_was_noted_any_order_can_be_had_again(streams: dict[str, Stream], seed: int) -> None:
    """Whatever comes late is noted, and stamps and notes together give the order: a replay needs nothing else."""
    node = Node()
    for topic, stamp in arrive(streams, {"driver": 50 * MS, "friction": 3000 * MS, "cell": 3000 * MS}, Random(seed)):
        node.receive(topic, stamp)
    noted = {(topic, stamp): after for topic, stamp, after in node.late}

    places = []
    for topic, items in streams.items():
        last = (0, 0)
        for stamp, _ in items:
            own = (noted[topic, stamp], 1) if (topic, stamp) in noted else (stamp, 0 if topic == "driver" else -1)
            last = max(own, last)  # each topic keeps its own order
            places.append((last, topic, stamp))
    again = Node()
    for _, topic, stamp in sorted(places, key=lambda each: each[0]):
        again.receive(topic, stamp)
    assert again.answers == node.answers
    assert sorted(again.late) == sorted(node.late)


def test_a_late_input_holds_from_the_next_driving_message_on_and_is_noted() -> None:
    node = Node()
    node.receive("driver", START)
    node.receive("driver", START + 300 * MS)
    node.receive("friction", START + 50 * MS)
    node.receive("driver", START + 310 * MS)
    assert [answer for _, answer in node.answers] == [{}, {}, {"friction": START + 50 * MS}]
    assert node.late == [("friction", START + 50 * MS, START + 300 * MS)]


def test_an_input_without_a_stamp_holds_before_anything_is_driven() -> None:
    node = Node()
    node.receive("friction", 0)
    node.receive("cell", START)
    node.receive("driver", START)
    assert node.answers == [(START, {"friction": 0})]
    assert node.late == [("friction", 0, 0)]


@pytest.mark.parametrize("stamp", [0, START + 3_600_000 * MS])
def test_an_input_without_a_stamp_or_of_another_clock_holds_at_once_and_is_noted(stamp: int) -> None:
    node = Node()
    node.receive("driver", START)
    node.receive("friction", stamp)
    node.receive("driver", START + 10 * MS)
    assert node.answers[-1][1] == {"friction": stamp}
    assert node.late == [("friction", stamp, START)]


def test_inputs_of_one_topic_hold_in_the_order_they_came_in() -> None:
    node = Node()
    node.receive("driver", START)
    node.receive("cell", START + 100 * MS)
    node.receive("cell", START + 50 * MS)  # its clock was set back
    node.receive("driver", START + 260 * MS)
    node.receive("driver", START + 300 * MS)
    assert [answer for _, answer in node.answers] == [{}, {}, {"cell": START + 50 * MS}]


def test_a_source_that_restarts_with_an_earlier_time_is_followed() -> None:
    node = Node()
    node.receive("driver", START)
    node.receive("driver", START - 60_000 * MS)
    node.receive("cell", START - 59_990 * MS)
    node.receive("driver", START - 59_780 * MS)
    assert node.answers[-1][1] == {"cell": START - 59_990 * MS}
    assert node.late == []
