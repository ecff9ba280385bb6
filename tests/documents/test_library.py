# SPDX-License-Identifier: Apache-2.0
"""The README's notebook lines: in this environment, and with a wheel alone in a fresh one (`make long-tests`)."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "ros2_ws/src/softgrip_model"
NAMED = ROOT / "tools/pages/named.py"
TASKS = (ROOT / "docs/reference/tasks.md").read_text(encoding="utf-8")
NUMBER = r"-?\d+(?:\.\d+)?"


def notebook() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    return code


def check_printed(printed: str) -> None:
    ratio, x, y, tension, solid_x, solid_y, solid_tension = map(float, re.findall(NUMBER, printed.replace("12 mm", "")))
    # Eq 3.9 with Table 3.2's braid on TPU is bounded by the Capstan ratio of a rubber's friction
    assert 1.1 < ratio < np.exp(1.0 * np.pi / 2)
    # the two models share nothing but the profile: 5 % of the finger's 107 mm, 15 % of the tension
    assert np.hypot(x - solid_x, y - solid_y) < 5.0
    assert tension == pytest.approx(solid_tension, rel=0.15)
    assert y < -20.0  # closes towards -y


def test_ten_lines_say_what_both_models_find() -> None:
    code = notebook()
    assert len([line for line in code.splitlines() if line]) <= 11  # the last statement takes two
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    check_printed(ran.stdout)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_the_wheel_does_without_ros_and_without_the_repository(tmp_path: Path) -> None:
    built_in = PACKAGE / "build"
    before = sorted(path.name for path in built_in.iterdir()) if built_in.is_dir() else []
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(PACKAGE)]
    subprocess.run(command, check=True)
    assert {path.name for path in built_in.iterdir()} - set(before) <= {"wheel"}  # not where the editable build is

    (wheel,) = tmp_path.glob("softgrip_model-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert not [name for name in names if "/nodes/" in name]
    assert {f"softgrip_model/profiles/{name}.yaml" for name in ("power", "pinch", "hook")} <= set(names)

    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv/bin/python"
    subprocess.run([python, "-m", "pip", "install", "-q", str(wheel)], check=True)
    where = "import importlib.util, softgrip_model; print(softgrip_model.__file__, importlib.util.find_spec('rclpy'))"
    for code, check in ((where, lambda out: out.startswith(str(tmp_path)) and out.split()[1] == "None"),
                        (notebook(), check_printed)):  # fmt: skip
        ran = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
        assert check(ran.stdout) is not False


@pytest.mark.parametrize("name", re.findall(r"\[`(softgrip_[\w.]+)`\]", TASKS))
def test_a_name_beside_a_task_can_be_imported(name: str) -> None:
    module, _, member = name.rpartition(".")
    assert callable(getattr(importlib.import_module(module), member))


def test_a_command_beside_a_task_is_installed() -> None:
    pytest.importorskip("embedded_ros", reason="its parsers know the commands")
    known = {command for commands in load_script(NAMED).commands.executables().values() for command in commands}
    cells = [line.split("|")[2] for line in TASKS.splitlines() if line.startswith("| ")][2:]
    named = {words.split()[0] for cell in cells for words in re.findall(r"`([^`/]+)`", cell)}
    assert len(named) >= 15
    assert named <= known
