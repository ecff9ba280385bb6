# SPDX-License-Identifier: Apache-2.0
"""Nothing of the site is cut: pages in a real Chromium, as wide as a desk's screen and as a phone's."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from softgrip_testing.browser import PanelBrowser
from softgrip_testing.scripts import load_script

pytest.importorskip("sphinx", reason="make docs-setup")
pytest.importorskip("furo", reason="make docs-setup")
pytest.importorskip("selenium", reason="make panel-setup")

ROOT = Path(__file__).resolve().parents[2]
#: Wide tables, long lines of code, equations, outputs, drawings.
PAGES = (
    "index",
    "security",
    "friction",
    "emulator",
    "driver",
    "examples",
    "tutorials/close-a-finger",
    "tutorials/index",
)
SIZES = {"desk": (1280, 900), "phone": (390, 844)}
#: What reaches further than the box that shows it: its tag, by how much [px], and how it begins.
CUT = """
return [...document.querySelectorAll(arguments[0])].filter(e => e.scrollWidth > e.clientWidth + 1)
  .map(e => `${e.tagName} by ${e.scrollWidth - e.clientWidth}: ${e.textContent.trim().slice(0, 60)}`)
"""

site_tables = load_script(ROOT / "tools/pages/site_tables.py")
markdown = load_script(ROOT / "tools/pages/generated/markdown.py")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some pages alone: the whole site takes minutes."""
    folder = tmp_path_factory.mktemp("site")
    patterns = ",".join(f"docs/{page}.md" for page in PAGES)
    command = [sys.executable, "-m", "sphinx", "-Q", "-c", "docs", "-D", f"include_patterns={patterns}"]
    subprocess.run([*command, "-d", str(folder / "trees"), ".", str(folder / "html")], cwd=ROOT, check=True)
    return folder / "html/docs"


@pytest.fixture(scope="module", params=SIZES)
def browser(request: pytest.FixtureRequest) -> Iterator[PanelBrowser]:
    if not shutil.which("chromium") and not shutil.which("chromium-browser") and not shutil.which("google-chrome"):
        pytest.skip("no Chromium: make panel-setup")
    with PanelBrowser("file://", SIZES[request.param]) as one:
        yield one


@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", PAGES)
def test_nothing_is_cut(browser: PanelBrowser, site: Path, page: str) -> None:
    browser.driver.get((site / f"{page}.html").as_uri())
    assert browser.script("return document.title")
    assert browser.script("return document.documentElement.scrollWidth - window.innerWidth") <= 0
    assert browser.script(CUT, "article pre, .equation") == []
    if browser.script("return window.innerWidth") == SIZES["desk"][0]:
        assert browser.script(CUT, "article table") == []  # on a phone a wide table scrolls


@pytest.mark.timeout(300)
def test_an_output_has_a_line_at_its_left_and_no_ground(browser: PanelBrowser, site: Path) -> None:
    """As tutorials/index.md says."""
    browser.driver.get((site / "tutorials/close-a-finger.html").as_uri())
    ground = "return getComputedStyle(document.querySelector(arguments[0])).backgroundColor"
    assert browser.script(ground, ".highlight-text .highlight") == "rgba(0, 0, 0, 0)"
    assert browser.script(ground, ".highlight-python .highlight") != "rgba(0, 0, 0, 0)"
    line = "return getComputedStyle(document.querySelector('.highlight-text pre')).borderLeftWidth"
    assert browser.script(line) == "3px"


def test_long_names_in_tables_may_break_and_read_as_before() -> None:
    row = '<tr><td><code>camera/image_raw</code></td><td><a href="sensor_msgs/Image">sensor_msgs/Image</a></td></tr>'
    made = site_tables.breakable(f"<p>sensor_msgs/Image</p>{row}")
    assert made == f"<p>sensor_msgs/Image</p>{row.replace('>sensor_msgs/Image', '>sensor_<wbr>msgs/<wbr>Image')}"


def test_code_in_a_generated_table_is_shown_as_it_is() -> None:
    assert markdown.cell("a < b, `<finger>_tip`|c") == "a &lt; b, `<finger>_tip`\\|c"
