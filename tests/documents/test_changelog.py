# SPDX-License-Identifier: Apache-2.0
"""The changelog has the form of Keep a Changelog, and all packages have one version."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}

spec = importlib.util.spec_from_file_location("release", ROOT / "tools/release.py")
assert spec is not None
assert spec.loader is not None
release = importlib.util.module_from_spec(spec)
spec.loader.exec_module(release)


def test_versions_go_down_and_parts_have_the_names_of_keep_a_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert sections[0] == "[Unreleased]"
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d{2}-\d{2}", one) for one in sections[1:])
    numbers = [tuple(map(int, one.split("."))) for one in release.changelog_versions()]
    assert numbers == sorted(numbers, reverse=True)
    assert set(re.findall(r"^### (.*)$", text, re.MULTILINE)) <= KINDS


def test_every_package_has_the_same_version() -> None:
    found = release.versions()
    assert len(found) > 30
    assert len(set(found.values())) == 1, found


def test_that_version_has_a_section() -> None:
    assert set(release.versions().values()) <= set(release.changelog_versions())
