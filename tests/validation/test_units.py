# SPDX-License-Identifier: Apache-2.0
"""Seconds and nanoseconds are converted in one place, softgrip_time.units."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HOME = ROOT / "ros2_ws/src/softgrip_time/softgrip_time/units.py"
CONVERSION = re.compile(r"(\*|/) *(1e9|10\*\*9|1_000_000_000)\b|\b1e-9 *\*|\* *1e-9\b|divmod\(.*10\*\*9")
#: Tolerances of geometry and mechanics, which are no times.
TOLERANCES = re.compile(r"1e-9 \* (size|np\.eye|rr)|<= 1e-9 \*|> 1e-9 \*")


def conversions(text: str) -> list[str]:
    """Return the lines that convert themselves."""
    return [line.strip() for line in text.splitlines() if CONVERSION.search(line) and not TOLERANCES.search(line)]


def test_no_package_converts_times_itself() -> None:
    files = [
        path
        for path in sorted((ROOT / "ros2_ws/src").rglob("*.py"))
        if not {"test", "build"} & set(path.parts) and path != HOME
    ]
    assert len(files) > 400
    assert {str(path.relative_to(ROOT)): lines for path in files if (lines := conversions(path.read_text()))} == {}


@pytest.mark.parametrize("line", ["x = t_s * 1e9", "return 1e-9 * ns", "a, b = divmod(ns, 10**9)", "y = ns / 1e9"])
def test_a_conversion_is_found(line: str) -> None:
    assert conversions(line) == [line]


def test_a_tolerance_is_none() -> None:
    assert conversions("if value < 1e-9:\nridge = 1e-9 * np.eye(3)") == []
