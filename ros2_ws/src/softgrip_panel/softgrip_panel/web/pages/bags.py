# SPDX-License-Identifier: Apache-2.0
"""Page Bags: what was recorded, the room that is left, reports, replays, downloads."""

from __future__ import annotations

import time
from urllib.parse import quote

from nicegui import background_tasks

from softgrip_panel.model import acts
from softgrip_panel.model.bags import REPLAYED, BagView
from softgrip_panel.model.roles import Role
from softgrip_panel.web.parts import card, table
from softgrip_panel.web.shell import Page, element, text_element

#: The folder is read so often [s].
LOOK_S = 2.0
MAX_ROWS = 100


class _Listing:
    """The folder as it was a moment ago: one look for all that a page shows of it."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._looked_s = -LOOK_S
        self._bags: tuple[BagView, ...] = ()
        self._free: int | None = None

    def refresh(self) -> None:
        now_s = time.monotonic()
        if now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            folder = self._page.site.jobs.folder
            self._bags, self._free = folder.bags()[:MAX_ROWS], folder.free_bytes()

    @property
    def bags(self) -> tuple[BagView, ...]:
        self.refresh()
        return self._bags

    @property
    def free(self) -> int | None:
        self.refresh()
        return self._free


def bags_page(page: Page) -> None:
    """Make the page's own part."""
    listing = _Listing(page)
    with card(page, "bags.recorder", "recorder"):
        page.shown.text(text_element("p", "", id="free"), lambda: _free_text(page, listing.free))
        if page.person.role >= Role.OPERATE:
            with element("div", classes="row"):
                for key, act in (
                    ("bags.start", acts.start_recording()),
                    ("bags.stop", acts.stop_recording()),
                    ("bags.split", acts.split_recording()),
                ):
                    page.shown.enabled(page.button(key, page.do(act)), lambda: page.may_act)
                page.button("bags.snapshot", page.do(acts.snapshot()))
            page.commands(acts.start_recording(), acts.stop_recording(), acts.split_recording(), acts.snapshot())
    with card(page, "bags.list", "bags"):
        text_element("p", page.t("bags.replay_hint", node=REPLAYED), "note")
        body = table(page, "bags.name", "bags.size", "bags.files", "bags.report", "bags.replay")

        def rows() -> tuple[tuple[BagView, str, str], ...]:
            return tuple((bag, _job_text(page, bag, "report"), _job_text(page, bag, "replay")) for bag in listing.bags)

        def write(found: tuple[tuple[BagView, str, str], ...]) -> None:
            for bag, report, replay in found:
                _row(page, bag, report, replay)

        page.shown.parts(body, rows, write)


def _row(page: Page, bag: BagView, report: str, replay: str) -> None:
    place = f"/bags/{quote(bag.name, safe='')}"
    with element("tr"):
        text_element("th", bag.name, "long", scope="row")
        text_element("td", _size(bag.size))
        with element("td"):
            for name, size in bag.files[:20]:
                link = f"{place}/files/{quote(name, safe='')}"
                text_element("a", f"{name} ({_size(size)})", "export", href=link, download=name)
        with element("td"):
            if bag.has_report:
                text_element("a", page.t("bags.open"), "export", href=f"{place}/report", target="_blank")
            _job(page, bag, "report", report)
        with element("td"):
            _job(page, bag, "replay", replay)


def _job(page: Page, bag: BagView, kind: str, said: str) -> None:
    if said:
        text_element("p", said, "note")
    if page.person.role >= Role.OPERATE and said != page.t("bags.running"):

        def begin() -> None:
            page.desk.record_event(page.person.name, kind, bag.name, success=True, message="begun")
            background_tasks.create(page.site.jobs.run(bag.name, kind))

        page.button(f"bags.make_{kind}", begin, "small", name=f"{kind}-{bag.name}")


def _job_text(page: Page, bag: BagView, kind: str) -> str:
    job = page.site.jobs.find(bag.name, kind)
    return "" if job is None else page.t("bags.running") if job.is_running else job.message


def _free_text(page: Page, free: int | None) -> str:
    return page.t("bags.no_folder") if free is None else page.t("bags.free", size=_size(free))


def _size(count: int) -> str:
    value = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000.0:
            return f"{value:.0f} {unit}"
        value /= 1000.0
    return f"{value:.1f} TB"
