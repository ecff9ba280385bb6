# SPDX-License-Identifier: Apache-2.0
"""What the site adds to its pages: equations that browsers draw, and names in code that lead to the reference."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from softgrip_testing.scripts import load_script

pytest.importorskip("docutils", reason="make docs-setup")

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
