# SPDX-License-Identifier: Apache-2.0
"""The shipped catalogue against thesis Tables 4.1 and 4.2, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from softgrip_cell.catalogue_file import SHIPPED, catalogue_text, read_catalogue
from softgrip_cell.errors import CatalogueError
from softgrip_cell.finger_records import read_finger_records

# Typed from the thesis, independently of the shipped file: product -> (Table 4.1, Table 4.2 power/pinch/hook).
# + success, o partial success, - failure.
THESIS = {
    "egg": ("power", "++-"),
    "orange": ("power", "++-"),
    "muffin": ("power", "++-"),
    "apple": ("power", "++-"),
    "sausage": ("power", "+++"),
    "banana": ("power", "++-"),
    "baloney": ("power", "+--"),
    "grape": ("pinch", "-+-"),
    "cheese_slice": ("pinch", "o+o"),
    "cheese_cake": ("pinch", "++-"),
    "cracker_sheet": ("pinch", "++-"),
    "frozen_pizza": ("pinch", "-o-"),
    "bag_of_chips": ("pinch", "++-"),
    "tomato_vine": ("hook", "+++"),
    "grape_vine": ("hook", "+++"),
}
SIGNS = {"+": "success", "o": "partial", "-": "failure"}


def test_products_are_those_of_the_thesis() -> None:
    catalogue = read_catalogue()
    assert set(catalogue.products) == set(THESIS)
    for name, (grasp, marks) in THESIS.items():
        product = catalogue.products[name]
        assert product.grasp.value == grasp
        found = [product.marks[finger_set].value for finger_set in ("power", "pinch", "hook")]
        assert found == [SIGNS[sign] for sign in marks], name


@pytest.mark.parametrize(("finger_set", "percent"), [("power", 80), ("pinch", 87), ("hook", 20)])
def test_success_rates_are_the_last_row_of_table_4_2(finger_set: str, percent: int) -> None:
    assert round(100 * read_catalogue().success_rate(finger_set)) == percent


def test_weights_and_openings_lie_where_the_thesis_says() -> None:
    products = read_catalogue().products.values()
    assert min(product.mass_kg for product in products) == pytest.approx(0.005)
    assert read_catalogue().products["frozen_pizza"].mass_kg == pytest.approx(0.695)
    assert read_catalogue().products["baloney"].size_m[2] == pytest.approx(0.070)
    assert all(0.010 <= product.size_m[2] <= 0.100 for product in products)


def test_export_reads_back_to_the_same_values(tmp_path: Path) -> None:
    path = tmp_path / "out.yaml"
    path.write_text(catalogue_text(read_catalogue()))
    assert read_catalogue(path) == read_catalogue()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.update(schema=2), "expected schema 1, found 2"),
        (lambda d: d.update(kind="finger"), "expected kind 'softgrip_catalogue'"),
        (lambda d: d.update(extra=1), "unknown field extra"),
        (lambda d: d["products"]["egg"].update(mass_kg=-1.0), r"egg\.mass_kg: expected 0.0005\.\.5 kg, found -1"),
        (lambda d: d["products"]["egg"].update(mass_kg=float("nan")), "expected a number"),
        (lambda d: d["products"]["egg"].update(mass_kg=True), "expected a number"),
        (lambda d: d["products"]["egg"].update(mass_kg=10**400), "expected a number"),
        (lambda d: d["products"]["egg"].update(grasp="claw"), "expected one of power, pinch, hook"),
        (lambda d: d["products"]["egg"].update(size_m=[0.01, 0.02, 0.03]), "length >= width >= height"),
        (lambda d: d["products"]["egg"].update(size_m=[0.01]), r"expected \[length, width, height\]"),
        (lambda d: d["products"]["egg"]["recipe"].pop("force_limit_n"), "field 'force_limit_n' is missing"),
        (lambda d: d["products"]["egg"]["recipe"].update(pull_limit_m=20), r"expected 0.001\.\.0.06 m, found 20"),
        (lambda d: d["products"]["egg"]["marks"].update(claw="success"), "expected finger sets"),
        (lambda d: d["products"].update({7: {}}), "expected names as keys, found 7"),
        (lambda d: d.update(products=[]), "expected a mapping"),
        (lambda d: d.update(finger_sets={}), "at least one finger set"),
    ],
)
def test_wrong_catalogues_are_refused_with_the_place(change, expected: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]  # one-line edits
    document = yaml.safe_load(SHIPPED.read_text())
    change(document)
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(CatalogueError, match=expected):
        read_catalogue(path)


@pytest.mark.parametrize("content", [b"", b"products: [", b"\xff\xfe\x00", b"- 1\n", b"7"])
def test_what_is_no_catalogue_at_all_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "noise.yaml"
    path.write_bytes(content)
    with pytest.raises(CatalogueError, match=r"noise\.yaml"):
        read_catalogue(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match=r"absent\.yaml: cannot be read"):
        read_catalogue(tmp_path / "absent.yaml")


def test_shipped_passports_fill_every_slot_of_every_set_twice() -> None:
    finger_records = read_finger_records().values()
    for finger_set in read_catalogue().finger_sets.values():
        for finger in ("index", "middle", "thumb"):
            found = [p for p in finger_records if p.profile == finger_set.profile and p.finger == finger]
            assert len(found) == 2
            assert all(finger_record.objection() is None for finger_record in found)
