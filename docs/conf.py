# SPDX-License-Identifier: Apache-2.0
"""The documentation's site: `make site` builds it into out/site, without a network.

The source folder is the repository, so that a link from one page to another, or to a file of the code, is the same on
the forge and on the site.
"""

import enum
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.pycode import ModuleAnalyzer

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools" / "pages"))

project = "softgrip"
author = "softgrip maintainers"
copyright = "softgrip maintainers, Apache-2.0"  # noqa: A001  Sphinx' name
root_doc = "docs/index"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "site_links",
    "site_math",
    "site_names",
    "site_tables",
]

include_patterns = [
    "docs/**.md",
    "embedded/README.md",
    "CHANGELOG.md",
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "DEVELOPING.md",
    "SECURITY.md",
]
exclude_patterns = [
    ".*",
    "out",
    "build",
    "ros2_ws",
    "tests",
    "benchmarks",
    "tools",
    "docker",
    "**/__pycache__",
]

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist", "attrs_inline"]
myst_links_external_new_tab = False
myst_fence_as_directive = ["math"]
html_math_renderer = "mathml"

nitpicky = True  # a name in a docstring that is nowhere is an error; site_names knows those without a page
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}
autodoc_mock_imports = ["mediapipe"]
autosummary_generate = False  # tables alone: a page has all members
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
# a package's face and its module both show a class that both name
suppress_warnings = ["ref.python"]

default_role = "py:obj"  # `Name` in a docstring
smartquotes = False  # -- and quotation marks of commands stay what has to be typed

html_theme = "furo"
html_title = "softgrip"
html_static_path = ["site"]
html_css_files = ["softgrip.css"]
html_extra_path = ["site/index.html"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {
    "top_of_page_buttons": [],
    "light_css_variables": {"font-stack": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"},
    "dark_css_variables": {"font-stack": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"},
}
pygments_style = "friendly"


def _as_rest(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Link the pages that docstrings name, and keep |x| of their formulas from being read as a substitution."""

    def changed(found: re.Match[str]) -> str:
        literal, page = found[1], found[2]
        return literal or (f":doc:`/docs/{page}`" if page else r"\|")

    lines[:] = [re.sub(r"(``[^`]*``|`[^`]*`)|\bdocs/([\w/-]+)\.md\b|\|", changed, line) for line in lines]


def _constant(_app: Any, what: str, name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Give a constant the words that stand above it where it is made, and not those of its type."""
    if what != "data" or lines[:1] != (type(obj).__doc__ or "").strip().splitlines()[:1]:
        return
    module, _, constant = name.rpartition(".")
    lines[:] = [f"A constant of type ``{type(obj).__name__}``.", ""]
    for maker in sorted(one for one in sys.modules if one.startswith(f"{module}.")):
        if getattr(sys.modules[maker], constant, None) is obj:
            lines[:] = ModuleAnalyzer.for_module(maker).find_attr_docs().get(("", constant), lines)


def _with_values(_app: Any, what: str, _name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Add the names of an enumeration's values to its docstring."""
    if what == "class" and issubclass(obj, enum.Enum):
        lines += ["", "Values: " + ", ".join(f"``{one.name}``" for one in obj), ""]


def setup(app: Any) -> None:
    """Connect."""
    app.connect("autodoc-process-docstring", _constant, priority=300)
    app.connect("autodoc-process-docstring", _as_rest, priority=400)
    app.connect("autodoc-process-docstring", _with_values, priority=900)
