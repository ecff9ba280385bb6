# SPDX-License-Identifier: Apache-2.0
"""A stranger sends what nobody should to everything a cell listens to, and no process ends."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks/cell/hostile_inputs.py"
COUNT = 3000

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        rclpy.get_rmw_implementation_identifier() != "rmw_zenoh_cpp", reason="the stranger speaks Zenoh only"
    ),
]


def test_no_process_of_a_cell_ends_over_what_a_stranger_sends() -> None:
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--count", str(COUNT), "--baseline", "2"],
        capture_output=True, text=True, check=False, timeout=300.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    claims = {claim["name"]: claim for claim in map(json.loads, done.stdout.splitlines())}
    assert claims["processes ended"]["value"] == 0, done.stderr
    note = claims["processes ended"]["note"]
    assert f"{COUNT} inputs" in note
    answered = int(note.partition(" answered")[0].rpartition(" ")[2])
    refused = int(note.partition(" refused")[0].rpartition(" ")[2])
    # it was heard: most requests were answered, and some were refused with a reason
    assert answered > COUNT // 10
    assert refused > COUNT // 50
