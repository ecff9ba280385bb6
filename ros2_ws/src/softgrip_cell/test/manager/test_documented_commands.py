# SPDX-License-Identifier: Apache-2.0
"""Every command line of docs/cell.md, typed as it stands there, does what the page says."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from softgrip_interfaces.action import Grasp
from softgrip_interfaces.msg import CellState, MountedFinger
from softgrip_interfaces.srv import ConfirmStep

pytestmark = pytest.mark.ros

PAGE = (Path(__file__).parents[5] / "docs" / "cell.md").read_text()
LINES = re.findall(r"^(ros2 .+)$", PAGE.replace("\\\n", " "), re.MULTILINE)  # a long line goes on below
TIMEOUT_S = 60.0
INSERT = ConfirmStep.Request.INSERT
#: Steps of a swap that a person confirms.
STEPS = (ConfirmStep.Request.OPEN_PALM, ConfirmStep.Request.REMOVE, INSERT, ConfirmStep.Request.CLOSE_PALM)


@pytest.fixture(autouse=True)
def path(monkeypatch: pytest.MonkeyPatch) -> None:
    """`ros2` of this interpreter, or the one that is sourced."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


def line(part: str) -> list[str]:
    """The page's command line that has this in it, as words."""
    (found,) = [each for each in LINES if part in each]
    return shlex.split(found)


def typed(part: str) -> str:
    """Run a command line of the page; what it printed."""
    done = subprocess.run(line(part), capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_shift_typed_from_the_page(cell: Any) -> None:
    cell.start()
    assert "swap_needed=True" in typed("/cell/select_product")
    assert "swaps=1" in typed("/cell/plan_mix")

    swap = subprocess.Popen(line("/cell/swap"), stdout=subprocess.PIPE, text=True)
    try:
        assert swap.stdout is not None
        step = 0
        for text in swap.stdout:
            # each step that waits is confirmed with a command of the page, which has one without and one with serials
            field, _, value = text.strip().partition(": ")
            step = int(value) if field == "step" else step
            if field == "token" and step in STEPS:
                form = INSERT if step == INSERT else STEPS[0]
                shown = line(f"{{step: {form}, token")
                confirmed = [word.replace(f"step: {form}", f"step: {step}").replace("0f2c", value) for word in shown]
                done = subprocess.run(confirmed, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
                assert "success=True" in done.stdout, done.stdout + done.stderr
        assert swap.wait(TIMEOUT_S) == 0
    finally:
        swap.kill()
    mounted = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle").mounted
    assert [(m.serial, m.state) for m in mounted] == [(s, MountedFinger.VERIFIED) for s in cell.serials("PW")]

    cell.driver.bench.contact_m = (0.008, 0.009, 0.0085)
    answer = typed("/cell/grasp")
    assert f"phase: {Grasp.Feedback.LIFT}" in answer
    assert "outcome: 1" in answer
    assert "SUCCEEDED" in answer
    assert "gripped: 1" in typed("/cell/state")
    assert "success=True" in typed("/tendon/release")
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")

    assert "outcome='GRIPPED'" in typed("/cell/list_grasps")
    assert "id='egg'" in typed("/cell/list_products")
    assert "success=True" in typed("/cell/retire_finger")
    assert "is retired" in typed("/cell/list_fingers")  # why it may not be mounted
    assert "success=True" in typed("/cell/write_audit")


def test_help_is_worth_reading() -> None:
    assert "finger records" in typed("library --help")
