# SPDX-License-Identifier: Apache-2.0
"""Fifty bags in an archive: SQL answers with the figures of their reports (benchmarks/bag/archive.py)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "bag" / "archive.py"


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_sql_over_fifty_bags_gives_the_figures_of_their_reports() -> None:
    """Also: all of them added a second time under other names change no file, and a broken one is listed."""
    done = subprocess.run([sys.executable, str(BENCHMARK)], capture_output=True, text=True, timeout=1700, check=False)
    assert done.returncode == 0, done.stderr
    claim = json.loads(done.stdout)
    assert "50 bags" in claim["note"]
    assert claim["runs"] > 900
    assert claim["value"] == 0, claim["note"]
