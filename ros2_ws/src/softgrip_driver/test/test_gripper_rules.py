# SPDX-License-Identifier: Apache-2.0
"""What a stop, a lock and a cancellation mean for every kind of order, stepped by hand over fingers in closed form."""

from __future__ import annotations

import pytest

from softgrip_driver.errors import NoReplyError
from softgrip_driver.tendon.gripper import Block, GripperController, MoveMode, MoveRequest, Policies, StopPolicy
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.motions import DriveState, MoveOutcome
from softgrip_driver.tendon.status import DriveActions
from softgrip_driver.tendon.trajectory import TendonTrajectory

DT = 0.005
LIMITS = TendonLimits()
STOP = Block("stopped by a person", is_stop=True, lets_go=False)
LOCK = Block("hands are inside", is_stop=False, lets_go=True)


class Cell:
    """Two homed fingers that hold, and what blocks them."""

    def __init__(self, finger, reading) -> None:  # type: ignore[no-untyped-def]  # fixtures
        self.fingers = {name: finger() for name in ("a", "b")}
        self.reading, self.now = reading, 0.0
        self.block: Block | None = None
        policies = Policies(estop=StopPolicy.HOLD)
        self.controller = GripperController(dict.fromkeys(self.fingers, LIMITS), policies, block=lambda: self.block)
        self.cycle()
        for name, drive in self.controller.drives.items():
            drive.switch_on()
            drive.set_zero(self.fingers[name].taut, 1)
        self.cycle(200)  # to where the zeros are now

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.now += DT
            readings = {}
            for name, finger in self.fingers.items():
                finger.time = self.now
                readings[name] = finger.read(self.reading)
            for name, action in self.controller.step(self.now, readings).items():
                if action.setpoint is not None:
                    self.fingers[name].advance(DT, action.setpoint)

    def orders(self):  # type: ignore[no-untyped-def]
        """Every kind of order."""
        move = MoveRequest((), MoveMode.LENGTH, [0.015], 0.02, 20.0)
        pull = MoveRequest((), MoveMode.TENSION, [8.0], 0.02)
        stream = {"a": TendonTrajectory.checked([1.0], [0.015], [], LIMITS.travel, LIMITS.speed)}
        return {
            "length": lambda: self.controller.move(move, self.now),
            "tension": lambda: self.controller.move(pull, self.now),
            "stream": lambda: self.controller.follow(stream, self.now),
            "home": lambda: self.controller.home(self.now),
            "release": lambda: self.controller.release(self.now),
        }


@pytest.fixture
def cell(spring_finger, reading) -> Cell:  # type: ignore[no-untyped-def]
    return Cell(spring_finger, reading)


@pytest.mark.parametrize("kind", ["length", "tension", "stream", "home", "release"])
@pytest.mark.parametrize("block", [STOP, LOCK], ids=["stopped", "locked"])
def test_no_order_of_any_kind_moves_a_cell_that_is_stopped_or_locked(cell: Cell, kind: str, block: Block) -> None:
    """Stopped, the drives go on holding with torque on: whatever is obeyed would move."""
    cell.block = block
    cell.cycle(2)
    assert all(drive.powered is not block.lets_go for drive in cell.controller.drives.values())
    ticket = cell.orders()[kind]()
    assert cell.controller.result(ticket)[0] is MoveOutcome.REFUSED
    assert block.text in ticket.refusal
    where = {name: finger.position for name, finger in cell.fingers.items()}
    cell.cycle(100)
    assert {name: finger.position for name, finger in cell.fingers.items()} == pytest.approx(where, abs=2e-4)


@pytest.mark.parametrize("kind", ["length", "tension", "stream", "release"])
def test_a_stop_ends_every_kind_of_motion_within_a_cycle(cell: Cell, kind: str) -> None:
    cell.controller.move(MoveRequest((), MoveMode.LENGTH, [0.008], 0.02, 20.0), cell.now)
    cell.cycle(200)
    cell.orders()[kind]()
    cell.cycle(10)
    assert cell.controller.drives["a"].busy
    cell.block = STOP
    cell.cycle()
    assert not any(drive.busy for drive in cell.controller.drives.values())
    assert {drive.fault for drive in cell.controller.drives.values()} == {"estop"}


def test_after_a_reset_the_stop_is_shown_as_over_and_the_next_one_counts_again(cell: Cell) -> None:
    for _ in range(2):
        cell.block = STOP
        cell.cycle()
        assert cell.controller.estop
        cell.block = None
        cell.controller.reset()
        assert not cell.controller.estop
        assert {drive.fault for drive in cell.controller.drives.values()} == {""}


def test_a_cancelled_move_stops_where_it_is_and_no_other_one_does(cell: Cell) -> None:
    first = cell.controller.move(MoveRequest(["a"], MoveMode.LENGTH, [0.015], 0.02, 20.0), cell.now)
    other = cell.controller.move(MoveRequest(["b"], MoveMode.LENGTH, [0.015], 0.02, 20.0), cell.now)
    cell.cycle(40)
    cell.controller.cancel(first, cell.now)
    stopped_at = cell.fingers["a"].position
    cell.cycle(400)
    assert cell.controller.drives["a"].state is DriveState.HOLDING
    assert cell.fingers["a"].position == pytest.approx(stopped_at, abs=1e-3)
    assert cell.controller.result(other)[0] is MoveOutcome.REACHED


def test_cancelling_what_was_replaced_stops_nothing(cell: Cell) -> None:
    old = cell.controller.move(MoveRequest(["a"], MoveMode.LENGTH, [0.015], 0.02, 20.0), cell.now)
    new = cell.controller.move(MoveRequest(["a"], MoveMode.LENGTH, [0.010], 0.02, 20.0), cell.now)
    cell.controller.cancel(old, cell.now)
    cell.cycle(400)
    assert cell.controller.result(new)[0] is MoveOutcome.REACHED


# --- the loop's last act -------------------------------------------------------------------------------------------


class Switches:
    """A backend of two switches, one of which may not hear."""

    tendons = ("a", "b")

    def __init__(self, deaf: str = "") -> None:
        self.deaf, self.is_on = deaf, {"a": True, "b": True}

    def power(self, tendon: str, on: bool) -> None:
        if tendon == self.deaf:
            raise NoReplyError("silent")
        self.is_on[tendon] = on


def loop_over(switches: Switches, block: Block | None = None) -> BusLoop:
    controller = GripperController(
        dict.fromkeys(switches.tendons, LIMITS), Policies(estop=StopPolicy.HOLD), block=lambda: block
    )
    return BusLoop(switches, controller, 100.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("deaf", ["", "a", "b"])
def test_a_drive_that_does_not_hear_keeps_no_other_one_on_and_is_reported(deaf: str) -> None:
    switches = Switches(deaf)
    found = loop_over(switches)._act({name: DriveActions(power=False) for name in switches.tendons})
    assert found == ([deaf] if deaf else [])
    assert switches.is_on == {name: name == deaf for name in switches.tendons}


@pytest.mark.parametrize(("deaf", "confirmed"), [("", True), ("a", False), ("b", False)])
def test_a_process_has_let_go_only_when_every_drive_said_so(deaf: str, confirmed: bool) -> None:
    """Otherwise the next process has to start stopped."""
    switches = Switches(deaf)
    loop = loop_over(switches, LOCK)
    loop._leave()
    assert (loop.keeps_hold, loop.has_let_go) == (False, confirmed)
    assert switches.is_on == {name: name == deaf for name in switches.tendons}


def test_a_drive_whose_set_up_failed_stays_off_and_says_so(reading) -> None:  # type: ignore[no-untyped-def]
    """Its limits and its watchdog may not be what they should be."""

    def fails():  # type: ignore[no-untyped-def]
        yield
        raise NoReplyError("silent")

    loop = loop_over(Switches())
    drive = loop._controller.drives["a"]
    drive.step(DT, reading(DT, 0.0))
    drive.begin_restore(power=True)
    loop._restores["a"] = fails()
    for _ in range(2):
        loop._restore_a_step({})
    assert (drive.powered, drive.fault) == (False, "no_reply")
    assert drive.step(2 * DT, reading(2 * DT, 0.0, powered=True)).power is False
