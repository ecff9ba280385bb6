# SPDX-License-Identifier: Apache-2.0
"""Who comes first on a busy computer. What changes the scheduling does so in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NoReturn

import pytest

from softgrip_nodekit import Rank, WhileBrief, claim_processor, priority
from softgrip_nodekit.priority import Breather

ALL_THREADS = """
import os, sys, threading
import rclpy
from softgrip_nodekit import CellNode
from softgrip_nodekit import ParameterTable, Rank, realtime_parameter, run
from softgrip_nodekit.priority import own_threads

TABLE = ParameterTable(realtime_parameter(Rank.PREDICTION))

class Hasty(CellNode):
    def __init__(self):
        super().__init__("hasty")
        TABLE.declare(self)
        threading.Thread(target=threading.Event().wait, daemon=True).start()  # as the middleware's: there before
        self.create_timer(0.01, self.tell)

    def tell(self):
        later = threading.Thread(target=threading.Event().wait, daemon=True)
        later.start()
        print(len(own_threads()), sorted({(os.sched_getscheduler(t), os.sched_getparam(t).sched_priority)
              for t in own_threads()}), flush=True)
        rclpy.shutdown()

sys.exit(run(Hasty, sys.argv[1:]))
"""


def allowed() -> bool:
    """Whether this system gives a process of ours real-time priority."""
    trial = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    return subprocess.run([sys.executable, "-c", trial], capture_output=True, check=False).returncode == 0


def scheduled(*arguments: str) -> str:
    """Return how a node's threads are scheduled."""
    command = [sys.executable, "-c", ALL_THREADS, "--ros-args", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    count, _, how = done.stdout.partition(" ")
    assert int(count) >= 3
    return how.strip()


def test_every_thread_of_a_node_has_its_rank() -> None:
    if not allowed():
        pytest.skip("no right to real-time priority here")
    assert scheduled() == f"[({os.SCHED_FIFO}, {int(Rank.PREDICTION)})]"


def test_a_node_told_so_stays_ordinary() -> None:
    assert scheduled("-p", "realtime_priority:=0") == f"[({os.SCHED_OTHER}, 0)]"


@pytest.mark.parametrize(
    ("error", "says"),
    [(PermissionError(), "/etc/security/limits.d/"), (OSError("none here"), "none here")],
)
def test_without_the_right_it_says_how_to_give_it(monkeypatch: pytest.MonkeyPatch, error: Exception, says: str) -> None:
    def refuse(*_: Any) -> NoReturn:
        raise error

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    reported = claim_processor(20)
    assert reported.startswith("ordinary priority")
    assert says in reported


def test_a_thread_that_has_ended_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[int] = []

    def give(thread: int, *_: Any) -> None:
        if thread == 1:
            raise ProcessLookupError
        given.append(thread)

    monkeypatch.setattr(os, "sched_setscheduler", give)
    assert claim_processor(20, [1, 2]) == "real-time priority 20"
    assert given == [2]


def test_ranks_are_in_the_order_of_haste() -> None:
    order: Callable[[Rank], int] = int
    assert sorted(Rank, key=order, reverse=True) == [
        Rank.EMULATED_HARDWARE,
        Rank.DRIVES,
        Rank.PREDICTION,
        Rank.FRAMES,
        Rank.ORDINARY,
    ]


def test_long_work_goes_behind_until_it_is_brief_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda _, policy, how: given.append((policy, how.sched_priority)))
    monkeypatch.setattr(priority, "own_threads", lambda: [0])
    brief = WhileBrief(10, longest_s=0.01, turns=3)
    for seconds in (0.002, 0.01):
        brief.add_turn(seconds)
    assert given == []
    for seconds in (0.011, 0.5):
        brief.add_turn(seconds)
    assert given == [(os.SCHED_OTHER, 0)]  # told once
    for seconds in (0.002, 0.002, 0.02, 0.002, 0.002):
        brief.add_turn(seconds)
    assert given == [(os.SCHED_OTHER, 0)]  # not three in a row
    brief.add_turn(0.002)
    brief.add_turn(0.002)
    assert given == [(os.SCHED_OTHER, 0), (os.SCHED_FIFO, 10)]


def test_who_was_never_in_front_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: pytest.fail("nobody asked for it"))
    brief = WhileBrief(0, turns=1)
    for seconds in (1.0, 0.001, 0.001):
        brief.add_turn(seconds)


@pytest.fixture
def processor(monkeypatch: pytest.MonkeyPatch) -> Callable[[float, float], None]:
    """A real-time thread on a clock of its own, which `spend` has work and then wait."""
    clock = {"worked": 5.0, "now": 100.0}

    def spend(working_s: float, waiting_s: float = 0.0) -> None:
        clock["worked"] += working_s
        clock["now"] += working_s + waiting_s

    monkeypatch.setattr(time, "process_time", lambda: clock["worked"])
    monkeypatch.setattr(time, "monotonic", lambda: clock["now"])
    monkeypatch.setattr(time, "sleep", lambda seconds: spend(0.0, seconds))
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_FIFO)
    return spend


def test_a_real_time_thread_in_a_flood_pauses_after_three_milliseconds(processor: Callable[..., None]) -> None:
    breather, pauses = Breather(after_s=0.003, for_s=0.001), []
    for _ in range(40):
        processor(0.0005, 0.0001)
        before = time.monotonic()
        if breather.take_breath():
            pauses.append(time.monotonic() - before)
    assert 40 // 7 <= len(pauses) <= 40 // 6  # 3 ms are six or seven turns of half a millisecond, by rounding
    assert pauses == pytest.approx([0.001] * len(pauses))


def test_one_that_waits_as_long_as_it_works_does_not(processor: Callable[..., None]) -> None:
    breather = Breather()
    for _ in range(40):
        processor(0.0005, 0.0006)
        assert not breather.take_breath()
    processor(0.01)
    assert breather.take_breath()


def test_an_ordinary_thread_does_not(processor: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_OTHER)
    breather = Breather()
    processor(1.0)
    assert not breather.take_breath()
