# SPDX-License-Identifier: Apache-2.0
"""All pages."""

from __future__ import annotations

from softgrip_panel.web.pages.cell import cell_page
from softgrip_panel.web.shell import add_page
from softgrip_panel.web.site import PanelSite


def add_pages(site: PanelSite) -> None:
    """Add every page to the site."""
    add_page(site, "/", cell_page)
