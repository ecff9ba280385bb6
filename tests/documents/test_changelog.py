# SPDX-License-Identifier: Apache-2.0
"""The changelog has the form of Keep a Changelog, and all packages have one version."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}

release = load_script(ROOT / "tools/release.py")


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


def test_a_release_takes_what_is_unreleased() -> None:
    text = "# C\n\nWords.\n\n## [Unreleased]\n\n### Added\n\n* b\n\n### Fixed\n\n* f\n  more\n\n"
    old = "## [0.1.0] - 2026-01-01\n\nFirst.\n\n### Added\n\n* a\n"
    made = release.released(text + old, "0.2.0", "2026-02-02")
    assert made == (
        "# C\n\nWords.\n\n## [Unreleased]\n\n## [0.2.0] - 2026-02-02\n\n"
        "### Added\n\n* b\n\n### Fixed\n\n* f\n  more\n\n"
        f"{old}"
    )
    assert release.released(made, "0.2.0", "2026-03-03") == made  # nothing new
    into = release.released(text + old, "0.1.0", "2026-02-02")
    assert into == (
        "# C\n\nWords.\n\n## [Unreleased]\n\n## [0.1.0] - 2026-01-01\n\nFirst.\n\n### Added\n\n* b\n* a\n\n"
        "### Fixed\n\n* f\n  more\n"
    )


def test_no_line_of_this_changelog_is_lost_in_a_release() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    made = release.released(text, release.changelog_versions()[0], "2026-01-01")
    assert sorted(set(filter(None, text.splitlines()))) == sorted(set(filter(None, made.splitlines())))


def test_a_tag_is_released_with_what_the_changelog_says_of_it() -> None:
    text = "# C\n\n## [Unreleased]\n\n* u\n\n## [0.2.0] - 2026-02-02\n\nTwo.\n\n* b\n\n## [0.1.0] - 2026-01-01\n\n* a\n"
    assert release.notes(text, "v0.2.0") == "Two.\n\n* b\n"
    assert release.notes(text, "v0.1.0") == "* a\n"


@pytest.mark.parametrize("tag", ["0.2.0", "v0.2", "v0.3.0", "v0.2.0-rc1"])
def test_a_tag_that_is_no_released_version_has_no_notes(tag: str) -> None:
    with pytest.raises(ValueError, match="expected a"):
        release.notes("# C\n\n## [0.2.0] - 2026-02-02\n\n* b\n", tag)


def test_a_tag_beside_the_packages_version_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    older = f"v{release.changelog_versions()[-1]}"
    monkeypatch.setattr(sys, "argv", ["release.py", "--notes", older])
    assert release.main() == 1
    assert "expected packages of" in capsys.readouterr().err
