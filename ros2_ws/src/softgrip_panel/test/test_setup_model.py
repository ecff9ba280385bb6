# SPDX-License-Identifier: Apache-2.0
"""Page Set-up without ROS and HTTP: parameters as typed, weights, tensioning, the lens, the terminal's steps."""

from __future__ import annotations

import asyncio
import math
import shlex
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softgrip_driver.commands import calibrate_tension, scan, selftest, setup, wizard
from softgrip_panel.access.record import ActRecord
from softgrip_panel.errors import PanelError
from softgrip_panel.model import tensioning
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.bench import BenchView, bus_causes, terminal_steps
from softgrip_panel.model.control import LOST_S
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import ComponentHealth
from softgrip_panel.model.lens import LensViews
from softgrip_panel.model.parameters import ParameterKind, ParameterView
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import PanelState
from softgrip_panel.model.tensioning import Tensioning
from softgrip_panel.model.weights import GRAVITY_M_S2, WeightCheck
from softgrip_testing.manual_clock import ManualClock

IDA = Person("s1", "Ida", Role.ENGINEER)
ADA = Person("s2", "Ada", Role.OPERATE)


# --- parameters


@pytest.mark.parametrize(
    ("kind", "value", "typed", "read"),
    [
        (ParameterKind.BOOL, True, "no", False),
        (ParameterKind.INTEGER, 3, "7", 7),
        (ParameterKind.DOUBLE, 1.5, "2", 2.0),
        (ParameterKind.STRING, "a", "0", "0"),  # not a number: a text stays a text
        (ParameterKind.DOUBLES, [1.0], "[1, 2.5]", [1.0, 2.5]),
        (ParameterKind.STRINGS, ["a"], "[index, thumb]", ["index", "thumb"]),
        (ParameterKind.BOOLS, [True], "[true, false]", [True, False]),
    ],
)
def test_what_is_typed_becomes_a_value_of_its_type(
    kind: ParameterKind, value: object, typed: str, read: object
) -> None:
    view = ParameterView("p", kind, value, minimum=0.0, maximum=10.0)
    assert view.read(typed) == read
    assert type(view.read(typed)) is type(read)
    assert view.read(view.text) == value  # what is shown can be typed again


@pytest.mark.parametrize(
    ("kind", "typed", "said"),
    [
        (ParameterKind.INTEGER, "1.5", "expected integer"),
        (ParameterKind.INTEGER, "true", "expected integer"),
        (ParameterKind.INTEGER, "11", r"expected 0 \.\. 10, found 11"),
        (ParameterKind.DOUBLE, ".nan", r"expected 0 \.\. 10"),
        (ParameterKind.DOUBLES, "[1, 99]", r"expected 0 \.\. 10"),
        (ParameterKind.DOUBLES, "1", "a list"),
        (ParameterKind.DOUBLES, "[]", "a list"),
        (ParameterKind.BOOL, "{a: b}", "expected bool"),
        (ParameterKind.STRING, "x" * 3000, "at most 2000 characters"),
        (ParameterKind.INTEGER, "!!python/object/apply:os.system [id]", "expected integer"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_was_expected(kind: ParameterKind, typed: str, said: str) -> None:
    with pytest.raises(PanelError, match=said):
        ParameterView("p", kind, [1.0] if kind >= 6 else 1, minimum=0.0, maximum=10.0).read(typed)


@given(st.text(max_size=60), st.sampled_from([one for one in ParameterKind if one not in {0, 5}]))
def test_no_text_breaks_a_parameter(typed: str, kind: ParameterKind) -> None:
    try:
        value = ParameterView("p", kind, 0, minimum=-5.0, maximum=5.0).read(typed)
    except PanelError:
        return
    numbers = [one for one in (value if isinstance(value, list) else [value]) if type(one) in {int, float}]
    assert all(-5.0 <= one <= 5.0 for one in numbers)


# --- bus


def driver_says(state: PanelState, zeros_mm: dict[str, float], **bus: str) -> None:
    servos = [
        ComponentHealth(f"cell_b/tendon_driver: {name}", 0, "", {"zero [mm]": f"{zero:.3f}"})
        for name, zero in zeros_mm.items()
    ]
    state.observe_health([ComponentHealth("cell_b/tendon_driver: bus", 0, "", bus), *servos])


def test_what_the_driver_says_of_its_bus_and_zeros(state: PanelState) -> None:
    driver_says(state, {"index": 1.25, "thumb": math.nan}, **{"lost replies": "2", "missed cycles": "0"})
    assert state.bench.zeros_mm == {"index": 1.25}  # the other one is not homed
    assert bus_causes(state.bench) == ("setup.lost",)
    state.observe_health([ComponentHealth("camera: picture", 0, "", {"zero [mm]": "1"})])
    assert state.bench.reports == 1


def test_the_terminals_steps_are_commands_that_the_commands_take(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = BenchView("active", "/dev/my servos", 57600, ("index", "thumb"), (4, 5))
    mains = {
        "scan": scan,
        "wizard": wizard,
        "setup": setup,
        "selftest": selftest,
        "calibrate_tension": calibrate_tension,
    }
    for step in terminal_steps(bench):
        ros2, run, package, command, *options = shlex.split(step.command)
        assert (ros2, run, package) == ("ros2", "run", "softgrip_driver")
        with monkeypatch.context() as patched:
            patched.setattr(
                mains[command], "run", lambda _work, parser, args: parser.parse_args(args)
            )  # stops before the bus
            mains[command].main(options)
        assert "/dev/my servos" in options


# --- weights


def test_weights_show_by_how_much_a_tension_is_off() -> None:
    check = WeightCheck()
    for mass_kg in (0.2, 0.5, 1.0):
        for tendon, factor in (("index", 1.1), ("thumb", 0.7)):
            weight_n = mass_kg * GRAVITY_M_S2
            check.add_weight(tendon, mass_kg, [factor * weight_n + swing for swing in (-0.05, 0.0, 0.05, 0.0, 0.0)])
    assert check.factors() == pytest.approx({"index": 1.1, "thumb": 0.7}, abs=1e-9)
    assert check.is_good("index")
    assert not check.is_good("thumb")
    assert check.points[0].error == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("mass_kg", "readings", "said"),
    [
        (0.5, [1.0, 9.0, 1.0, 9.0, 5.0], "at rest"),
        (50.0, [5.0] * 9, r"expected 0.02 \.\. 5 kg"),
        (math.nan, [5.0] * 9, "expected 0.02"),
        (0.5, [math.nan] * 9, "is it powered"),
    ],
)
def test_a_weight_that_says_nothing_is_refused(mass_kg: float, readings: list[float], said: str) -> None:
    check = WeightCheck()
    with pytest.raises(PanelError, match=said):
        check.add_weight("index", mass_kg, readings)
    assert check.points == ()


# --- tensioning


class Cell:
    """Its zero beds in by half the way with each pull, and after a homing it says so twice. Refuses one act."""

    def __init__(self, state: PanelState) -> None:
        self.state, self.refuses, self.is_silent = state, "", False
        self.done: list[str] = []
        self.zero_mm = 0.0

    async def call(self, act: Act, who: str) -> ActResult:
        self.done.append(act.name)
        if act.name == self.refuses:
            return ActResult(success=False, message=f"{act.name}: expected something else")
        if act.name == "pull":
            self.zero_mm += 0.5 * (1.0 - self.zero_mm)
        for delay_s in (0.002, 0.003) if act.name == "home" and not self.is_silent else ():
            asyncio.get_running_loop().call_later(delay_s, driver_says, self.state, {"index": self.zero_mm})
        return ActResult(success=True, message="")

    def cancel(self, act_name: str) -> None:
        pass


@pytest.fixture
def bedding(state: PanelState, monkeypatch: pytest.MonkeyPatch) -> tuple[Tensioning, Cell]:
    monkeypatch.setattr(tensioning, "PLAN", replace(tensioning.PLAN, hold_s=0.0))
    monkeypatch.setattr(tensioning, "_POLL_S", 0.001)
    monkeypatch.setattr(tensioning, "ZEROS_WAIT_S", 0.01)
    cell = Cell(state)
    return Tensioning(ActDesk(state, cell, ActRecord(None, lambda: 0.0)), lambda: state.bench), cell


def test_rounds_go_on_until_no_zero_moves(state: PanelState, bedding: tuple[Tensioning, Cell]) -> None:
    work, cell = bedding
    state.control.take_control(IDA)

    async def rounds() -> None:
        for _ in range(3):
            await work.run_round(IDA)

    asyncio.run(rounds())
    assert work.problem == ""
    assert [one.shifts_mm["index"] for one in work.rounds] == pytest.approx([0.5, 0.25, 0.125])
    assert [one.has_settled for one in work.rounds] == [False, False, True]
    assert cell.done == ["home", *3 * ("pull", "slacken", "home")]


@pytest.mark.parametrize("refused", ["home", "pull", "slacken"])
def test_a_refused_step_ends_the_round(state: PanelState, bedding: tuple[Tensioning, Cell], refused: str) -> None:
    work, cell = bedding
    state.control.take_control(IDA)
    cell.refuses = refused
    asyncio.run(work.run_round(IDA))
    assert work.problem == f"{refused}: expected something else"
    assert cell.done[-1] == refused
    assert (work.rounds, work.is_running) == ((), False)


def test_without_control_or_as_an_operator_nothing_is_pulled(
    state: PanelState, bedding: tuple[Tensioning, Cell]
) -> None:
    work, cell = bedding
    asyncio.run(work.run_round(IDA))
    assert "expected you to have control" in work.problem
    state.control.take_control(ADA)
    asyncio.run(work.run_round(ADA))
    assert "expected the role engineer" in work.problem
    assert "pull" not in cell.done


def test_a_round_whose_watcher_has_left_ends(
    state: PanelState, bedding: tuple[Tensioning, Cell], clock: ManualClock
) -> None:
    work, cell = bedding
    state.control.take_control(IDA)
    clock.s += LOST_S + 1.0
    asyncio.run(work.run_round(IDA))
    assert "no open page of yours" in work.problem
    assert cell.done == []


def test_a_silent_driver_ends_the_round(state: PanelState, bedding: tuple[Tensioning, Cell]) -> None:
    work, cell = bedding
    state.control.take_control(IDA)
    cell.is_silent = True
    asyncio.run(work.run_round(IDA))
    assert "/diagnostics" in work.problem
    assert cell.done == ["home"]


# --- lens


def test_views_are_refused_where_they_show_nothing_new(tmp_path: Path, board_pictures: list[bytes]) -> None:
    lens = LensViews(tmp_path / "views")
    lens.add_view(board_pictures[0])
    with pytest.raises(PanelError, match="in another place"):
        lens.add_view(board_pictures[0])
    for wrong in (b"", b"\xff\xd8 no picture"):
        with pytest.raises(PanelError, match="none that can be read"):
            lens.add_view(wrong)
    assert len(lens.views) == len(list((tmp_path / "views").iterdir())) == 1
    assert 0 < sum(map(sum, lens.covered())) < 16
    lens.start(9, 6, 16.0)
    assert lens.views == ()
    assert not (tmp_path / "views").exists()
    with pytest.raises(PanelError, match=r"3 \.\. 40 squares"):
        lens.start(1, 6, 16.0)


def test_a_picture_that_claims_too_many_pixels_is_refused_before_it_is_unpacked() -> None:
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII5B", 13, b"IHDR", 60_000, 60_000, 8, 2, 0, 0, 0)
    with pytest.raises(PanelError, match=r"expected an image of 32000000 pixels at most, found 60000x60000"):
        LensViews(None).add_view(header)


def test_the_lens_of_the_pictures_is_found_and_too_few_are_not(board_pictures: list[bytes]) -> None:
    lens = LensViews(None)
    for jpeg in board_pictures[:4]:
        lens.add_view(jpeg)
    lens.find_lens()
    assert lens.fit is None
    assert "at least 8" in lens.problem
    for jpeg in board_pictures[4:]:
        lens.add_view(jpeg)
    lens.find_lens()
    assert lens.fit is not None
    assert lens.fit.lens.matrix[0, 0] == pytest.approx(905.0, rel=0.005)  # what they were drawn with
    assert lens.fit.lens.matrix[1, 1] == pytest.approx(908.0, rel=0.005)
