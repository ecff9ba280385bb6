# SPDX-License-Identifier: Apache-2.0
"""Files and databases of release 0.1.0, whose fields had other names, are read (docs/glossary.md, Former names)."""

from __future__ import annotations

from pathlib import Path

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.grasp.reference import FreeReference

#: A row of the database's references, as release 0.1.0 wrote it.
REFERENCE = {
    "pulled_m": [0.003, 0.004, 0.0055],
    "offset_n": [0.1, -0.2, 0.3],
    "tension_n": [2.0, 3.0, 5.0],
    "stddev_n": 0.05,
    "friction_model": "braid-tpu",
}
CATALOGUE = """
schema: 1
kind: softgrip_catalogue
finger_sets:
  power: {grasp: power, profile: power}
products:
  egg:
    {name: Egg, grasp: power, shape: ball, size_m: [0.057, 0.044, 0.044], mass_kg: 0.060, surface: smooth,
     fragility: fragile,
     recipe: {hold_excess_n: 14.0, force_limit_n: 8.0, pull_limit_m: 0.020, closing_speed_m_per_s: 0.010},
     own_recipes: {power: {hold_excess_n: 7.0}},
     marks: {power: success}}
"""
FINGERS = """
schema: 1
kind: softgrip_passports
fingers:
  PW-I-01: {profile: power, finger: index, printed: 2026-11-02, material: NinjaFlex TPU 85A, cable: PE braid 0.25 mm}
"""


def test_the_reference_of_a_finger() -> None:
    found = FreeReference.from_document(REFERENCE)
    assert found.pulled_length_m == (0.003, 0.004, 0.0055)
    assert found.reach_m == 0.0055
    assert found.friction_digest == "", "it had none: the next swap checks the finger again"
    assert "pulled_m" not in found.document(), "it is written under its present name"


def test_a_product_file(tmp_path: Path) -> None:
    file = tmp_path / "products.yaml"
    file.write_text(CATALOGUE)
    egg = read_catalogue(file).products["egg"]
    assert egg.recipe.hold_contact_tension_n == 14.0
    assert egg.recipe_for("power").hold_contact_tension_n == 7.0


def test_a_finger_file(tmp_path: Path) -> None:
    file = tmp_path / "fingers.yaml"
    file.write_text(FINGERS)
    assert set(read_finger_records(file)) == {"PW-I-01"}
