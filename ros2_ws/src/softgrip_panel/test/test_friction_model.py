# SPDX-License-Identifier: Apache-2.0
"""A friction model beside its points: curves and intervals by their closed forms; what somebody refused."""

from __future__ import annotations

import asyncio
import math
import re
from pathlib import Path

import pytest

from softgrip_model.friction.laws import FrictionLaw, Law
from softgrip_panel.access.record import ActRecord
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.friction import (
    MAX_CURVES,
    MAX_REFUSALS,
    FrictionModelView,
    FrictionRefusals,
    Refusal,
    RigPoint,
    fit_picture,
    intervals,
)
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import PanelState
from softgrip_panel.web.charts import fit_chart

ADA, EVE = Person("a", "Ada", Role.OPERATE), Person("e", "Eve", Role.LOOK)
MU, MU_STDDEV, FREEDOM = 0.2, 0.01, 5
#: Student's t, 97.5 %, five degrees of freedom; and of the normal distribution (any table).
T_5, Z = 2.571, 1.960


def capstan(covariance: tuple[float, ...] = (MU_STDDEV**2,), freedom: int = FREEDOM) -> FrictionModelView:
    law = FrictionLaw(Law.CAPSTAN, (MU,), 3.0, angle_range=(0.5, math.pi), tension_range=(2.0, 10.0))
    return FrictionModelView(
        "cord", "capstan", (), 0.01, 0.02, 9, 0.0, "USABLE", "", False, "", "", law, covariance, freedom
    )


def point(angle_rad: float, load_kg: float, verdict: str = "ACCEPTED") -> RigPoint:
    low = 9.81 * load_kg
    return RigPoint(0, angle_rad, load_kg, low, low * math.exp(MU * angle_rad), 0.05, verdict, "")


@pytest.mark.parametrize(("freedom", "quantile"), [(5, T_5), (0, Z)])
def test_an_interval_is_as_wide_as_its_degrees_of_freedom_make_it(freedom: int, quantile: float) -> None:
    ((name, value, half),) = intervals(["mu"], [MU], [MU_STDDEV**2], freedom)
    assert (name, value) == ("mu", MU)
    assert half == pytest.approx(quantile * MU_STDDEV, rel=1e-3)


def test_a_model_without_a_covariance_has_no_interval() -> None:
    ((_, _, half),) = intervals(["mu"], [MU], [], FREEDOM)
    assert math.isnan(half)
    picture = fit_picture(capstan(covariance=()), [point(1.0, 0.5)])
    assert all(math.isnan(low) and math.isnan(high) for _, _, low, high in picture.curves[0].points)
    assert "band" not in fit_chart(picture, "", "", "")


def test_a_curve_and_its_interval_are_capstans() -> None:
    picture = fit_picture(capstan(), [point(1.0, 0.5), point(math.pi, 1.0)])
    assert [curve.tension_low_n for curve in picture.curves] == pytest.approx([4.905, 9.81])
    assert [number for _, number in picture.points] == [0, 1]
    for angle, ratio, low, high in picture.curves[0].points:
        assert ratio == pytest.approx(math.exp(MU * angle))
        assert low == pytest.approx(math.exp((MU - T_5 * MU_STDDEV) * angle), rel=1e-4)
        assert high == pytest.approx(math.exp((MU + T_5 * MU_STDDEV) * angle), rel=1e-4)
    assert picture.curves[0].points[-1][0] == pytest.approx(math.pi)


def test_without_points_the_calibrated_tensions_have_a_curve_each() -> None:
    assert [curve.tension_low_n for curve in fit_picture(capstan(), []).curves] == [2.0, 6.0, 10.0]


def test_many_loads_share_the_curves_that_there_are() -> None:
    points = [point(1.0, 0.1 * k) for k in range(1, 10)]
    picture = fit_picture(capstan(), points)
    assert len(picture.curves) == MAX_CURVES
    assert [curve.tension_low_n for curve in picture.curves][:: MAX_CURVES - 1] == pytest.approx([0.981, 8.829])
    assert picture.points[-1][1] == MAX_CURVES - 1


def test_points_without_a_model_are_drawn_alone() -> None:
    picture = fit_picture(None, [point(1.0, 0.5), point(2.0, 0.5, "REJECTED")])
    assert picture.curves == ()
    drawn = fit_chart(picture, "", "", "")
    assert (drawn.count('class="measured"'), drawn.count('class="refused"')) == (1, 1)


def test_a_point_on_the_law_stands_on_its_curve() -> None:
    drawn = fit_chart(fit_picture(capstan(), [point(math.pi, 0.5)]), "", "", "")
    dot = re.search(r'class="measured" cx="([0-9.]+)" cy="([0-9.]+)"', drawn)
    curve = re.search(r'class="fitted" d="[^"]* L([0-9.]+) ([0-9.]+)"', drawn)
    assert dot is not None
    assert curve is not None
    assert [float(one) for one in dot.groups()] == pytest.approx([float(one) for one in curve.groups()], abs=0.2)


def test_hostile_words_stay_words() -> None:
    drawn = fit_chart(fit_picture(None, []), '"><script>', "<b>", "<i>")
    assert "<script>" not in drawn
    assert "<b>" not in drawn
    assert "<i>" not in drawn


# --- accept or refuse


class Cell:
    def __init__(self) -> None:
        self.asked: list[Act] = []
        self.success = True

    async def call(self, act: Act, who: str) -> ActResult:
        self.asked.append(act)
        return ActResult(success=self.success, message="written" if self.success else "no database")

    def cancel(self, act_name: str) -> None:
        raise AssertionError


def desk_of(state: PanelState) -> tuple[ActDesk, Cell]:
    cell = Cell()
    return ActDesk(state, cell, ActRecord(None, state.now_s)), cell


def test_a_model_is_refused_with_name_and_reason_and_remembered(state: PanelState, tmp_path: Path) -> None:
    state.refusals.keep_in(tmp_path / "friction.json")
    desk, cell = desk_of(state)
    state.control.take_control(ADA)
    assert asyncio.run(desk.refuse_model(ADA, "cord", " old cable ")).success
    (act,) = cell.asked
    assert (act.call.name, act.call.request) == (
        "cell/write_audit",
        {"who": "Ada", "action": "refuse friction model", "subject": "cord", "detail": "old cable"},
    )
    assert state.refusals.find("cord") == Refusal("Ada", "old cable", state.now_s())
    again = FrictionRefusals()
    again.keep_in(tmp_path / "friction.json")
    assert again.find("cord") == Refusal("Ada", "old cable", state.now_s())
    assert (tmp_path / "friction.json").stat().st_mode & 0o777 == 0o600
    assert asyncio.run(desk.activate_model(ADA, "cord", "it was the right one")).success
    assert state.refusals.find("cord") is None
    again.keep_in(tmp_path / "friction.json")
    assert again.find("cord") is None


@pytest.mark.parametrize("name", ["refuse_model", "activate_model"])
def test_a_model_is_neither_refused_nor_activated_without_reason_role_or_control(state: PanelState, name: str) -> None:
    desk, cell = desk_of(state)
    judge = getattr(desk, name)
    assert not asyncio.run(judge(ADA, "cord", "old cable")).success  # no control
    state.control.take_control(ADA)
    assert not asyncio.run(judge(EVE, "cord", "old cable")).success
    assert "expected some words" in asyncio.run(judge(ADA, "cord", "  ")).message
    assert cell.asked == []
    assert state.refusals.find("cord") is None


def test_a_refusal_that_the_audit_table_does_not_take_is_none(state: PanelState) -> None:
    desk, cell = desk_of(state)
    cell.success = False
    state.control.take_control(ADA)
    assert not asyncio.run(desk.refuse_model(ADA, "cord", "old cable")).success
    assert state.refusals.find("cord") is None


@pytest.mark.parametrize("text", ["", "[]", "{", '{"cord": 1}', '{"cord": {"who": "Ada"}}'])
def test_a_spoiled_file_of_refusals_has_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "friction.json").write_text(text)
    refusals = FrictionRefusals()
    refusals.keep_in(tmp_path / "friction.json")
    assert refusals.find("cord") is None


def test_refusals_do_not_grow_without_end() -> None:
    refusals = FrictionRefusals()
    for number in range(MAX_REFUSALS + 1):
        refusals.add(f"model {number}", Refusal("Ada", "no", 0.0))
    assert refusals.find("model 0") is None
    assert refusals.find(f"model {MAX_REFUSALS}") is not None
