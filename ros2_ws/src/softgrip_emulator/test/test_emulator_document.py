# SPDX-License-Identifier: Apache-2.0
"""docs/emulator.md names every fault there is, and no other."""

import re
from pathlib import Path

import pytest

from softgrip_emulator.faults import BUS_FAULTS, CAMERA_FAULTS, HANDS

DOCUMENT = Path(__file__).parents[4] / "docs" / "emulator.md"


@pytest.mark.skipif(not DOCUMENT.exists(), reason="the package was installed without the repository's docs")
def test_the_table_of_faults_is_complete():
    table = DOCUMENT.read_text(encoding="utf-8").split("## Faults")[1].split("\n## ")[0]
    rows = [row.split("|")[1] for row in table.splitlines() if row.startswith("| ") and not row.startswith("| fault |")]
    named = set(re.findall(r"[a-z_]+", " ".join(rows)))
    assert named == {*BUS_FAULTS, *CAMERA_FAULTS, *HANDS}
