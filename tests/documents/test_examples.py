# SPDX-License-Identifier: Apache-2.0
"""Every script of examples/ runs, is short, and gives what a closed form, a difference or the bag itself says."""

from __future__ import annotations

import ast
import runpy
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softgrip_model import profile
from softgrip_model.friction.published import published

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
MAX_LINES = 60


def example(name: str) -> Mapping[str, Any]:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short_explained_tested_and_listed(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < MAX_LINES
    assert ast.get_docstring(ast.parse(text))
    assert f'"{path.stem}"' in Path(__file__).read_text(encoding="utf-8"), "has no test here"
    assert f"../examples/{path.name}" in (ROOT / "docs/examples.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_uses_public_names_only(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    names |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert not [name for name in names if name.startswith("_") and not name.startswith("__")]


def test_friction_fit_finds_the_law_that_was_measured() -> None:
    fitted = example("friction_fit")["main"]().model
    truth = published("braid-tpu")
    angle, tension = np.meshgrid(np.radians([15.0, 45.0, 85.0]), [2.5, 5.0, 9.0])
    assert fitted.ratio(angle, tension) == pytest.approx(truth.ratio(angle, tension), rel=0.02)


def test_chosen_points_say_more_than_a_grid() -> None:
    chosen, usual = example("friction_plan")["main"]()
    assert 1.0 >= chosen > usual


def test_a_closing_pulls_what_friction_asks_for() -> None:
    rubbing, sliding = example("closing")["main"]()
    along = np.diff(rubbing.tension_n[0, -1])
    assert (along < 0.0).all()  # every bend takes tension away
    assert np.diff(sliding.tension_n[0, -1]) == pytest.approx(0.0, abs=1e-9)


def test_gradients_are_those_of_differences() -> None:
    analytic, numeric = example("gradients")["main"]()
    assert analytic == pytest.approx(numeric, abs=1e-5)


def test_a_product_is_pressed_where_there_is_no_gap() -> None:
    path = example("around_a_product")["main"]()
    assert path.contact_force[:, 0] * path.gap[:, 0] == pytest.approx(0.0, abs=1e-9)  # Signorini
    assert path.contact_force[2, 0] > 0.0
    assert 0 in path.slide[3]
    assert (path.slide[2] == 1).all()


def test_a_beam_bends_as_theory_says() -> None:
    sag, theory = example("gdfe_bar")["main"]()
    assert sag == pytest.approx(theory, rel=0.04)  # hexahedra of six through the height


def test_flexures_follow_the_mesh_better_than_hinges() -> None:
    for pulled_mm, hinge, flexure in example("finger_shape")["main"]():
        assert flexure < hinge < pulled_mm * 2.0


def test_a_designed_finger_follows_and_is_saved(tmp_path: Path) -> None:
    design = example("design_a_finger")["main"](tmp_path)
    saved = profile.load(tmp_path / "my_power.yaml")
    (index,) = design.followed
    found = index.closing.angle_rad[0] - index.target.angle_rad
    assert np.degrees(np.sqrt(np.mean(found**2))) == pytest.approx(index.error_deg)
    assert [1e3 * h for h in saved.finger("index").thicknesses_m] == pytest.approx(index.finger.thickness_mm, abs=1e-3)


def test_recorded_frames_give_the_angles_that_the_cell_measured() -> None:
    module = example("track_frames")
    poses = [reading.pose.angles for reading in module["main"]() if reading.pose is not None]
    states = [state["fingers"] for _, state in module["messages"](module["BAG"], "/finger/measured")]
    recorded = [fingers[0].values["joint_angles"] for fingers in states if fingers]
    assert len(recorded) > 10
    assert np.degrees(poses) == pytest.approx(np.degrees(recorded), abs=0.2)


def test_tensions_of_a_bag_are_those_of_another_reader() -> None:
    module = example("read_a_bag")
    found = module["main"]()
    assert found == pytest.approx(tensions_by_mcap(module["BAG"]))


def tensions_by_mcap(bag: Path) -> dict[str, float]:
    """Read /tendon/state by mcap-ros2-support."""
    from mcap.reader import make_reader  # noqa: PLC0415  as below
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415  half a second

    largest: dict[str, float] = {}
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                ["/tendon/state"]
            )
            for _, _, _, state in messages:
                for name, tension in zip(state.name, state.effort, strict=True):
                    largest[name] = max(largest.get(name, 0.0), tension)
    return largest


def test_an_archive_answers_how_grasps_ended(tmp_path: Path) -> None:
    rows = example("ask_an_archive")["main"](tmp_path)
    assert {row[2] for row in rows} == {"ABORTED", "EMPTY", "GRIPPED", "SLIPPED", "TENDON_FAULT"}  # all in one bag
    assert {row[0] for row in rows} == {"orange"}


def test_products_are_held_by_the_fingers_that_table_4_2_names() -> None:
    found = example("virtual_grasps")["main"](("egg", "grape"))
    held = {key for key, state in found.items() if state.held}
    assert held == {("egg", "power"), ("egg", "pinch"), ("grape", "pinch")}


def test_an_environment_gives_the_same_rewards_for_the_same_seed() -> None:
    pytest.importorskip("gymnasium", reason="make study-setup")
    main = example("environment")["main"]
    rewards = main(seed=3)
    assert rewards == main(seed=3)
    assert rewards != main(seed=4)


def test_a_plan_swaps_once_for_a_product_that_power_fingers_miss() -> None:
    plan = example("plan_a_mix")["main"]()
    assert sorted(step.order.quantity for step in plan.steps) == [4, 5, 10, 20]
    assert plan.swaps == 1
    assert all(step.finger_set == "pinch" for step in plan.steps if step.order.product == "grape")


def test_a_described_hand_is_read_by_mujoco(tmp_path: Path) -> None:
    import mujoco  # noqa: PLC0415  half a second

    urdf, mjcf = example("describe_the_hand")["main"](tmp_path)
    joints = [one for one in ET.parse(urdf).getroot().iter("joint") if one.get("type") == "revolute"]
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    assert model.ntendon == 3 + len(joints) > 3  # the cables, and what says each joint's angle


class ScriptedCell:
    """Answers as a cell does, one product at a time."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def plan(self, products: Sequence[str], quantities: Sequence[int]) -> SimpleNamespace:
        assert list(quantities) == [1] * len(products)
        return SimpleNamespace(steps=[SimpleNamespace(product=name) for name in products])

    def select(self, product: str) -> SimpleNamespace:
        return SimpleNamespace(swap_needed=product == "grape", finger_set="pinch")

    def swap(self, finger_set: str, confirm: Any) -> SimpleNamespace:
        self.calls.append(f"swap {finger_set} {confirm('insert', 'Insert the fingers')}")
        return SimpleNamespace(outcome=1, SUCCEEDED=1)

    def grasp(self, product: str, on_phase: Any) -> SimpleNamespace:
        on_phase("close")
        self.calls.append(f"grasp {product}")
        return SimpleNamespace(outcome=1, reason="held")

    def release(self) -> None:
        self.calls.append("release")


def test_a_controller_swaps_only_where_it_must() -> None:
    cell = ScriptedCell()
    outcomes = example("cell_controller")["work"](cell, ["egg", "grape"], lambda *_: ["PN-1"])
    assert outcomes == {"egg": "GRIPPED", "grape": "GRIPPED"}
    assert cell.calls == ["grasp egg", "release", "swap pinch ['PN-1']", "grasp grape", "release"]
