# SPDX-License-Identifier: Apache-2.0
"""Load cells as people have them: boards that boot, lines of every maker, gauges that must be asked, known weights."""

from __future__ import annotations

from pathlib import Path

import pytest

from softgrip_driver.commands.calibrate_cell import weigh
from softgrip_driver.errors import (
    ConfigurationError,
    CorruptReplyError,
    DeviceRefusedError,
    DriverError,
    GaugeRestartedError,
    NoReplyError,
    SaturatedError,
)
from softgrip_driver.rig.build import StreamSettings, make_line_gauge
from softgrip_driver.rig.gauge_calibration import (
    WeighedPoint,
    fit_calibration,
    read_calibration,
    write_calibration,
)
from softgrip_emulator.rig.amplifier import COUNTS_PER_NEWTON, HX711_NOISE_N
from softgrip_emulator.rig.polled import PROTOCOLS
from softgrip_emulator.rig.sketches import OFFSET_COUNTS, SKETCHES

G = 9.81
#: Sketch -> format that reads it, and counts per newton of what it shows: grams where people calibrate in grams.
READ_AS = {
    "bogde_basic": ("hx711", COUNTS_PER_NEWTON),
    "bogde_no_delay": ("hx711", COUNTS_PER_NEWTON),
    "bogde_retry": ("hx711", COUNTS_PER_NEWTON),
    "bogde_timeout": ("hx711", COUNTS_PER_NEWTON),
    "olkal_read": ("hx711_adc", 1e3 / G),
    "olkal_zero": ("hx711_adc", 1e3 / G),
    "tillaart_plotter": ("raw", 1e3 / G),
    "sparkfun": ("pounds", 1.0),
    "sparkfun_zero": ("pounds", 1.0),
    "sparkfun_calibration": ("pounds", 1.0),
}
#: sketches that say nothing in setup() and less than one line a second
SLOW_AND_SILENT = {"bogde_basic", "bogde_retry", "bogde_timeout"}
#: that say nothing, either
SILENT = {"tillaart_plotter", "bogde_no_delay"}


def gauge_at(folder: Path, line: str, counts: float = 1.0, **settings):
    return make_line_gauge(str(folder / "gauge"), StreamSettings(line=line, counts_per_newton=counts, **settings))


# -- boards ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "boot"), [(10.0, 1.6), (80.0, 1.6), (10.0, 0.5), (10.0, 3.0)])
@pytest.mark.parametrize("sketch", READ_AS)
def test_a_board_with_a_published_sketch_opens_and_weighs(tmp_path, make_rig, sketch, rate, boot):
    rig = make_rig(gauge=sketch)
    rig.gauge._rate_hz, rig.gauge._boot_s = rate, boot
    name, counts = READ_AS[sketch]
    gauge = gauge_at(tmp_path, name, counts)
    gauge.open()
    assert rig.gauge.resets == 1, "each opening would reset it again"
    gauge.tare()
    before = gauge.tension()
    rig.set(1.0, 0.6)
    # SparkFun's sketch shows tenths of a pound.
    step = 0.45 if name == "pounds" else 0.05
    assert before == pytest.approx(0.0, abs=step)
    assert gauge.tension() == pytest.approx(rig.plant.force * rig.truth.gauge_gain, abs=step)
    gauge.close()


def test_a_sketch_that_waits_for_seconds_is_refused_with_the_reason(tmp_path, make_rig):
    """bogde's full example: delay(5000) between two lines."""
    assert set(SKETCHES) - set(READ_AS) == {"bogde_full"}
    make_rig(gauge="bogde_full")
    with pytest.raises(DeviceRefusedError, match="take the delay out of the sketch"):
        gauge_at(tmp_path, "hx711_full").open()


def test_the_wrong_format_is_named_with_the_right_one(tmp_path, make_rig):
    make_rig(gauge="olkal_read")
    with pytest.raises(CorruptReplyError, match="set stream_line to hx711_adc"):
        gauge_at(tmp_path, "grams", baud=57600).open()


def test_lines_at_another_baud_rate_are_named(tmp_path, make_rig):
    make_rig(gauge="olkal_read")
    with pytest.raises(DriverError, match="baud rate"):
        gauge_at(tmp_path, "hx711_adc", baud=115200).open()


def test_a_cut_cell_at_the_end_of_its_converter_is_refused_at_once(tmp_path, make_rig):
    rig = make_rig(gauge="bogde_basic")
    rig.inject("saturated", capacity=1e-9)
    with pytest.raises(SaturatedError, match="check the cell's wires"):
        gauge_at(tmp_path, "hx711", COUNTS_PER_NEWTON).open()


def test_a_display_that_stands_still_at_rest_is_no_fault_and_raw_counts_that_do_are(tmp_path, make_rig):
    rig = make_rig(gauge="olkal_read")
    gauge = gauge_at(tmp_path, "hx711_adc", 1e3 / G)
    gauge.open()
    rig.inject("cell_stuck")
    with pytest.raises(CorruptReplyError, match="without any noise"):
        [gauge.tension() for _ in range(60)]
    gauge.close()
    coarse = make_rig(gauge="sparkfun")
    gauge = gauge_at(tmp_path, "pounds")
    gauge.open()
    assert {round(gauge.tension(), 6) for _ in range(60)} <= {0.0, -0.0}
    coarse.close()


def read_until(gauge, error, readings=400):
    """Read until something other than a missing line is raised."""
    for _ in range(readings):
        try:
            gauge.tension()
        except error:
            return
        except (NoReplyError, CorruptReplyError):
            continue
    pytest.fail(f"{readings} readings without a {error.__name__}")


@pytest.mark.parametrize("sketch", READ_AS)
@pytest.mark.parametrize("boot", [0.5, 1.6, 3.0])
def test_a_board_that_boots_while_it_is_read_says_so_once(tmp_path, make_rig, sketch, boot):
    rig = make_rig(gauge=sketch)
    rig.gauge._rate_hz = 80.0
    name, counts = READ_AS[sketch]
    gauge = gauge_at(tmp_path, name, counts)
    gauge.open()
    gauge.tension()
    rig.inject("board_reset", boot=boot)
    if sketch in SLOW_AND_SILENT or (sketch in SILENT and boot == 0.5):
        # It is silent for no longer than one line may be late: nothing is there to be seen.
        assert not (SKETCHES[sketch].tares and boot > 0.5)
        return
    read_until(gauge, GaugeRestartedError)
    # A banner of some lines is one start.
    for _ in range(4 * len(SKETCHES[sketch].setup) + 4):
        try:
            gauge.tension()
        except (CorruptReplyError, NoReplyError):
            continue
    assert [gauge.tension() for _ in range(5)]


def test_a_pause_in_which_nobody_asks_is_no_silence(tmp_path, make_rig, world):
    rig = make_rig(gauge="olkal_read")
    gauge = gauge_at(tmp_path, "hx711_adc", 1e3 / G)
    gauge.open()
    rig.inject("gauge_silent")
    with pytest.raises(NoReplyError):
        gauge.tension()
    rig.clear()
    world.clock.advance(world.now() + 30.0)
    assert gauge.tension() == pytest.approx(0.0, abs=0.1)


# -- gauges that are asked ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_gauge_that_answers_a_command_weighs(tmp_path, make_rig, protocol):
    rig = make_rig(gauge=protocol)
    gauge = gauge_at(tmp_path, protocol, 1.0)
    gauge.open()
    gauge.tare()
    rig.set(1.0, 0.6)
    assert gauge.tension() == pytest.approx(rig.plant.force * rig.truth.gauge_gain, abs=0.08)
    rig.inject("gauge_silent")
    with pytest.raises(DriverError, match="expected a line"):
        gauge.tension()
    rig.clear()
    assert gauge.tension() > 1.0
    gauge.close()


def test_a_poll_command_of_ones_own(tmp_path, make_rig):
    make_rig(gauge="mt_sics")
    pattern = r"S [SD]\s+(?P<value>-?\d+\.\d+) (?P<unit>g)"
    with pytest.raises(DriverError):
        gauge_at(tmp_path, pattern, baud=9600).open()
    with pytest.raises(ConfigurationError, match="stream_request"):
        gauge_at(tmp_path, "raw", request="\\x")


# -- known weights -----------------------------------------------------------------------------------------------------


def test_known_weights_give_counts_offset_and_deviation_and_the_driver_reads_them(tmp_path, make_rig):
    rig = make_rig(gauge="bogde_basic")
    gauge = gauge_at(tmp_path, "hx711")
    gauge.open()
    masses = [0.0, 0.2, 0.5, 1.0, 0.0]
    hung = iter(masses)

    def hang(_):
        # Past the surface, over a pulley without friction: a weight on the cell.
        rig.plant.force = next(hung) * G

    found = fit_calibration(weigh(gauge, masses, 10, hang), "hx711", 0)
    gauge.close()
    true = COUNTS_PER_NEWTON * rig.truth.gauge_gain
    assert found.counts_per_newton == pytest.approx(true, abs=4.0 * found.counts_per_newton_stddev)
    assert found.counts_per_newton_stddev < 0.01 * true
    assert found.offset_counts == pytest.approx(OFFSET_COUNTS, abs=0.05 * COUNTS_PER_NEWTON)
    assert found.stddev_n == pytest.approx(HX711_NOISE_N, rel=0.5)
    write_calibration(tmp_path / "cell.yaml", found)
    assert read_calibration(tmp_path / "cell.yaml") == found
    calibrated = gauge_at(tmp_path, "hx711", calibration=str(tmp_path / "cell.yaml"))
    calibrated.open()
    rig.plant.force = 0.7 * G
    assert calibrated.tension() == pytest.approx(0.7 * G, abs=0.1)
    calibrated.close()
    with pytest.raises(ConfigurationError, match="calibrate the cell again"):
        gauge_at(tmp_path, "grams", calibration=str(tmp_path / "cell.yaml"))


def weighed(*counts: float, noise: float = 1.0) -> list[WeighedPoint]:
    forces = (0.0, 2.0, 5.0, 10.0, 0.0)
    return [WeighedPoint(force, value, noise, 20) for force, value in zip(forces, counts, strict=True)]


def test_a_reversed_cell_gets_a_negative_scale():
    found = fit_calibration(weighed(7.0, -193.0, -493.0, -993.0, 7.0), "raw", 0)
    assert (found.counts_per_newton, found.offset_counts) == (pytest.approx(-100.0), pytest.approx(7.0))
    assert (found.linearity, found.drift_n) == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9))


def test_linearity_and_drift_are_those_of_the_readings():
    # One weight 10 counts beside a line of 100 counts a newton, the last zero 20 counts higher than the first.
    bent = fit_calibration(weighed(0.0, 200.0, 510.0, 1000.0, 0.0), "raw", 0)
    assert bent.linearity == pytest.approx(7.0 / 1000.0, rel=0.3)
    drifted = fit_calibration(weighed(0.0, 200.0, 500.0, 1000.0, 20.0), "raw", 0)
    assert drifted.drift_n == pytest.approx(0.2, rel=0.02)


def test_a_cut_cell_has_no_scale():
    with pytest.raises(ConfigurationError, match="four wires"):
        fit_calibration(weighed(3.0, -4.0, 5.0, 1.0, -2.0, noise=4.0), "raw", 0)
    with pytest.raises(ConfigurationError, match="at least one weight"):
        fit_calibration(weighed(3.0, -4.0, 5.0, 1.0, -2.0)[:2], "raw", 0)


@pytest.mark.parametrize("text", ["", "schema: 2", "schema: 1\ncounts_per_newton: much", "a: [", "- 1"])
def test_a_calibration_that_is_none_is_refused_with_its_path(tmp_path, text):
    (tmp_path / "cell.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match=r"cell\.yaml: expected a file of calibrate_cell"):
        read_calibration(tmp_path / "cell.yaml")
    with pytest.raises(ConfigurationError, match="missing"):
        read_calibration(tmp_path / "missing.yaml")
