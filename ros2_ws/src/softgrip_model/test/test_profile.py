# SPDX-License-Identifier: Apache-2.0
"""Profiles: the shipped ones are the published ones; bad ones are refused with the reason."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import pytest
import yaml

from softgrip_model import profile
from softgrip_model.digest import text_digest
from softgrip_model.finger import Finger
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.profile import PathPoint, Profile, ProfileError

SHIPPED = Path(__file__).resolve().parents[2] / "softgrip_bringup" / "profiles"

# Fig 4.4 and Fig 4.1, in mm
FIG_4_4 = {
    "power": ((2.55, 3.18, 3.36), (5.38, 5.74, 7.58, 7.91, 11.58, 11.81)),
    "hook": ((5.00, 2.76, 3.63), (5.13, 5.15, 7.85, 8.21, 11.69, 11.93)),
    "pinch": ((2.50, 4.27, 4.45), (12.22, 12.99, 5.01, 6.59, 5.59, 5.83)),
}
LINKS = {"index": (45, 27, 23), "middle": (50, 30, 25), "thumb": (40, 30)}


@pytest.fixture
def power() -> Profile:
    return profile.load(SHIPPED / "power.yaml")


@pytest.mark.parametrize("grasp", FIG_4_4)
def test_shipped_profiles_are_the_published_designs(grasp: str) -> None:
    shipped = profile.load_directory(SHIPPED)[grasp]
    thickness, routing = FIG_4_4[grasp]
    assert shipped.slots == ("index", "middle", "thumb")
    for slot, links in LINKS.items():
        design = shipped.finger(slot)
        n = len(links)
        assert design.link_lengths_m == pytest.approx([length / 1e3 for length in links])
        assert design.thicknesses_m == pytest.approx([h / 1e3 for h in thickness[:n]])
        assert design.routing_radii_m == pytest.approx([r / 1e3 for r in routing[: 2 * n]])
        assert design.width_m == 0.015
        finger = Finger.from_profile(shipped, slot)
        assert finger.routing_mm == pytest.approx(routing[: 2 * n])
        assert finger.strip.modulus_mpa == pytest.approx((110.08, -89.33, 21.89))
    assert shipped.finger("thumb").base_length_m == 0.060
    law = assumed_friction(shipped).law
    assert law.coefficients == (0.27049, 0.82038, 0.06483, 0.00851)
    assert law.radius_mm == pytest.approx(3.125)


def test_writing_and_reading_is_the_identity(power: Profile, tmp_path: Path) -> None:
    point = PathPoint(0.01, (0.5, 0.3, 0.25), 7.1)
    slots = dict(power.fingers)
    slots["index"] = dataclasses.replace(slots["index"], calibrated_path=(point,))
    calibrated = dataclasses.replace(power, fingers=tuple(slots.items()))
    profile.save(calibrated, tmp_path / "power.yaml")
    assert profile.load(tmp_path / "power.yaml") == calibrated
    assert profile.digest(calibrated) != profile.digest(power)
    assert profile.digest(profile.loads(profile.dumps(power))) == profile.digest(power)


def test_the_radius_of_the_holes_may_be_stated(power: Profile) -> None:
    assert power.cable.hole_radius_m is None
    stated = dataclasses.replace(power, cable=dataclasses.replace(power.cable, hole_radius_m=0.0006))
    assert profile.loads(profile.dumps(stated)) == stated
    assert profile.digest(stated) != profile.digest(power)
    # a profile from before the key existed reads as one that does not state it, with the digest that it had
    data = yaml.safe_load(profile.dumps(power))
    del data["cable"]["hole_radius_m"]
    assert profile.loads(yaml.safe_dump(data)) == power
    values = dataclasses.asdict(power)
    del values["cable"]["hole_radius_m"]
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    assert profile.digest(power) == hashlib.sha256(text.encode()).hexdigest()[:16]
    with pytest.raises(ProfileError, match=r"hole_radius_m: expected at least the cable's radius"):
        profile.validate(dataclasses.replace(power, cable=dataclasses.replace(power.cable, hole_radius_m=0.0001)))


def changed(power: Profile, path: str, value: object) -> str:
    data = yaml.safe_load(profile.dumps(power))
    *way, last = path.split(".")
    at = data
    for key in way:
        at = at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return yaml.safe_dump(data)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("schema", 2, "reads schema 1, found 2"),
        ("title", None, r"missing keys \['title'\]"),
        ("colour", "red", r"unknown keys \['colour'\]"),
        ("id", "a b", "id: expected letters, digits"),
        ("friction_id", "", "friction_id: expected the id"),
        ("cable.radius_m", "thin", "cable.radius_m: expected a number, found 'thin'"),
        ("cable.radius_m", "1e-4", r"YAML reads exponents only as in 1.0e\+6"),
        ("cable.radius_m", True, "cable.radius_m: expected a number, found True"),
        ("cable.radius_m", 10**400, "cable.radius_m: expected a number, found 1000"),
        ("cable.axial_stiffness_n", -1.0, "axial_stiffness_n: expected a positive number, found -1.0"),
        ("material.moment_law", "magic", "moment_law: expected one of linear"),
        ("material.modulus_constant_pa", 1.0e6, "least tangent modulus within max_strain: expected a positive number"),
        ("fingers", [], "fingers: expected a mapping"),
        ("fingers", {}, "expected at least one finger"),
        ("fingers.index.thicknesses_m", [0.003, 0.003], "link_lengths_m: expected 2 values for 2 joints, found 3"),
        ("fingers.index.thicknesses_m", [0.003, -0.003, 0.003], r"thicknesses_m\[1\]: expected a positive number"),
        ("fingers.index.thicknesses_m", [0.003, 0.03, 0.003], r"thicknesses_m\[1\]: 0.03 exceeds the opening"),
        ("fingers.index.thicknesses_m", [0.003] * 7, "expected 1 to 6 joints, found 7"),
        ("fingers.index.joint_lengths_m", [0.01, 0.0, 0.01], r"joint_lengths_m\[1\]: expected a positive number"),
        ("fingers.index.routing_radii_m", [0.005] * 5 + [0.02], r"routing_radii_m\[5\]: 0.02 lies outside the groove"),
        ("fingers.index.link_lengths_m", [0.006, 0.027, 0.023], r"link_lengths_m\[0\]: 0.006 is shorter than"),
        ("fingers.index.openings_rad", [1.5, 3.2, 1.5], r"openings_rad\[1\]: expected less than pi"),
        ("fingers.index.width_m", float("nan"), "width_m: expected a positive number, found nan"),
        ("fingers.index.calibrated_path", [{"pulled_length_m": 0.01, "joint_angles_rad": [0.1], "tension_n": 1.0}],
         r"calibrated_path\[0\]: expected 3 joint angles, found 1"),
    ],
)  # fmt: skip
def test_bad_profiles_say_which_key_is_wrong(power: Profile, path: str, value: object, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        profile.loads(changed(power, path, value))


def test_bad_files(tmp_path: Path, power: Profile) -> None:
    with pytest.raises(ProfileError, match="cannot be read as a profile"):
        profile.load(tmp_path / "none.yaml")
    with pytest.raises(ProfileError, match="found none"):
        profile.load_directory(tmp_path)
    (tmp_path / "broken.yaml").write_text("a: [1, 2")
    with pytest.raises(ProfileError, match=r"broken\.yaml: not YAML"):
        profile.load(tmp_path / "broken.yaml")
    (tmp_path / "list.yaml").write_text("- 1")
    with pytest.raises(ProfileError, match="expected a mapping with 'schema: 1', found list"):
        profile.load(tmp_path / "list.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProfileError, match="cannot be read as a profile"):
        profile.load(tmp_path / "bytes.yaml")
    other = tmp_path / "other"
    other.mkdir()
    profile.save(power, other / "strong.yaml")
    with pytest.raises(ProfileError, match="id: expected 'strong' as the file's name says, found 'power'"):
        profile.load_directory(other)


def test_an_unsound_profile_is_not_written(power: Profile, tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="cannot be used"):
        profile.save(dataclasses.replace(power, fingers=()), tmp_path / "power.yaml")
    assert not (tmp_path / "power.yaml").exists()


def test_names_of_what_a_number_depends_on_are_sha256() -> None:
    assert text_digest("abc") == "ba7816bf8f01cfea"  # FIPS 180-4, example of one block


def test_unknown_slot(power: Profile) -> None:
    with pytest.raises(ProfileError, match="no finger 'ring'; it has index, middle, thumb"):
        power.finger("ring")
