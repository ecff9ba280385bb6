# SPDX-License-Identifier: Apache-2.0
"""Shapes on demand: nothing computed ahead, nothing depends on what was asked before, and what a slow solver does."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from softgrip_model.finger.matching import TendonInput
from softgrip_model.finger.predictor import ActiveFriction
from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_model.gdfe.closing import Body, ClosingPath, ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS, Resolution
from softgrip_model.gdfe.session import ShapeSession, Shown
from softgrip_model.gdfe.solver import Solver
from softgrip_model.profile import load_directory, shipped_directory

COARSE = ClosingSettings(RESOLUTIONS["coarse"])
#: Finer than coarse, and quick enough for a test.
MEDIUM = ClosingSettings(Resolution(8, 2, 5, 5, 4))
STATE_HZ = 200.0


@pytest.fixture(scope="module")
def profiles():
    return load_directory(shipped_directory())


def rubbing(coefficient):
    law = FrictionLaw(Law.CAPSTAN, (coefficient,), 1.125)
    return ActiveFriction(id=f"capstan-{coefficient}", law=law, covariance=None)


@pytest.fixture
def solved(monkeypatch):
    """Return the list of (pulled length, equilibrium) of all that is solved from here on."""
    found = []
    solve = Solver.solve

    def noted(self, **task):
        equilibrium = solve(self, **task)
        found.append((task["drives"][0].target, equilibrium))
        return equilibrium

    monkeypatch.setattr(Solver, "solve", noted)
    return found


def test_a_shape_does_not_depend_on_what_was_asked_for_before(profiles):
    asked, fresh = (ClosingPath(profiles["hook"], "index", COARSE) for _ in range(2))
    for pulled in (0.0093, 0.0021, 0.0058, 0.0002):
        asked.shape(pulled)
    for pulled in (0.0047, 0.0003):
        np.testing.assert_array_equal(asked.shape(pulled).vertices, fresh.shape(pulled).vertices)


@pytest.mark.parametrize("pulled", [0.0003, 0.0034, 0.0081])
def test_a_shape_is_that_of_a_solve_from_rest_alone(profiles, pulled):
    """Keyframes, extrapolation and interpolation choose where to start, not where to end."""
    settings = ClosingSettings(RESOLUTIONS["coarse"], tolerance=1e-6, max_iterations=6000)
    closing = ClosingPath(profiles["power"], "index", settings)
    direct = closing._solve(closing.body.solver, 1e3 * pulled, closing.body.solver.rest())
    assert direct.converged
    shape = closing.shape(pulled)
    moved = 1e3 * shape.vertices - closing.finger_mesh.mesh.nodes
    np.testing.assert_allclose(moved, direct.displacement, atol=2e-4 * np.abs(direct.displacement).max())


def test_only_what_the_length_needs_is_solved(profiles, solved):
    closing = ClosingPath(profiles["pinch"], "index", COARSE)
    assert not solved
    closing.shape(0.0021)
    assert max(length for length, _ in solved) == pytest.approx(3.0)
    count = len(solved)
    closing.shape(0.0021)  # the tendon stands still
    assert len(solved) == count
    closing.shape(0.0022)
    assert len(solved) == count + 1


def test_a_keyframe_may_take_half_the_iterations_of_a_shape(profiles, monkeypatch):
    allowed = []
    solve = Solver.solve

    def noted(self, **task):
        allowed.append(task["max_iterations"])
        return solve(self, **task)

    monkeypatch.setattr(Solver, "solve", noted)
    ClosingPath(profiles["pinch"], "index", ClosingSettings(RESOLUTIONS["coarse"], max_iterations=200)).shape(0.0012)
    assert allowed[-1] == 200
    assert set(allowed[:-1]) == {100}


def test_a_body_shared_by_two_frictions_gives_the_bits_of_two_bodies(profiles):
    body = Body(profiles["hook"], "index", COARSE.resolution)
    for coefficient in (0.0, 0.4, 0.0):
        friction = rubbing(coefficient)
        shared = ClosingPath(profiles["hook"], "index", COARSE, friction=friction, body=body)
        alone = ClosingPath(profiles["hook"], "index", COARSE, friction=friction)
        one, other = shared.shape(0.003), alone.shape(0.003)
        np.testing.assert_array_equal(one.vertices, other.vertices)
        assert one.tension == other.tension
        assert shared.digest == alone.digest


def session_of(profiles, settings):
    return ShapeSession(profiles, {"index": "power"}, settings, rate_hz=30.0, marker_rate_hz=0.0)


def test_swaps_and_friction_models_mesh_a_finger_once_and_solve_nothing(profiles, solved, monkeypatch):
    meshed = []
    start = Body.__init__
    monkeypatch.setattr(Body, "__init__", lambda self, *a, **k: (meshed.append(a[0].id), start(self, *a, **k))[1])
    session = session_of(profiles, COARSE)
    for profile in ("hook", "power", "pinch", "hook", "power"):
        session.set_mounted({"index": profile})
        session.set_friction(rubbing(0.1))
        session.set_friction(rubbing(0.2))
    assert sorted(meshed) == ["hook", "pinch", "power"]
    assert not solved


@dataclass
class SlowMachine:
    """A session whose solver takes a time of its own for every iteration, fed by tendon states at 200 Hz.

    The newest state waits while one is solved, as in the node.
    """

    session: ShapeSession
    solved: list
    seconds_an_iteration: float
    now: float = 0.0
    shown: list[tuple[float, Shown]] = field(default_factory=list)

    def run(self, until, pulled_length_m):
        """Let time pass; `pulled_length_m` is the pulled length at a time."""
        while self.now < until:
            number = int(self.now * STATE_HZ + 1e-6)
            stamp = number / STATE_HZ
            before = len(self.solved)
            sample = TendonInput(round(1e9 * stamp), pulled_length_m(stamp), 0.0, 1.0)
            shown = list(self.session.on_tendons(["index"], [sample]))
            iterations = sum(found.iterations for _, found in self.solved[before:])
            self.shown += [(stamp, one) for one in shown]
            self.now = max(self.now + self.seconds_an_iteration * iterations, (number + 1) / STATE_HZ)


def closing_motion(stamp):
    return float(np.clip(0.010 * (stamp - 1.0), -0.001, 0.012))


def test_a_slow_solver_gives_fewer_and_coarser_shapes_that_say_so_and_recovers(profiles, solved):
    machine = SlowMachine(session_of(profiles, MEDIUM), solved, 0.01)
    machine.run(40.0, closing_motion)
    fine = ClosingPath(profiles["power"], "index", MEDIUM).hexahedra
    assert {shown.hexahedra for _, shown in machine.shown} == {432, fine}
    assert len({shown.configuration for _, shown in machine.shown}) == 1  # whichever mesh serves
    for stamp, shown in machine.shown:
        # never an old shape: each is that of its own state, which was the newest when its turn came
        assert shown.shape.pulled_length_m == closing_motion(stamp)
        assert ("coarser mesh (432 instead of" in shown.reason) == (shown.hexahedra == 432)
    for (before, _), (after, shown) in zip(machine.shown, machine.shown[1:], strict=False):
        if after - before > 0.4:  # too slow to look at
            assert shown.hexahedra == 432
            assert "Hz instead of 30 Hz" in shown.reason
    # closed and at rest, the shape asked for is there in the end, on the mesh asked for
    assert machine.shown[-1][1].hexahedra == fine
    assert machine.shown[-1][1].reason == ""


def test_what_the_coarse_mesh_had_to_show_the_fine_one_learns_while_the_tendon_rests(profiles, solved):
    fine = ClosingPath(profiles["power"], "index", MEDIUM).hexahedra

    def closing_and_opening(stamp):
        return float(np.clip(0.010 * (min(stamp, 3.4 - stamp) - 1.0), -0.001, 0.006))

    foreseen = []
    for seconds_an_iteration in (0.003, 0.0035, 0.004):
        machine = SlowMachine(session_of(profiles, MEDIUM), solved, seconds_an_iteration)
        machine.run(30.0, closing_and_opening)  # open and at rest from 2.4 s on
        foreseen += [shown for _, shown in machine.shown if "its next shape would take" in shown.reason]
        before = len(machine.shown)
        machine.run(40.0, lambda stamp: closing_and_opening(stamp - 30.0))
        again = [shown for _, shown in machine.shown[before:] if shown.shape.pulled_length_m > 0.0]
        assert max(shown.shape.pulled_length_m for shown in again) > 0.0055
        assert {shown.hexahedra for shown in again} == {fine}
    assert foreseen
    assert {shown.hexahedra for shown in foreseen} == {432}


def test_what_a_slow_machine_showed_a_quick_one_replays_to_the_same_bits(profiles, solved):
    machine = SlowMachine(session_of(profiles, MEDIUM), solved, 0.01)
    machine.run(12.0, closing_motion)
    replayed = session_of(profiles, MEDIUM)
    for stamp, then in machine.shown:
        (now,) = replayed.on_tendons(["index"], [TendonInput(round(1e9 * stamp), closing_motion(stamp), 0.0, 1.0)])
        assert (now.mesh, now.reason, now.shape.iterations) == (then.mesh, then.reason, then.shape.iterations)
        np.testing.assert_array_equal(now.shape.vertices, then.shape.vertices)


def test_a_quick_solver_never_leaves_its_mesh(profiles, solved):
    machine = SlowMachine(session_of(profiles, MEDIUM), solved, 1e-5)
    machine.run(4.0, closing_motion)
    assert len({shown.mesh for _, shown in machine.shown}) == 1
    assert len(machine.shown) == pytest.approx(120, abs=2)
    assert not any(shown.reason for stamp, shown in machine.shown if stamp > 1.2)


def test_states_that_show_nothing_leave_no_trace(profiles):
    """While a hand is empty: with and without them, the shapes that follow say the same."""

    def shown(empty_too):
        session = ShapeSession(profiles, {"index": "hook"}, COARSE, rate_hz=30.0, marker_rate_hz=1.0)
        reported = []
        for k in range(120):
            stamp = round(k * 1e9 / STATE_HZ)
            if k in (40, 80):
                session.set_mounted({"index": "hook"} if k == 80 else {})
            if empty_too or not 40 <= k < 80:
                reported += session.on_tendons(["index"], [TendonInput(stamp, 0.00002 * k, 0.0, 1.0)])
        return [(one.rate_hz, one.reason, one.hexahedra) for one in reported]

    assert shown(empty_too=True) == shown(empty_too=False)


def test_a_finger_that_took_long_to_make_ready_is_not_shown_coarse_for_it(profiles):
    session = ShapeSession(profiles, {"index": "hook"}, MEDIUM, rate_hz=30.0, marker_rate_hz=0.0)
    fine = session._fingers["index"].fine.hexahedra

    def shown(seconds):
        (one,) = session.on_tendons(["index"], [TendonInput(round(1e9 * seconds), -0.001, 0.0, 1.0)])
        return one.hexahedra

    assert shown(0.0) == fine
    session.set_mounted({"index": "pinch"})
    assert shown(1.0) != 432
    assert shown(2.0) == 432  # nothing but slowness explains this


def test_keyframes_that_made_no_shape_late_are_foreseen_to_take_no_time(profiles):
    session = ShapeSession(profiles, {"index": "hook"}, MEDIUM, rate_hz=25.0, marker_rate_hz=0.0)
    reported = []
    for number, pulled in enumerate((-0.001, 0.0005, 0.0015, 0.0025, 0.012)):
        reported += session.on_tendons(["index"], [TendonInput(number * 40_000_000, pulled, 0.0, 1.0)])
    assert len(reported) == 5
    assert not any("coarser mesh" in shown.reason for shown in reported)


@pytest.mark.parametrize(("late_s", "given"), [(0.0, [1, 2, 4]), (0.03, [1, 0, 0])])
def test_the_fine_mesh_catches_up_ever_faster_on_keyframes_that_take_no_time(profiles, late_s, given):
    """The tendon moves all the while; a shape after a keyframe that took time comes late."""
    session = session_of(profiles, MEDIUM)
    keyframes = session._fingers["index"].fine.keyframes
    stamp, asked, hexahedra = 1.0, [0], []

    def show():
        pulled = 0.004 + 0.0002 * (len(asked) % 2)
        (one,) = session.on_tendons(["index"], [TendonInput(round(1e9 * stamp), pulled, 0.0, 1.0)])
        asked.append(keyframes.requested)
        hexahedra.append(one.hexahedra)

    session._fingers["index"].why = "as if it had been late"
    keyframes.advance()  # the undeformed state takes no time
    asked[0] = keyframes.requested
    while len(asked) < 40 and not keyframes.covers(0.0042 * 1e3):
        stamp += 0.04 + (late_s if len(asked) > 1 and asked[-1] > asked[-2] else 0.0)
        show()
    gains = np.diff(asked)
    assert gains[:3].tolist() == given
    if late_s > 0.0:
        assert gains.sum() <= 1 + 40 * 0.05 / 0.5
        return
    stamp += 0.04
    show()
    assert hexahedra[-1] != 432
