# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from softgrip_model.profile import Profile, load_directory

PROFILES = Path(__file__).resolve().parents[2] / "softgrip_bringup" / "profiles"


@pytest.fixture(scope="module")
def profiles() -> dict[str, Profile]:
    return load_directory(PROFILES)
