# SPDX-License-Identifier: Apache-2.0
"""Keyframes computed ahead: sooner there, and nothing else told by the shapes."""

import threading
from dataclasses import dataclass

import numpy as np
import pytest

from softgrip_model.finger.matching import TendonSample
from softgrip_model.gdfe.ahead import Ahead
from softgrip_model.gdfe.closing import Closing, ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.gdfe.keyframes import Keyframes
from softgrip_model.gdfe.session import ShapeSession
from softgrip_model.gdfe.solver import State
from softgrip_model.profile import load_directory, shipped_directory

COARSE = ClosingSettings(RESOLUTIONS["coarse"], travel_mm=6.0)
STEP_NS = 40_000_000


@pytest.fixture(scope="module")
def profiles():
    return load_directory(shipped_directory())


@pytest.fixture
def ahead():
    made = Ahead()
    yield made
    made.close()


def wait_for(ahead):
    ahead._pool.submit(lambda: None).result(timeout=120.0)


def bits(shown):
    shape = shown.shape
    return shown.reason, shown.mesh, shape.iterations, shape.converged, shape.vertices.tobytes(), shape.tension


def run(session, profile="pinch", start=0):
    """Show a closing beyond the travel and back."""
    session.set_mounted({"index": profile})
    told = []
    for k in range(75):
        pulled = 1.5e-4 * min(k, 150 - 2 * k)
        stamp = (start + k) * STEP_NS
        told += session.on_tendons(["index"], [TendonSample(stamp, pulled, 0.0, 1.0)])
    return [bits(shown) for shown in told]


def session_of(profiles, ahead=None):
    return ShapeSession(profiles, {"index": "pinch"}, COARSE, rate_hz=30.0, marker_rate_hz=1.0, ahead=ahead)


def test_shapes_say_the_same_with_and_without_it(profiles, ahead):
    alone, helped = session_of(profiles), session_of(profiles, ahead)
    for number, profile in enumerate(("pinch", "hook", "pinch")):
        expected = run(alone, profile, 75 * number)
        assert len(expected) == 75
        assert run(helped, profile, 75 * number) == expected


def test_only_fingers_that_are_shown_are_worked_on_and_all_of_their_travel(profiles, ahead):
    session = session_of(profiles, ahead)
    for profile in ("hook", "power", "hook"):
        session.set_mounted({"index": profile})
    wait_for(ahead)
    assert len(session._made) == 3
    assert not any(slot.fine.keyframes.complete for slot in session._made.values())
    list(session.on_tendons(["index"], [TendonSample(0, -0.001, 0.0, 1.0)]))
    wait_for(ahead)
    shown = session._fingers["index"].fine
    assert [slot.fine for slot in session._made.values() if slot.fine.keyframes.complete] == [shown]
    assert shown.keyframes.asked == 1  # at rest; the rest of them leaves no trace


def test_no_shape_waits_for_what_is_there(profiles, ahead, monkeypatch):
    session = session_of(profiles, ahead)
    list(session.on_tendons(["index"], [TendonSample(0, 0.0, 0.0, 1.0)]))
    wait_for(ahead)
    lengths = []
    solve = Closing._solve
    monkeypatch.setattr(Closing, "_solve", lambda self, *given: (lengths.append(given[2]), solve(self, *given))[1])
    list(session.on_tendons(["index"], [TendonSample(10**9, 0.00523, 0.0, 1.0)]))
    assert lengths == [pytest.approx(5.23)]


@dataclass
class Found:
    """What a chain needs to know of an equilibrium."""

    displacement: np.ndarray
    anchor_tension: tuple[float]
    converged: bool = True


def solved(length, _start):
    return Found(np.full((1, 3), length), (length,))


def solved_below_4_5_mm(length, _start):
    return Found(np.full((1, 3), length), (length,), converged=length < 4.5)


def chain(solve, travel_mm=6.0):
    return Keyframes(1.0, travel_mm, 1e-3, solve, State(np.zeros((1, 3)), (0.0,)))


def test_what_was_computed_ahead_is_not_known_before_it_is_asked_for():
    keyframes = chain(solved_below_4_5_mm)
    while keyframes.ahead(solved_below_4_5_mm):
        pass
    assert keyframes.complete
    assert (keyframes.asked, keyframes.missing(2.0), keyframes.missing(99.0)) == (0, 6, 11)
    keyframes.cover(2.0)
    assert (keyframes.asked, keyframes.reach_mm) == (6, 2.0)
    assert keyframes.nearest(3.9).displacement[0, 0] == 2.0
    keyframes.cover(99.0)  # beyond what converges
    assert (keyframes.reach_mm, keyframes.missing(5.0), keyframes.within_reach(5.0)) == (4.0, 0, False)
    assert keyframes.last.displacement[0, 0] == 4.0


def test_two_threads_compute_each_keyframe_once_and_the_shape_does_not_wait_for_more_than_its_own():
    computed, begun, go_on = [], threading.Event(), threading.Event()

    def slow(length, start):
        begun.set()
        assert go_on.wait(timeout=30.0)
        computed.append(("ahead", length))
        return solved(length, start)

    def own(length, start):
        computed.append(("own", length))
        return solved(length, start)

    keyframes = chain(own)
    keyframes.cover(1.0)
    worker = threading.Thread(target=lambda: [keyframes.ahead(slow) for _ in range(9)])
    worker.start()
    assert begun.wait(timeout=30.0)
    # at work on the one at 2 mm: what is known already is at hand, the halfway one to it can wait
    assert keyframes.covers(1.0)
    assert not keyframes.covers(1.5)
    asking = threading.Thread(target=keyframes.cover, args=(3.0,))
    asking.start()
    asking.join(timeout=0.2)
    assert asking.is_alive()  # for the one that is being computed
    go_on.set()
    asking.join(timeout=30.0)
    worker.join(timeout=30.0)
    assert not asking.is_alive()
    assert not worker.is_alive()
    lengths = [length for _, length in computed]
    assert sorted(lengths) == sorted(set(lengths))
    assert {1.0, 2.0, 3.0, 4.0, 5.0, 6.0} <= set(lengths)
    assert ("ahead", 2.0) in computed


def test_a_solver_that_fails_ahead_leaves_the_chain_to_the_shape_that_needs_it():
    def broken(length, start):
        raise MemoryError

    keyframes = chain(solved)
    with pytest.raises(MemoryError):
        keyframes.ahead(broken)
    keyframes.cover(6.0)
    assert keyframes.reach_mm == 6.0


def test_closing_ends_with_the_keyframe_at_hand(profiles):
    ahead = Ahead()
    closing = Closing(profiles["hook"], "index", ClosingSettings())
    ahead.want([closing])
    ahead.close()
    assert not closing.keyframes.complete
    assert not any(thread.name.startswith("keyframes") and thread.is_alive() for thread in ahead._pool._threads)
