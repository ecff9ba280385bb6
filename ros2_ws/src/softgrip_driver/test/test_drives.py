# SPDX-License-Identifier: Apache-2.0
"""Backends by entry point: those of this package, and one of a package that nobody here knows."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from softgrip_driver import drives
from softgrip_driver.configuration import checked_configuration
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.nodes.tendon_parameters import PARAMETERS

HERE = Path(__file__).parent
ENTRY_POINTS = """
[softgrip.drives]
paper = paper_drive:configure
{more}
[softgrip.drive_contracts]
paper = paper_drive:PaperDevice
"""


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder with the stranger's package installed in it, as pip leaves it."""

    def install(more=""):
        info = tmp_path / "paper_drive-1.0.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: paper-drive\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(ENTRY_POINTS.format(more=more))
        (tmp_path / "paper_drive.py").write_text((HERE / "stranger" / "paper_drive.py").read_text())
        monkeypatch.syspath_prepend(str(tmp_path))
        return tmp_path

    yield install
    sys.modules.pop("paper_drive", None)


def configured(**changes):
    return checked_configuration({row.name: row.default for row in PARAMETERS.rows} | changes)


def test_the_shipped_backends_are_there_and_load():
    assert drives.drive_names() == ["damiao", "dynamixel", "feetech", "grbl", "mark10"]
    assert all(callable(drives._loaded(entry)) for entry in drives._installed().values())


def test_a_stranger_s_backend_is_found_configured_and_built(site, world):
    site()
    assert "paper" in drives.drive_names()
    found = configured(backend="paper", tendons=["pull"], backend_options=["folder=/dev/paper0"])
    backend = found.drives.backend(lambda _: None, world.clock)
    assert [one.device for one in backend.connect()] == ["paper winch"]


@pytest.mark.parametrize(
    ("more", "changes", "text"),
    [
        ("", {"backend": "papier", "tendons": ["pull"]}, "found 'papier'; did you mean 'paper'"),
        ("", {"backend": "paper"}, "expected one with a paper winch"),
        ("", {"backend": "paper", "tendons": ["pull"], "backend_options": ["folder"]}, "expected NAME=VALUE"),
        ("broken = paper_drive:nothing", {"backend": "broken"}, "expected to load paper_drive:nothing, found Attr"),
        ("feetech = paper_drive:configure", {}, "backend 'feetech': expected one package to bring it"),
    ],
)  # fmt: skip
def test_what_a_stranger_s_package_gets_wrong_is_said(site, more, changes, text):
    site(more)
    with pytest.raises(ConfigurationError, match=text):
        configured(**changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"backend": "feetech"}, r"expected names out of \['STS3215'\] with backend 'feetech', found 'XL330-M288'"),
        ({"backend": "feetech", "servo_models": ["STS3215"]}, "homing_tension_n of at least 12 N"),
        ({"backend": "feetech", "baud": 57600}, "expected one of .* with backend 'feetech', found 57600"),
        ({"backend": "damiao", "servo_ids": [1, 2, 16]}, r"expected 1 to 15 with backend 'damiao', found \[16\]"),
        (
            {"backend": "damiao", "servo_models": ["DM-J4310-2EC"], "loop_rate": 200.0, "homing_tension_n": 8.0,
             "acceleration_m_s2": 0.2, "speed_m_s": 0.02, "homing_travel_m": 0.1},
            "expected a shaft within 12.5 rad of a DM-J4310-2EC's origin, found 17.4",
        ),
    ],
)  # fmt: skip
def test_what_a_drive_cannot_do_is_refused(changes, text):
    with pytest.raises(ConfigurationError, match=text):
        configured(**changes)


def test_the_contract_suite_runs_over_a_stranger_s_backend(site):
    folder = site()
    suite = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n0",
        "-p",
        "no:cacheprovider",
        str(HERE / "test_backend_contract.py"),
    ]
    path = os.pathsep.join([str(folder), *sys.path])
    done = subprocess.run(
        [*suite, "-k", "paper"], env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert "10 passed" in done.stdout, done.stdout[-3000:] + done.stderr[-2000:]
