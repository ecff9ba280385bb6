# SPDX-License-Identifier: Apache-2.0
"""Lines as makers document them: manuals of gauges and scales, sketches and firmware of boards. Each names its source.

Where a page runs spaces together, they stand as its table of positions has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError, SaturatedError
from softgrip_driver.rig.line_format import FORMATS, formats_of, line_format
from softgrip_emulator.rig.polled import PROTOCOLS

G, POUND_N = 9.81, 4.4482216
#: what the DI-100U shows is in the unit that it was set to: newtons, here
COUNTS, MILLIPOUND_N = 1.0, POUND_N / 1e3


@dataclass(frozen=True)
class Documented:
    """A line of a gauge.

    Attributes:
        gauge, source: who makes it, and where the line stands.
        format: name of the format that reads it.
        line: as documented.
        newtons: that it means.
        newtons_per_count: of a format without unit.
    """

    gauge: str
    source: str
    format: str
    line: bytes
    newtons: float
    newtons_per_count: float = 1.0


GAUGES = [
    # force gauges
    Documented("Sauter FH", "FH-BA-e-2020 p. 13", "sauter", b"0011.70", -11.70),
    Documented("Sauter FL", "FL-BA-e-2020 p. 14", "sauter", b"1021.15", 21.15),
    Documented("Andilog Centor Touch", "manual V6.10 p. 22: a sign or none, TAB, displacement", "andilog",
               b"-12.34\t5.000", -12.34),
    Documented("Mark-10 Series 4", "user's guide p. 16", "value_unit", b"-18.78 lbF", -18.78 * POUND_N),
    Documented("Wagner Force Ten FDX", "manual p. 20", "value_unit", b"- 23.02 lbf", -23.02 * POUND_N),
    Documented("Imada DST-44A", "sktometometo/imada_forcegauge: +XX.XXKTO", "imada", b"+12.34KTO", 12.34 * G),
    # indicators and load cell interfaces
    Documented("tecsis EZE30", "manual p. 22", "tecsis", b"N 00000", 0.0),
    Documented("tecsis EZE30, scaled", "manual, Annex A", "tecsis", b"N+01.100", 1.1),
    Documented("Loadstar iLoad", "command set: 2345 is 2.345 lb", "raw", b"2345", 2345 * MILLIPOUND_N, MILLIPOUND_N),
    Documented("Loadstar DI-100U", "command set: W", "raw", b"-0.000456", -0.000456, COUNTS),
    Documented("Dini Argeo LTP", "TECH_MAN_ENG_LTP p. 43", "scale", b"01ST,GS,     0.0,kg", 0.0),
    Documented("Dini Argeo DGT4X", "TECH_MAN_ENG_DGT4X p. 52", "scale", b"ST,GS,     0.0,kg", 0.0),
    Documented("Selleton SL-7515", "manual p. 14", "scale", b"ST, GS+ 5.12KG", 5.12 * G),
    Documented("Radwag PUE C/31", "manual p. 58", "radwag", b"SI ?       18.5 kg", 18.5 * G),
    Documented("Radwag MA X2.IC.A", "manual p. 107", "radwag", b"SUI? -   58.237 kg", -58.237 * G),
    # scales and balances
    Documented("Mettler-Toledo Excellence", "11780711 p. 87: command S", "mt_sics", b"S S     100.00 g", 0.1 * G),
    Documented("A&D EK-L", "manual p. 28", "scale", b"ST,+001234.5  g", 1.2345 * G),
    Documented("KERN KFN-TM", "KFB/KFN-TM-BA_IA-e-1323 p. 49", "scale", b"ST,GS      1.000KG", 1.0 * G),
    Documented("KERN SFB", "SFB-BA-e-1324 p. 51", "scale", b"US,GS      1.342KG", 1.342 * G),
    Documented("Excell H3", "manual p. 65", "scale", b"US,GS,+0123.456  lb", 123.456 * POUND_N),
    Documented("Salter Brecknell S122", "service instructions p. 54", "scale", b"ST,NT,+  0.876kg", 0.876 * G),
    Documented("Ohaus Scout Pro", "RS232 interface p. EN-3", "value_unit", b"       0.01 g ?", 1e-5 * G),
    Documented("Ohaus 401", "RS232 interface p. EN-3", "value_unit", b"       0.211 kg ?", 0.211 * G),
    Documented("Sartorius GC803S", "manual p. 57", "value_unit", b"+   123.56 g  ", 0.12356 * G),
    Documented("Sartorius FB", "manual p. 66", "value_unit", b"+   1255.7 g  ", 1.2557 * G),
    Documented("Adam CPWplus", "manual p. 14", "value_unit", b"G  +  2.00 kg", 2.0 * G),
    Documented("Adam Highland", "manual p. 29", "value_unit", b"GROSS   123.45 g ", 0.12345 * G),
    # boards: what their sketches print
    Documented("HX711, bogde basic", "bogde/HX711 be5e3d2", "hx711", b"HX711 reading: -137240", -137240.0),
    Documented("HX711, bogde full", "bogde/HX711 be5e3d2", "hx711_full", b"one reading:\t0.3\t| average:\t0.2", 0.3),
    Documented("HX711_ADC", "olkal/HX711_ADC 7762bc4", "hx711_adc", b"Load_cell output val: -0.02", -0.02),
    Documented("HX711, SparkFun", "sparkfun/HX711-Load-Cell-Amplifier 38228f8", "pounds", b"Reading: -0.1 lbs",
               -0.1 * POUND_N),
    Documented("HX711, SparkFun calibration", "sparkfun/HX711-Load-Cell-Amplifier 38228f8", "pounds",
               b"Reading: 4.5 lbs calibration_factor: -7050.00", 4.5 * POUND_N),
    Documented("HX711, RobTillaart plotter", "RobTillaart/HX711 fac13f0", "raw", b"12.34", 12.34),
    Documented("SparkFun Serial Load Cell Converter", "sparkfun/OpenScale 7e9c801, calcMinimumReadTime", "openscale",
               b"51588595,178.899,lbs", 178.899 * POUND_N),
]  # fmt: skip


@pytest.mark.parametrize("one", GAUGES, ids=lambda one: one.gauge)
def test_a_documented_line_is_read(one):
    assert line_format(one.format).parse(one.line) * one.newtons_per_count == pytest.approx(one.newtons)
    assert one.format in formats_of(one.line), "the message for a wrong format names the right one"


def test_they_are_as_many_as_the_documents_say():
    assert len({one.gauge for one in GAUGES}) == len(GAUGES) == 34


def test_every_format_has_a_documented_line_or_is_a_plain_number_with_its_unit():
    assert FORMATS.keys() - {one.format for one in GAUGES} == {"time_raw", "grams", "newtons"}
    asked = {name for name, one in FORMATS.items() if one.request}
    assert asked == PROTOCOLS.keys()  # each is emulated, and weighs (test_gauges.py)


@pytest.mark.parametrize(
    ("name", "line", "error"),
    [
        ("mt_sics", b"S +", SaturatedError),
        ("mt_sics", b"S -", SaturatedError),
        ("mt_sics", b"S I", DeviceRefusedError),
        ("mt_sics", b"ES", CorruptReplyError),
        ("andilog", b"?", DeviceRefusedError),
        ("andilog", b"!", DeviceRefusedError),
        ("tecsis", b"ERR", DeviceRefusedError),
        ("imada", b"+99.99NTE", SaturatedError),
        ("sauter", b"2021.15", CorruptReplyError),
        ("sauter", b"1021.1", CorruptReplyError),
        ("hx711", b"HX711 not found.", CorruptReplyError),
        ("raw", b"8388607", SaturatedError),
        ("hx711", b"HX711 reading: -8388608", SaturatedError),
        ("scale", b"OL,+999999.9  g", SaturatedError),  # A&D EK-L p. 28
        ("scale", b"OL,GS,+            ", SaturatedError),  # Excell H3 p. 65
        ("radwag", b"SI I", DeviceRefusedError),  # Radwag PUE C/31 p. 58
        ("radwag", b"SI ^", SaturatedError),
        ("scale", b"QT,+00012345 PC", CorruptReplyError),  # A&D EK-L p. 28: pieces
        ("value_unit", b"         253 pcs", CorruptReplyError),  # Sartorius WZA p. 24
        ("value_unit", b"Stat     Err  54", CorruptReplyError),  # Sartorius FB p. 66
    ],
)
def test_documented_refusals_are_no_numbers(name, line, error):
    with pytest.raises(error):
        line_format(name).parse(line)
