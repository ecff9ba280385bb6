# SPDX-License-Identifier: Apache-2.0
"""CSV in, YAML out and back, the store, the command: good files, and every bad one refused with its row and reason."""

import hashlib
import json
import math

import numpy as np
import pytest
import yaml

from softgrip_model.commands import fit_friction
from softgrip_model.friction.calibration import SurfacePair, calibrate
from softgrip_model.friction.csv_file import read_csv
from softgrip_model.friction.errors import DataError, ModelFileError
from softgrip_model.friction.laws import GRAVITY, Law
from softgrip_model.friction.measurements import check_enough, measurements
from softgrip_model.friction.model_file import read_model, write_model
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.store import ModelStore

LAW = published("twine-tpu").law
PAIR = SurfacePair("PP twine", "TPU", 0.75e-3, 3e-3)


def rows(noise=0.01, angles=(10, 50, 90), loads=(200, 600, 1000)):
    rng = np.random.default_rng(0)
    for angle in angles:
        for load in loads:
            low = load * 1e-3 * GRAVITY
            high = low * float(LAW.ratio(np.radians(angle), low)) * math.exp(noise * rng.standard_normal())
            yield angle, load, round(high, 4)


def text(header="angle [deg],load [g],T1 [N]", lines=None):
    return "\n".join([header, *(",".join(map(str, row)) for row in (lines if lines is not None else rows()))]) + "\n"


@pytest.fixture
def csv_of(tmp_path):
    def make(content):
        path = tmp_path / "data.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return make


# -- good files --------------------------------------------------------------------------------------------------------


def test_columns_are_found_by_name_unit_and_in_any_order(csv_of):
    expected = read_csv(csv_of(text()))
    assert len(expected) == 9
    angle, low, high = expected.angle, expected.tension_low, expected.tension_high
    assert low[0] == pytest.approx(1.962)
    variants = [
        text(
            "T1 [N],remark,load [kg],angle (rad)",
            [(h, "x", t / GRAVITY, a) for a, t, h in zip(angle, low, high, strict=True)],
        ),
        text("theta_deg,T2_N,ratio", [(np.degrees(a), t, h / t) for a, t, h in zip(angle, low, high, strict=True)]),
        text(
            "wrap angle [°],T2 [mN],Rf",
            [(np.degrees(a), 1e3 * t, h / t) for a, t, h in zip(angle, low, high, strict=True)],
        ),
        "# comment\n\n" + text().replace(".", ",").replace(",", ";", 0),
    ]
    for content in variants[:3]:
        found = read_csv(csv_of(content))
        assert found.angle == pytest.approx(angle)
        assert found.tension_low == pytest.approx(low)
        assert found.tension_high == pytest.approx(high)


def test_semicolons_with_decimal_commas_bom_comments_and_crlf(csv_of):
    lines = [";".join(str(v).replace(".", ",") for v in row) for row in rows()]
    content = "\r\n".join(["# made by hand", "angle [deg];load [g];T1 [N]", *lines, ""])
    found = read_csv(csv_of(b"\xef\xbb\xbf" + content.encode()))
    assert found.tension_high == pytest.approx(read_csv(csv_of(text())).tension_high)
    assert found.labels[0] == "row 3"


def test_the_source_is_kept_with_its_hash(csv_of):
    path = csv_of(text())
    found = read_csv(path)
    assert found.source == "data.csv"
    assert found.source_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


# -- bad files ---------------------------------------------------------------------------------------------------------


def spoiled(index, row):
    lines = list(rows())
    lines[index] = row
    return text(lines=lines)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "empty file"),
        (text("angle [deg],load [g],force"), "missing: T1 or ratio"),
        (text("x,load [g],T1 [N]"), "missing: angle"),
        (text("angle [deg],x,T1 [N]"), "missing: load or T2"),
        (text("angle [deg],load [lb],T1 [N]"), "units g, kg"),
        (text("angle [deg],load [g],T1 [g]"), "units n, mn, kn, found 'g'"),
        (text("angle,load [g],T1 [N]"), "units deg"),
        (text("angle [deg],angle [rad],load [g],T1 [N]"), "expected one column for angle"),
        (text("angle [deg],load [g],T2 [N],T1 [N]"), "found both"),
        (
            text("angle [deg],T2 [N],T1 [N]", [(a, g, h * 1e3 / GRAVITY) for a, g, h in rows()]),
            "found a median of 600 N",
        ),
        (spoiled(2, (10, 1000, "abc")), "row 4.*'abc'"),
        (spoiled(2, (10, 1000, "11.2 N")), "row 4.*units stand in the header"),
        (spoiled(2, (10, 1000)), "row 4.*only 2 cells"),
        (spoiled(2, (10, 1000, "nan")), "row 4.*expected numbers"),
        (spoiled(2, (10, 1000, "")), "row 4.*found ''"),
        (spoiled(2, (10, 1000, -11.2)), "row 4.*above 0 N"),
        (spoiled(2, (10, -1000, 11.2)), "row 4.*above 0 N"),
        (spoiled(2, (-10, 1000, 11.2)), "row 4.*0 .. 360 deg"),
        (spoiled(2, (700, 1000, 11.2)), "row 4.*0 .. 360 deg"),
        (spoiled(2, (10, 1000, 8.0)), "row 4.*T1 >= T2"),
        (spoiled(2, (10, 1000, 1140)), "row 4.*same unit"),
        (spoiled(2, (10, 1, 0.011)), "row 4.*one unit"),
        (text("angle [deg],load [g],T1 [N]", [(a / 57.3, g, h) for a, g, h in rows()]), "looks like radians"),
        (b"\xff\xfe\x00a", "UTF-8"),
    ],
)
def test_bad_files_are_refused_with_row_and_reason(csv_of, content, reason):
    with pytest.raises(DataError, match=reason):
        read_csv(csv_of(content))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        read_csv(tmp_path / "none.csv")


def test_copies_count_once_and_small_negative_friction_is_kept_with_a_warning(csv_of):
    lines = list(rows())
    found = read_csv(csv_of(text(lines=[*lines, lines[3]])))
    assert len(found) == 9
    assert found.warnings == ("row 11: equal to row 5 in every value; a copy is no measurement: counted once",)
    found = read_csv(csv_of(text(lines=[*lines, (5, 1000, 9.7)])))
    assert len(found) == 10
    assert "row 11" in found.warnings[0]
    assert "below T2" in found.warnings[0]


@pytest.mark.parametrize(
    ("lines", "law", "reason"),
    [
        (list(rows())[:3], Law.MATTE, "at least 4 points"),
        (list(rows(angles=(50,), loads=(200, 400, 600, 800, 1000))), Law.MATTE, "at least two angles, found 50 deg"),
        (list(rows(angles=(10, 30, 50, 70), loads=(200,))), Law.MATTE, "at least two loads"),
        (list(rows(angles=(10, 30, 50, 70), loads=(200,))), Law.HEAP, "at least two loads"),
    ],
)
def test_points_that_carry_no_fit_are_refused(csv_of, lines, law, reason):
    with pytest.raises(DataError, match=reason):
        check_enough(read_csv(csv_of(text(lines=lines))), law)


def test_one_load_is_enough_for_capstan(csv_of):
    points = read_csv(csv_of(text(lines=list(rows(angles=(10, 30, 50, 70), loads=(200,))))))
    check_enough(points, Law.CAPSTAN)


def test_columns_of_different_length_are_refused():
    with pytest.raises(DataError, match="equal length"):
        measurements([1, 2], [1], [1, 2])


# -- models ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def model(csv_of):
    return calibrate(read_csv(csv_of(text())), PAIR).model


def test_a_model_survives_its_file(tmp_path, model):
    path = tmp_path / f"{model.id}.yaml"
    write_model(model, path)
    again = read_model(path)
    assert again.law == model.law
    assert again.covariance == pytest.approx(model.covariance)
    for name in ("id", "points", "cable", "surface", "source", "source_sha256", "fitted_at", "verdict", "reason"):
        assert getattr(again, name) == getattr(model, name)
    assert not list(tmp_path.glob(".*"))
    assert model.id.startswith("pp-twine-tpu-matte-")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"schema": 2}, "expected schema 1, found 2"),
        ({"law": "amontons"}, "law: expected one of capstan, heap, matte"),
        ({"coefficients": {"alpha": 0.3}}, "coefficients: expected alpha, n"),
        ({"coefficients": {"alpha": 0.3, "n": 1.2, "epsilon": 0.1, "lambda": 0.0}}, "0 < n < 1"),
        ({"coefficients": {"alpha": "x", "n": 0.5, "epsilon": 0.1, "lambda": 0.0}}, "coefficients.alpha"),
        ({"covariance": [[1, 2], [3, 4]]}, "4 x 4"),
        ({"angle_range_rad": [2, 1]}, "low < high"),
        ({"cable_radius_m": None}, "cable_radius_m"),
        ({"cable_radius_m": 10**400}, "cable_radius_m: expected a finite number"),
        ({"fitted_at": "yesterday"}, "fitted_at"),
        ({"id": "../evil"}, "id:"),
        ({"verdict": "fine"}, "verdict"),
    ],
)
def test_damaged_model_files_are_refused(tmp_path, model, change, reason):
    path = tmp_path / "m.yaml"
    write_model(model, path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(ModelFileError, match=reason):
        read_model(path)


def test_no_yaml_no_mapping_no_file(tmp_path):
    path = tmp_path / "m.yaml"
    with pytest.raises(ModelFileError, match="available: none"):
        read_model(path)
    for content in ("[1", "- 1"):
        path.write_text(content)
        with pytest.raises(ModelFileError, match="expected a"):
            read_model(path)


def test_the_store_keeps_models_and_the_choice(tmp_path, model):
    store = ModelStore(tmp_path / "models")
    assert store.ids() == published_ids()
    assert store.active == ""
    store.add(model)
    with pytest.raises(ModelFileError, match="taken"):
        store.add(model)
    assert store.activate(model.id).law == model.law
    again = ModelStore(tmp_path / "models")
    assert again.active == model.id
    assert again.ids()[0] == model.id
    with pytest.raises(ModelFileError, match="available"):
        again.activate("nothing")
    (tmp_path / "models" / "broken.yaml").write_text("schema: 9")
    models, problems = again.readable()
    assert len(models) == len(published_ids()) + 1
    assert "broken" in problems[0]


@pytest.mark.parametrize("name", ["{}/../stolen", "../stolen", "{parent}/stolen", "", ".", "..", "a\0b", "stolen\n"])
def test_an_id_that_is_a_path_reaches_no_file_although_one_is_there(tmp_path, model, name):
    store = ModelStore(tmp_path / "models")
    store.add(model)
    (tmp_path / "models" / model.id).mkdir()
    whole = (tmp_path / "models" / f"{model.id}.yaml").read_text()
    for place in (tmp_path, tmp_path / "models"):
        (place / "stolen.yaml").write_text(whole.replace(model.id, "stolen"))
    bad = name.format(model.id, parent=tmp_path)
    for ask in (store.get, store.activate):
        with pytest.raises(ModelFileError, match="no friction model"):
            ask(bad)
    assert store.active == ""


@pytest.mark.parametrize("content", ["", "\n", "../stolen\n", "a b", "\0"])
def test_a_damaged_choice_is_an_error_and_not_the_shipped_model(tmp_path, content):
    (tmp_path / "active").write_text(content)
    with pytest.raises(ModelFileError, match="expected the id of the active friction model") as error:
        _ = ModelStore(tmp_path).active
    assert published_ids()[0] in str(error.value)  # what to write into it


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_fits_writes_and_prints(csv_of, tmp_path, capsys):
    full = list(rows(0.01, range(10, 91, 10), (200, 400, 600, 800, 1000)))
    path = csv_of(text(lines=full))
    out = tmp_path / "fits"
    code = fit_friction.main([str(path), "--points", "9", "--out", str(out), "--cable-radius", "0.75", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert code == 1  # capstan does not fit these points
    assert set(printed["models"]) == {"capstan", "heap", "matte"}
    assert printed["models"]["matte"]["verdict"] == "usable"
    assert printed["models"]["capstan"]["verdict"] == "do_not_use"
    assert printed["models"]["matte"]["points"] == 9
    assert printed["models"]["matte"]["on_all_points"]["average_error"] < 0.03
    written = read_model(out / "matte.yaml")
    assert written.law.by_name["alpha"] == pytest.approx(printed["models"]["matte"]["coefficients"]["alpha"])
    for figure in ("fit.png", "residuals.png"):
        assert (out / figure).read_bytes().startswith(b"\x89PNG")


def test_the_command_prints_a_table(csv_of, capsys):
    assert fit_friction.main([str(csv_of(text())), "--model", "matte", "--cable-radius", "0.75"]) == 0
    printed = capsys.readouterr().out
    assert "matte" in printed
    assert "usable" in printed


def test_the_command_refuses_bad_files(csv_of, tmp_path, capsys):
    assert fit_friction.main([str(csv_of(spoiled(2, (10, 1000, 8.0))))]) == 2
    assert "row 4" in capsys.readouterr().err
    assert fit_friction.main([str(tmp_path / "none.csv")]) == 2
    with pytest.raises(SystemExit):
        fit_friction.main(["--help"])
    assert "exit code" in capsys.readouterr().out
