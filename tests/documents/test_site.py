# SPDX-License-Identifier: Apache-2.0
"""What the site adds to its pages: equations that browsers draw, and names in code that lead to the reference."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softgrip_testing.scripts import load_script

pytest.importorskip("sphinx", reason="make docs-setup")

ROOT = Path(__file__).resolve().parents[2]
EQUATION = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parts)
EQUATIONS = [(path.name, found) for path in PAGES for found in EQUATION.findall(path.read_text(encoding="utf-8"))]

site_links = load_script(ROOT / "tools/pages/site_links.py")
site_math = load_script(ROOT / "tools/pages/site_math.py")


@pytest.mark.parametrize(("page", "equation"), EQUATIONS)
def test_an_equation_becomes_mathml_without_an_error(page: str, equation: str) -> None:
    tree = ET.fromstring(re.sub(r"&(?!amp;|lt;|gt;)\w+;", "", site_math.tex2mathml(equation, as_block=True)))
    assert tree.tag.endswith("math"), page
    assert not [one for one in tree.iter() if one.tag.endswith("merror")], page


def test_the_pages_have_equations() -> None:
    assert len(EQUATIONS) >= 7


def test_names_are_known_by_what_a_block_imports() -> None:
    source = "import json\nfrom a.b import c, d as e\nfrom . import f\n"
    assert dict(site_links.imported(source)) == {"c": "a.b.c", "e": "a.b.d"}
    assert list(site_links.imported("$ not python")) == []


def test_a_name_is_linked_in_python_blocks_and_not_as_a_member() -> None:
    pygments = pytest.importorskip("pygments")
    from pygments.formatters import HtmlFormatter  # noqa: PLC0415  as above
    from pygments.lexers import PythonLexer  # noqa: PLC0415  as above

    code = pygments.highlight("from a import close\nclose(x)\nfile.close()\n", PythonLexer(), HtmlFormatter())
    inner = code.replace('<div class="highlight">', '<div class="highlight-python notranslate"><div class="highlight">')
    made = site_links.linked(f'<p><span class="n">close</span></p>{inner}', {"close": "api.html#a.close"})
    link = '<a class="in-code" href="api.html#a.close"><span class="n">close</span></a>'
    assert made.count(link) == 2  # where it is imported and where it is called
    assert '<span class="o">.</span><span class="n">close</span>' in made
    assert made.startswith('<p><span class="n">close</span></p>')


site_names = load_script(ROOT / "tools/pages/site_names.py")


@pytest.mark.parametrize(
    "text", ["angle_rad", "Half of it", "summary.json", "n + 1 matrices", "close(finger, law)", "N"]
)
def test_prose_and_fields_are_no_references(text: str) -> None:
    assert not site_names.is_name(text)


@pytest.mark.parametrize("text", ["numpy.dtype", "GraspPhase", "softgrip_cell.errors.CellError", "polled.PROTOCOLS"])
def test_dotted_names_and_classes_are_references(text: str) -> None:
    assert site_names.is_name(text)


def test_a_name_leads_to_the_only_page_that_shows_it() -> None:
    shown = ["a.grasp.GraspPhase", "a.Limits", "b.Limits"]
    assert site_names.on_a_page("a.grasp.values.GraspPhase", shown) == "a.grasp.GraspPhase"
    assert site_names.on_a_page("Limits", shown) is None  # which one?
    assert site_names.on_a_page("Nowhere", shown) is None


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("pathlib.Path", True),
        ("ValueError", True),
        ("np.ndarray", True),  # as the module calls it
        ("softgrip_interfaces.srv.PlanMix_Response", True),  # as rosidl calls PlanMix.Response
        ("softgrip_interfaces.srv.PlanMix_Reply", False),
        ("pathlib.Pathh", False),
        ("no_such_module.Name", False),
        ("NoSuchName", False),
    ],
)
def test_a_name_without_a_page_has_to_be_somewhere(name: str, *, there: bool) -> None:
    assert site_names.exists(name, [SimpleNamespace(np=np)]) is there


def test_a_name_for_type_checkers_alone_is_found_in_the_sources() -> None:
    assert {"ShiftClosing", "Undo", "JointModel"} <= site_names.written()
    assert "NoSuchName" not in site_names.written()


@pytest.mark.parametrize(
    ("line", "lines"),
    [
        ("Digest of all frames: chains, options", ["Digest of all", "frames: chains, options"]),
        ("No colon here", ["No colon here"]),
        ("float: as napoleon has it", ["float: as napoleon has it"]),
    ],
)
def test_words_before_a_colon_are_no_type(line: str, lines: list[str]) -> None:
    assert site_names.without_type(line) == lines
