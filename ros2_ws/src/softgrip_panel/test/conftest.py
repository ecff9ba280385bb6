# SPDX-License-Identifier: Apache-2.0
"""The panel's site as a process, with a cell that is none (panel_site.py)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from softgrip_panel.access.accounts import add_account
from softgrip_panel.model.roles import Role
from softgrip_panel.model.state import PanelState
from softgrip_testing.browser import PanelBrowser
from softgrip_testing.manual_clock import ManualClock
from softgrip_testing.synthetic_boards import POSES, BoardCamera
from softgrip_vision.calibrating import Board
from softgrip_vision.calibration import Lens

#: Stands in for `ros2` beside the site: writes down what it was asked for, and does what it would do.
ROS2 = """#!/bin/sh
echo "$@" >> "$SAID"
case "$3" in
report) echo "<html><body>a report<svg><path d='M0 0 L9 9'/></svg></body></html>" > "$6" ;;
replay) echo '{"messages": 120, "largest": 0.0}' ;;
scan) echo "scanning $5"; sleep 1; echo "ID 1: XL330-M288 at 1000000 baud" ;;
selftest) echo "latency timer 16 ms"; echo "fix: set it to 1 ms"; exit 1 ;;
setup) echo "ID 1 -> $9" ;;
wizard) echo "step 1"; sleep 60; echo "never said" ;;
esac
"""


@dataclass
class RunningSite:
    """A site that runs; `folder` holds what was called and recorded."""

    address: str
    folder: Path
    process: subprocess.Popen[str]

    def calls(self) -> list[dict[str, object]]:
        """Return what reached the cell, in order."""
        file = self.folder / "calls"
        return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []

    def recorded(self) -> list[dict[str, object]]:
        """Return the record of acts."""
        return [json.loads(line) for line in (self.folder / "acts.jsonl").read_text().splitlines()]


def run_site(folder: Path, port: int = 0) -> RunningSite:
    """Start a site and wait for its address."""
    program = str(Path(__file__).with_name("panel_site.py"))
    stand_in = folder / "bin" / "ros2"
    stand_in.parent.mkdir(exist_ok=True)
    stand_in.write_text(ROS2)
    stand_in.chmod(0o755)
    environment = {**os.environ, "PATH": f"{stand_in.parent}:{os.environ['PATH']}", "SAID": str(folder / "said")}
    process = subprocess.Popen(
        [sys.executable, program, str(folder), str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdout is not None
    return RunningSite(process.stdout.readline().strip().rstrip("/"), folder, process)


def stop_site(site: RunningSite) -> None:
    site.process.communicate("", timeout=10.0)


@pytest.fixture
def start_site() -> Iterator[Callable[[Path], RunningSite]]:
    """Start a site on a folder; it ends with the test."""
    running: list[RunningSite] = []

    def start(folder: Path) -> RunningSite:
        running.append(run_site(folder))
        return running[-1]

    yield start
    for one in running:
        stop_site(one)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    found = run_site(tmp_path_factory.mktemp("site"))
    yield found
    stop_site(found)


@pytest.fixture(scope="module")
def guarded_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    """A site with accounts."""
    yield from _with_accounts(tmp_path_factory.mktemp("guarded"))


@pytest.fixture
def guessed_site(tmp_path: Path) -> Iterator[RunningSite]:
    """A site with accounts of a test's own: after wrong log-ins everybody at this address has to wait."""
    yield from _with_accounts(tmp_path)


def _with_accounts(folder: Path) -> Iterator[RunningSite]:
    for name, role in (("Ada", Role.OPERATE), ("Eve", Role.LOOK), ("Ida", Role.ENGINEER)):
        add_account(folder / "users.yaml", name, role, f"{name} has one")
    found = run_site(folder)
    yield found
    stop_site(found)


@pytest.fixture(scope="module")
def browser(site: RunningSite) -> Iterator[PanelBrowser]:
    with PanelBrowser(site.address) as found:
        found.log_in("Ada")
        yield found


@pytest.fixture(scope="session")
def board_pictures() -> list[bytes]:
    """Pictures of the printed board from many sides, drawn with a lens of 905 x 908 px."""
    lens = Lens(960, 540, np.array([[905.0, 0.0, 486.0], [0.0, 908.0, 263.0], [0.0, 0.0, 1.0]]), np.zeros(5), "truth")
    camera = BoardCamera(lens, Board(11, 7, 0.024))
    found = []
    for at, turn, away in POSES[:8]:
        picture = camera.picture(*camera.centred(np.array(turn), at, away))
        found.append(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())
    return found


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(1000.0)


@pytest.fixture
def state(clock: ManualClock) -> PanelState:
    return PanelState(clock, clock)
