# SPDX-License-Identifier: Apache-2.0
"""The check of identifiers sees what it is for, and nothing in the workspace breaks it."""

from __future__ import annotations

from pathlib import Path

import pytest

from softgrip_testing.scripts import load_script

TOOL = Path(__file__).resolve().parents[2] / "tools" / "vocabulary.py"
vocabulary = load_script(TOOL)


@pytest.mark.parametrize(
    ("identifier", "word"),
    [
        ("FEWEST_CORNERS", "fewest"),
        ("import_passports", "passports"),
        ("TracedDoors", "doors"),
        ("_excess_n", "excess"),
        ("least_squares", ""),
        ("almost_there", ""),
        ("min_corners", ""),
        ("MOSTLY", ""),
        ("kMostRounds", "most"),
    ],
)
def test_words_are_found_in_any_spelling_of_an_identifier(identifier: str, word: str) -> None:
    assert vocabulary.forbidden_word(identifier) == word


@pytest.mark.long
def test_the_workspace_breaks_no_rule_and_the_pending_list_is_up_to_date() -> None:
    problems, known = vocabulary.found_problems(), vocabulary.pending()
    assert sorted(set(problems) - known) == []
    assert sorted(known - set(problems)) == []


def test_a_name_that_breaks_a_rule_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "ros2_ws" / "src" / "softgrip_x" / "softgrip_x"
    package.mkdir(parents=True)
    (package / "one.py").write_text("class Verdict: pass\nhaste = 1\n")
    (package / "two.py").write_text(
        "class Verdict: pass\nclass Eye:\n    def see(self): ...\n    def see_tip(self): ...\n"
        "class File:\n    def write(self): ...\n    def tell(self): ...\n"
    )
    (package / "three.hpp").write_text(
        '// haste is prose\nconstexpr int kNapSteps = 4;  /* least */\nauto text = "most";\n'
    )
    monkeypatch.setattr(vocabulary, "ROOT", tmp_path)
    assert set(vocabulary.found_problems()) == {"haste", "class Verdict", "kNapSteps", "Eye.see"}
