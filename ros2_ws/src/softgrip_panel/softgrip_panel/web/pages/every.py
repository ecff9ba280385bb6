# SPDX-License-Identifier: Apache-2.0
"""All pages."""

from __future__ import annotations

from softgrip_panel.web.pages.bags import bags_page
from softgrip_panel.web.pages.cell import cell_page
from softgrip_panel.web.pages.fingers import fingers_page
from softgrip_panel.web.pages.friction import friction_page
from softgrip_panel.web.pages.grasps import grasps_page
from softgrip_panel.web.pages.records import label_html, records_page
from softgrip_panel.web.pages.setup import setup_page
from softgrip_panel.web.pages.swap import swap_page
from softgrip_panel.web.pages.work import work_page
from softgrip_panel.web.shell import add_page
from softgrip_panel.web.site import PanelSite


def add_pages(site: PanelSite) -> None:
    """Add every page to the site."""
    add_page(site, "/", cell_page)
    add_page(site, "/work", work_page)
    add_page(site, "/swap", swap_page)
    add_page(site, "/grasps", grasps_page)
    add_page(site, "/records", records_page)
    add_page(site, "/bags", bags_page)
    add_page(site, "/fingers", fingers_page)
    add_page(site, "/friction", friction_page)
    add_page(site, "/setup", setup_page)
    site.label = label_html
