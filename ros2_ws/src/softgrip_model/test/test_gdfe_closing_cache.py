# SPDX-License-Identifier: Apache-2.0
"""Keyframes computed ahead: sooner there, and nothing else told by the shapes."""

import gc
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest

from softgrip_model.finger.matching import TendonInput
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings, Keyframes
from softgrip_model.gdfe.closing_cache import ClosingCache, ClosingKey
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, Resolution
from softgrip_model.gdfe.session import ShapeSession
from softgrip_model.gdfe.solver import Solver, State
from softgrip_model.profile import load_directory, shipped_directory

COARSE = ClosingSettings(RESOLUTIONS["coarse"], travel_mm=6.0)
MEDIUM = Resolution(8, 2, 5, 5, 4)
STEP_NS = 40_000_000


@pytest.fixture(scope="module")
def profiles():
    return load_directory(shipped_directory())


@pytest.fixture
def helped(profiles):
    session = session_of(profiles, prefetch=True)
    yield session
    session.close()


@pytest.fixture
def closings(profiles):
    made = ClosingCache(profiles)
    yield made
    made.close()


def wait_for(closings):
    closings._worker.submit(lambda: None).result(timeout=120.0)


def bits(shown):
    shape = shown.shape
    return shown.reason, shown.mesh, shape.iterations, shape.converged, shape.vertices.tobytes(), shape.tension


def run(session, profile="pinch", start=0):
    """Show a closing beyond the travel and back."""
    session.set_mounted({"index": profile})
    reported = []
    for k in range(75):
        pulled = 1.5e-4 * min(k, 150 - 2 * k)
        stamp = (start + k) * STEP_NS
        reported += session.on_tendons(["index"], [TendonInput(stamp, pulled, 0.0, 1.0)])
    return [bits(shown) for shown in reported]


def session_of(profiles, *, prefetch=False):
    return ShapeSession(profiles, {"index": "pinch"}, COARSE, rate_hz=30.0, marker_rate_hz=1.0, prefetch=prefetch)


def test_shapes_say_the_same_with_and_without_it(profiles, helped):
    alone = session_of(profiles)
    for number, profile in enumerate(("pinch", "hook", "pinch")):
        expected = run(alone, profile, 75 * number)
        assert len(expected) == 75
        assert run(helped, profile, 75 * number) == expected


def closings_of(session):
    """Return the complete ones by profile and mesh, in the order in which they were made."""
    made = session._closings._closings.items()
    return [(key.profile_id, key.slot) for key, closing in made if closing.result().keyframes.complete]


def test_the_mounted_finger_comes_first_and_then_those_that_may_be_next(profiles, helped):
    session = helped
    wait_for(session._closings)
    assert closings_of(session) == []  # a cell whose tendons say nothing has no use for them
    list(session.on_tendons(["thumb"], [TendonInput(0, 0.0, 0.0, 1.0)]))
    wait_for(session._closings)
    assert closings_of(session) == [("pinch", "index"), ("hook", "index"), ("power", "index")]
    assert session._fingers["index"].fine.keyframes.requested == 0  # they leave no trace


def test_what_is_mounted_now_is_worked_on_now(profiles, helped):
    session = helped
    session.set_mounted({"index": "hook"})
    list(session.on_tendons(["index"], [TendonInput(0, 0.0, 0.0, 1.0)]))
    wait_for(session._closings)
    assert closings_of(session)[0] == ("pinch", "index")  # made with the session
    assert [requested.profile_id for requested in session._closings._prefetched] == ["hook", "pinch", "power"]


def test_what_serves_when_time_is_short_is_there_before_the_mesh_asked_for(profiles):
    medium = replace(COARSE, resolution=MEDIUM)
    session = ShapeSession(profiles, {"thumb": "hook"}, medium, rate_hz=30.0, marker_rate_hz=0.0)
    first, second, *others = session._plan()
    assert (first.profile_id, first.settings.resolution, first.settings.tolerance) == ("hook", COARSE.resolution, 1e-3)
    assert (second.profile_id, second.settings) == ("hook", medium)
    assert [(other.profile_id, other.settings) for other in others] == [("pinch", medium), ("power", medium)]


def test_no_more_than_a_few_fingers_are_made_ready(profiles):
    many = {f"{name}{k}": profile for k in range(4) for name, profile in profiles.items()}
    session = ShapeSession(many, {"index": "hook2"}, COARSE, rate_hz=30.0, marker_rate_hz=0.0)
    planned = [requested.profile_id for requested in session._plan()]
    assert planned == ["hook2", "hook0", "hook1", "hook3", "pinch0", "pinch1", "pinch2"]


def test_a_finger_that_cannot_be_made_does_not_keep_the_others_waiting(closings):
    good = ClosingKey("hook", "index", COARSE, None)
    closings.prefetch((replace(good, profile_id="claw"), replace(good, slot="tail"), good))
    wait_for(closings)
    assert closings.get(good).keyframes.complete


def test_closings_are_made_once_whoever_asks_and_forgotten_with_their_friction_model(profiles, monkeypatch):
    made = []

    def slow(profile, slot, resolution):
        time.sleep(0.05)  # time for the others to ask, too
        made.append((profile.id, slot))
        return Body(profile, slot, resolution)

    monkeypatch.setattr("softgrip_model.gdfe.closing_cache.Body", slow)
    closings = ClosingCache(profiles)
    then, now = (ActiveFriction(name, FrictionLaw(Law.CAPSTAN, (0.1,), 1.125)) for name in ("then", "now"))
    requested = [ClosingKey("hook", "index", COARSE, friction) for friction in (then, now)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(closings.get, 4 * requested))
    assert made == [("hook", "index")]
    assert len(set(map(id, found))) == 2
    closings.forget_friction_but(now)
    assert closings.get(requested[1]) is found[1]
    assert closings.get(requested[0]) is not found[0]
    assert made == [("hook", "index")]


def test_a_new_friction_model_is_what_the_thread_goes_on_with(profiles, helped):
    session = helped
    friction = ActiveFriction("rig", FrictionLaw(Law.CAPSTAN, (0.2,), 1.125))
    list(session.on_tendons(["index"], [TendonInput(0, 0.0, 0.0, 1.0)]))
    session.set_friction(friction)
    list(session.on_tendons(["index"], [TendonInput(10**9, 0.0, 0.0, 1.0)]))
    wait_for(session._closings)
    assert len(closings_of(session)) == len(profiles)
    assert {requested.friction for requested in session._closings._closings} == {friction}
    assert {requested.friction for requested in session._made} == {friction}


def test_no_shape_waits_for_what_is_there(helped, monkeypatch):
    session = helped
    list(session.on_tendons(["index"], [TendonInput(0, 0.0, 0.0, 1.0)]))
    wait_for(session._closings)
    lengths = []
    solve = Solver.solve

    def noted(self, **task):
        lengths.append(task["drives"][0].target)
        return solve(self, **task)

    monkeypatch.setattr(Solver, "solve", noted)
    list(session.on_tendons(["index"], [TendonInput(10**9, 0.00523, 0.0, 1.0)]))
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
    while keyframes.prefetch(solved_below_4_5_mm):
        pass
    assert keyframes.complete
    assert (keyframes.requested, keyframes.missing(2.0), keyframes.missing(99.0)) == (0, 6, 11)
    keyframes.cover(2.0)
    assert (keyframes.requested, keyframes.reach_mm) == (6, 2.0)
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
    worker = threading.Thread(target=lambda: [keyframes.prefetch(slow) for _ in range(9)])
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
        keyframes.prefetch(broken)
    keyframes.cover(6.0)
    assert keyframes.reach_mm == 6.0


def test_closing_ends_with_the_keyframe_at_hand(profiles):
    closings, requested = ClosingCache(profiles), ClosingKey("hook", "index", ClosingSettings(), None)
    closings.prefetch((requested,))
    closings.close()
    assert not closings.get(requested).keyframes.complete
    assert not any(thread.name.startswith("keyframes") and thread.is_alive() for thread in closings._worker._threads)


def test_a_friction_model_that_is_replaced_takes_its_keyframes_along(profiles):
    """At once: they are some megabytes, and Python looks for cycles when it counts many objects, not large ones."""
    closings = ClosingCache(profiles)
    closing = closings.get(ClosingKey("hook", "index", COARSE, None))
    closing.keyframes.cover(2.0)
    gone = weakref.ref(closing.keyframes)
    gc.disable()
    try:
        closings.forget_friction_but(ActiveFriction("rig", FrictionLaw(Law.CAPSTAN, (0.2,), 1.125)))
        del closing
        assert gone() is None
    finally:
        gc.enable()


def test_keyframes_keep_what_shapes_need_alone(profiles):
    closing = ClosingPath(profiles["hook"], "index", COARSE)
    closing.keyframes.cover(1.0)
    kept = closing.keyframes.last
    assert kept.displacement.base is None
    assert kept.displacement.any()
    assert kept.reaction.size == 0
