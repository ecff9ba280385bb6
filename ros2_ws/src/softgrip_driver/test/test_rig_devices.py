# SPDX-License-Identifier: Apache-2.0
"""One contract for every stage and every gauge, on the wire; and the words of each protocol."""

from pathlib import Path

import numpy as np
import pytest

from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DeviceNotFoundError,
    DeviceRefusedError,
    NoReplyError,
    PortLostError,
    SaturatedError,
    UnitChangedError,
)
from softgrip_driver.rig import mark10
from softgrip_driver.rig.build import GAUGES, STAGES, StreamSettings, make_gauge, make_stage
from softgrip_driver.rig.line_format import LineFormat, line_format
from softgrip_emulator.rig.amplifier import COUNTS_PER_NEWTON, FORMATS

ALL_GAUGES = ["gcl2", *FORMATS]


def gauge_of(rig_gauge: str, directory: Path):
    stream = StreamSettings(line=rig_gauge, counts_per_newton=COUNTS_PER_NEWTON) if rig_gauge != "gcl2" else None
    return make_gauge("gcl2" if rig_gauge == "gcl2" else "stream", str(directory / "gauge"), stream)


@pytest.fixture
def until(world):
    def wait(condition, seconds=100.0):
        deadline = world.now() + seconds
        while not condition():
            assert world.now() < deadline, "the condition did not come"
            world.breathe()

    return wait


def stands(rig):
    rig.plant.advance(rig.clock.now_s())
    return rig.plant.velocity == 0.0


def read(gauge, times=3):
    """Read a few times: what is still on its way may be one good line."""
    return [gauge.tension() for _ in range(times)]


@pytest.fixture(params=STAGES)
def stage_rig(request, tmp_path, make_rig):
    rig, stage = make_rig(stage=request.param), make_stage(request.param, str(tmp_path / "stand"))
    yield rig, stage
    stage.close()


@pytest.fixture(params=ALL_GAUGES)
def gauge_rig(request, tmp_path, make_rig):
    rig, gauge = make_rig(gauge=request.param), gauge_of(request.param, tmp_path)
    yield rig, gauge
    gauge.close()


# -- every stage -------------------------------------------------------------------------------------------------------


def test_a_stage_identifies_itself(stage_rig):
    _, stage = stage_rig
    assert stage.open().model


def test_a_stage_goes_where_it_is_sent_and_stops_there(stage_rig, until):
    rig, stage = stage_rig
    stage.open()
    stage.zero()
    for target in (3e-3, 0.5e-3):
        stage.start(target, 2e-3)
        until(lambda target=target: abs(stage.travel() - target) < 2e-5)
        until(lambda: stands(rig))
        assert stage.travel() == pytest.approx(target, abs=2e-5)


def test_a_stage_runs_at_the_asked_speed(stage_rig):
    rig, stage = stage_rig
    stage.open()
    stage.zero()
    stage.start(20e-3, 40e-3 / 60)
    stage.travel()
    assert rig.plant.velocity == pytest.approx(40e-3 / 60, rel=1e-3)


def test_a_stage_stops_at_once(stage_rig, until):
    rig, stage = stage_rig
    stage.open()
    stage.zero()
    stage.start(20e-3, 1e-3)
    until(lambda: stage.travel() > 1e-3)
    stage.stop()
    until(lambda: stands(rig))
    assert stage.travel() < 19e-3


def test_closing_a_stage_stops_it(stage_rig, until):
    rig, stage = stage_rig
    stage.open()
    stage.zero()
    stage.start(20e-3, 1e-3)
    until(lambda: stage.travel() > 0.2e-3)
    stage.close()
    until(lambda: stands(rig))
    stage.close()


def test_a_stage_whose_host_dies_ends_its_motion_by_itself(stage_rig, until):
    rig, stage = stage_rig
    stage.open()
    stage.zero()
    stage.start(3e-3, 2e-3)
    until(lambda: stage.travel() > 0.0)
    stage._port.close()
    until(lambda: stands(rig))
    assert rig.plant.travel == pytest.approx(3e-3, abs=2e-5)


def test_a_silent_stage_is_told(stage_rig):
    rig, stage = stage_rig
    stage.open()
    rig.inject("stand_silent")
    with pytest.raises(NoReplyError, match="check power"):
        stage.travel()


def test_a_stage_that_cuts_its_replies_is_told(stage_rig):
    rig, stage = stage_rig
    stage.open()
    rig.inject("stand_reply_cut")
    with pytest.raises((NoReplyError, CorruptReplyError)):
        stage.travel()


def test_an_unplugged_stage_is_told_and_can_be_taken_up_again(stage_rig):
    rig, stage = stage_rig
    stage.open()
    rig.inject("unplugged", port="stand")
    with pytest.raises(PortLostError, match="plug it in"):
        stage.travel()
    with pytest.raises(DeviceNotFoundError, match="found nothing"):
        stage.open()
    rig.clear()
    assert stage.open().model
    assert np.isfinite(stage.travel())


# -- every gauge -------------------------------------------------------------------------------------------------------


def test_a_gauge_feels_the_tension(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    gauge.tare()
    rig.set(1.0, 0.6)
    assert np.mean(read(gauge, 10)) == pytest.approx(rig.plant.force * rig.truth.gauge_gain, abs=0.03)


def test_taring_makes_zero(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    rig.set(1.0, 0.2)
    gauge.tare()
    assert gauge.tension() == pytest.approx(0.0, abs=0.06)


def test_a_silent_gauge_is_told(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    rig.inject("gauge_silent")
    with pytest.raises(NoReplyError):
        read(gauge)


def test_a_gauge_that_cuts_its_lines_gives_no_number(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    rig.inject("gauge_reply_cut")
    with pytest.raises((NoReplyError, CorruptReplyError, UnitChangedError)):
        read(gauge)


# The other formats have no word for overload.
@pytest.mark.parametrize("gauge_rig", ["gcl2", "raw", "time_raw", "scale"], indirect=True)
def test_a_saturated_gauge_gives_no_number(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    rig.inject("saturated", capacity=0.5)
    rig.set(1.0, 1.0)
    with pytest.raises(SaturatedError):
        read(gauge)


def test_a_contaminated_stream_gives_no_number(gauge_rig, until):
    rig, gauge = gauge_rig
    gauge.open()
    rig.inject("contaminated_stream")

    def refused():
        try:
            gauge.tension()
        except CorruptReplyError:
            return True
        return False

    until(refused)


def test_an_unplugged_gauge_is_told_and_can_be_taken_up_again(gauge_rig):
    rig, gauge = gauge_rig
    gauge.open()
    rig.inject("unplugged", port="gauge")
    with pytest.raises(PortLostError):
        gauge.tension()
    rig.clear()
    gauge.open()
    assert np.isfinite(gauge.tension())


# -- one device's own --------------------------------------------------------------------------------------------------


def test_auto_return_at_the_panel_is_found_out(tmp_path, make_rig, until):
    rig = make_rig()
    stage = make_stage("mark10", str(tmp_path / "stand"))
    stage.open()
    stage.zero()
    stage.start(5e-3, 1e-3)
    until(lambda: stage.travel() > 1e-3)
    rig.inject("auto_return")
    with pytest.raises(DeviceRefusedError, match="PC control is off"):
        stage.start(8e-3, 1e-3)
    stage.close()


@pytest.mark.parametrize("unit", ["LB", "G", "KG", "MN"])
def test_a_unit_switched_at_the_panel_is_never_taken_for_newtons(tmp_path, make_rig, unit):
    rig = make_rig()
    gauge = gauge_of("gcl2", tmp_path)
    gauge.open()
    rig.inject("unit_switched", unit=unit)
    with pytest.raises(UnitChangedError, match="switched at the panel"):
        gauge.tension()
    assert abs(gauge.tension()) < 0.1
    gauge.close()


def test_an_illegal_command_is_told_with_its_code(tmp_path, make_rig):
    rig = make_rig()
    gauge = gauge_of("gcl2", tmp_path)
    gauge.open()
    rig.inject("illegal_command")
    with pytest.raises(DeviceRefusedError, match=r"\*10") as caught:
        gauge.tension()
    assert caught.value.code == 10
    gauge.close()


def test_a_low_battery_is_a_warning_and_automatic_output_is_given_back(tmp_path, make_rig, until):
    rig = make_rig()
    rig.inject("battery_low")
    rig.inject("contaminated_stream", rate=20)
    gauge = gauge_of("gcl2", tmp_path)
    assert gauge.open().warnings == ("battery low: charge the gauge",)
    assert rig.gauge.due_s() is None
    gauge.close()
    until(lambda: rig.gauge.due_s() is not None)


def test_grbl_in_alarm_is_refused(tmp_path, make_rig):
    rig = make_rig(stage="grbl")
    rig.inject("alarm")
    stage = make_stage("grbl", str(tmp_path / "stand"))
    with pytest.raises(DeviceRefusedError, match=r"\$X"):
        stage.open()
    rig.clear()
    stage.open()
    with pytest.raises(DeviceRefusedError, match="soft limits"):
        stage.start(0.5, 1e-3)
    stage.close()


def test_a_wrong_baud_rate_is_no_reply(tmp_path, make_rig):
    make_rig(gauge="grams")
    gauge = make_gauge("stream", str(tmp_path / "gauge"), StreamSettings(baud=9600))
    with pytest.raises((NoReplyError, CorruptReplyError)):
        gauge.open()
    gauge.close()


# -- words -------------------------------------------------------------------------------------------------------------


def test_a_speed_beyond_the_stand_s_own_is_named_and_it_stands(tmp_path, make_rig):
    """An ESM303 goes 1100 mm/min at most."""
    rig = make_rig(stage="mark10")
    stage = make_stage("mark10", str(tmp_path / "stand"))
    stage.open()
    stage.zero()
    with pytest.raises(DeviceRefusedError, match=r"take a speed of 1440.* its fastest is 1100.0 mm/min"):
        stage.start(0.01, 1440e-3 / 60.0)
    assert rig.plant.travel == 0.0
    stage.start(0.002, 1000e-3 / 60.0)
    stage.close()


def test_stand_commands_are_the_manuals():
    assert mark10.speed_command(40.0) == b"e0040.0"
    assert mark10.limit_command(b"h", 12.0) == b"h012.00"
    assert mark10.limit_command(b"g", -1.5) == b"g-001.50"
    assert mark10.limit_command(b"g", -0.001) == b"g000.00"
    with pytest.raises(ValueError, match="mm/min"):
        mark10.speed_command(0.0)


@pytest.mark.parametrize(
    ("line", "number", "unit"),
    [(b"-18.78 lbF", -18.78, "lbF"), (b"1.00 N", 1.0, "N"), (b"0.5", 0.5, ""), (b"  -3 gF ", -3.0, "gF")],
)
def test_gauge_readings(line, number, unit):
    assert mark10.parse_reading(line) == (number, unit)


@pytest.mark.parametrize("line", [b"", b"1.2.3 N", b"N", b"12 N 13 N", b"\xff\xfe", b"-"])
def test_damaged_readings_are_refused(line):
    with pytest.raises(CorruptReplyError):
        mark10.parse_reading(line)


def test_gauge_settings_of_the_manual():
    settings = mark10.parse_list(b"V1.00;LBF;CUR;FLTC8;FLTP1;AOUT00;AOFF5;FULL;MIT;POL;B0")
    assert (settings.unit, settings.mode, settings.auto_output, settings.filter_current, settings.battery) == (
        "lbF", "CUR", 0, 8, 0,
    )  # fmt: skip


def test_travel_in_inches_is_refused():
    assert mark10.parse_travel(b"2.00 mm") == pytest.approx(2e-3)
    with pytest.raises(CorruptReplyError, match="inches"):
        mark10.parse_travel(b"0.079 in")


@pytest.mark.parametrize(
    ("name", "line", "newtons"),
    [
        ("raw", b"160000", 160000.0),
        ("time_raw", b"1234,160000", 160000.0),
        ("grams", b"Reading: 12.34 g", 12.34e-3 * 9.81),
        ("openscale", b"1200,0.5000,kg,24.5,", 0.5 * 9.81),
    ],
)
def test_lines_of_real_devices(name, line, newtons):
    assert line_format(name).parse(line) == pytest.approx(newtons)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("scale", b"ST,GS,+\n12.345kg"),
        ("raw", b"9" * 400),
        (r"F=(?P<value>.*)", b"F=much"),
        (r"F=(?P<value>.*)", b"F=nan"),
        (r"F=(?P<value>\d+)?", b"F="),
    ],
)
def test_what_looks_like_a_line_and_holds_no_number_is_refused(name, line):
    with pytest.raises(CorruptReplyError, match="expected a number"):
        line_format(name).parse(line)


def test_a_line_format_of_ones_own():
    assert line_format(r"F=(?P<value>-?\d+)").parse(b"F=2500") == 2500.0
    with pytest.raises(ConfigurationError, match="value"):
        line_format(r"F=\d+")
    with pytest.raises(ConfigurationError, match="regular expression"):
        line_format(r"(")
    with pytest.raises(UnitChangedError):
        LineFormat(r"(?P<value>\d+) (?P<unit>\w+)", "N").parse(b"12 lb")


@pytest.mark.parametrize("kind", ["stage", "gauge"])
def test_unknown_kinds_are_refused(kind):
    with pytest.raises(ConfigurationError, match="expected one of"):
        make_stage("x", "/dev/null") if kind == "stage" else make_gauge("x", "/dev/null")
    assert GAUGES
