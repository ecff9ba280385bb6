# SPDX-License-Identifier: Apache-2.0
"""The shipped parameter files are what the nodes' tables say."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from softgrip_model.finger.uncertainty import STATED
from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
parameters = load_script(ROOT / "tools" / "parameters.py")


@pytest.mark.parametrize(("path", "content"), [pytest.param(p, c, id=p.stem) for p, c in parameters.files().items()])
def test_shipped_file_is_up_to_date(path: Path, content: str) -> None:
    assert path.read_text() == content, "run: python tools/parameters.py"


@pytest.mark.parametrize("path", sorted(parameters.CONFIG.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_value_has_a_unit_comment_and_reads_back_as_its_type(path: Path) -> None:
    document = yaml.safe_load(path.read_text())
    values = document[f"/**/{path.stem}"]["ros__parameters"]
    lines = path.read_text().splitlines()
    for name in values:
        at = next(i for i, line in enumerate(lines) if line.startswith(f"    {name}:"))
        assert lines[at - 1].strip().startswith("# ["), name


def test_real_hardware_keeps_stop_and_lock_with_the_port_whatever_the_launch_s_folder() -> None:
    document = yaml.safe_load((parameters.CONFIG.parent / "settings" / "real.yaml").read_text())
    for node in ("tendon_driver", "friction_rig"):
        assert document[f"/**/{node}"]["ros__parameters"] == {"safety_file": ""}


def test_real_hardware_begins_with_the_tolerances_that_sources_state() -> None:
    """Those of the shipped file are true of the emulated cell's printer and cable."""
    document = yaml.safe_load((parameters.CONFIG.parent / "settings" / "real.yaml").read_text())
    assert document["/**/kinematics_predictor"]["ros__parameters"] == pytest.approx(
        {
            "zero_stddev_m": 1e-3 * STATED.zero_mm,
            "stretch_stddev_m_per_n": 1e-3 * STATED.stretch_mm_per_n,
            "room_stddev_m": 1e-3 * STATED.room_mm,
            "print_stddev_m": 1e-3 * STATED.thickness_mm,
            "camera_stddev_m": 1e-3 * STATED.camera_mm,
            "model_stddev": STATED.model,
            "stiffness_stddev": STATED.stiffness,
            "friction_stddev": STATED.friction,
        }
    )
