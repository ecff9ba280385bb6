# SPDX-License-Identifier: Apache-2.0
"""The command behind `make fuzz`, for a moment on each end of the wires."""

import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).resolve().parents[2] / "tools" / "fuzz.py"


@pytest.mark.parametrize("end", ["driver", "emulator"])
def test_it_finds_nothing(end):
    done = subprocess.run(
        [sys.executable, FUZZ, end, "--engine", "random", "--seconds", "0.2", "--seed", "2"],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{end}: ")


def test_it_feeds_as_many_streams_as_asked_for():
    done = subprocess.run(
        [sys.executable, FUZZ, "driver", "--streams", "150", "--seed", "3"],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("driver: 150 streams")


def test_an_unknown_end_is_refused():
    done = subprocess.run([sys.executable, FUZZ, "camera"], capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 2
    assert "driver" in done.stderr
