# SPDX-License-Identifier: Apache-2.0
"""Write the tables of docs/security.md from the shipped policy; everything above the mark is by hand."""

from __future__ import annotations

from pathlib import Path

from softgrip_security.policy import read_policy
from softgrip_security.tables import policy_tables

PAGE = Path(__file__).resolve().parents[2] / "docs" / "security.md"
MARK = "<!-- written by tools/docs/security.py -->\n"


def page() -> str:
    """Return the page with the tables of the shipped policy."""
    by_hand, mark, _ = PAGE.read_text().partition(MARK)
    if not mark:
        raise ValueError(f"{PAGE}: expected the line {MARK!r}, found none")
    return f"{by_hand}{mark}\n{policy_tables(read_policy())}"


if __name__ == "__main__":
    PAGE.write_text(page())
