# SPDX-License-Identifier: Apache-2.0
"""The operator's panel, a page left open for eight hours: what the panel's process and the browser hold afterwards.

Three pages stand open in a real Chromium (Cell, Grasps, Set-up). Eight hours of a busy cell are played to the page
model in simulated time: 288,000 ticks of a tenth of a second with tensions, tendons and pictures, a grasp every 20 s
with curve and pictures, an alarm every minute that is acknowledged, diagnostics every second. After each tick every
page is refreshed as its timer would do. Server and sockets run on in real time between ticks, so the browser gets
values at its own pace. Memory counts from the end of the hour in which the list of the
last grasps is full. On a slow machine --refresh-ticks 10 --grasp-ticks 600 takes a tenth of the time.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from nicegui import Client, ui

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_panel/test"))

import panel_site
from busy_cell import GRASP_TICKS, BusyCell, SimulatedTime

from softgrip_panel.model.grasps import MAX_GRASPS
from softgrip_panel.web.pages.every import add_pages
from softgrip_panel.web.server import WebServer, listen
from softgrip_panel.web.shell import Page
from softgrip_panel.web.site import PanelSite
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.browser import PanelBrowser
from softgrip_testing.process_table import resident_bytes

HOURS = 8
#: Of the growth between the hour in which the list is full and the last.
GOAL_SHARE = 0.10
PATHS = ("/", "/grasps", "/setup")
HOUR_TICKS = 36_000
#: The first runs finalisers, whose objects the second frees; what is drawn meanwhile goes with the third.
COLLECTIONS = 3
#: A page's timer rings at every tick; a slow machine may let it ring less often.
REFRESH_TICKS = 1


def own_bytes() -> int:
    """Return the resident memory of this process after a collection [B]."""
    gc.collect()
    return resident_bytes(os.getpid())


def heap_bytes(browser: PanelBrowser, windows: list[str]) -> int:
    """Return what the pages' scripts hold together after collections, with nothing on its way to them [B]."""
    total = 0
    for window in windows:
        browser.driver.switch_to.window(window)
        for _ in range(COLLECTIONS):
            browser.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
            time.sleep(1.0)
        # performance.memory would be rounded, and looked at once in twenty minutes
        total += int(browser.driver.execute_cdp_cmd("Runtime.getHeapUsage", {})["usedSize"])
    return total


def elements(browser: PanelBrowser, windows: list[str]) -> int:
    """Return how many nodes the pages' documents have together, those that nothing shows any more among them."""
    total = 0
    for window in windows:
        browser.driver.switch_to.window(window)
        browser.driver.execute_cdp_cmd("Performance.enable", {})
        metrics = browser.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
        total += next(int(one["value"]) for one in metrics if one["name"] == "Nodes")
    return total


class BusyHours:
    """The hours: ticks on the server's own event loop, so that pages are refreshed where their timers do it."""

    def __init__(self, cell: BusyCell, pages: list[tuple[Page, str]], refresh_ticks: int) -> None:
        self.cell, self.pages, self.refresh_ticks = cell, pages, refresh_ticks

    async def play(self, begin: int, end: int) -> None:
        """Play ticks."""
        for number in range(begin, end):
            self.cell.tick(number)
            for page, client in self.pages if number % self.refresh_ticks == 0 else ():
                if client in Client.instances:  # on a starved machine a browser may lose its page and load it again
                    page._refresh()  # noqa: SLF001  what its timer calls
            await asyncio.sleep(0)
            if number % HOUR_TICKS == 0:
                self.pages[:] = [(page, client) for page, client in self.pages if client in Client.instances]


def made_site(folder: Path, clock: SimulatedTime, port: int) -> PanelSite:
    """Return a site whose model lives in simulated time."""
    site = panel_site.make_site(folder, port)
    state: Any = site.desk.state
    for owner in (state, state.alarms, state.grasps):
        owner._now_s = clock  # noqa: SLF001  the site is made for tests in real time
    state._monotonic_s = clock  # noqa: SLF001  as above
    return site


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=int, default=HOURS, help="simulated (default: %(default)s)")
    parser.add_argument(
        "--grasp-ticks", type=int, default=GRASP_TICKS, help="from grasp to grasp (default: %(default)s)"
    )
    parser.add_argument("--refresh-ticks", type=int, default=REFRESH_TICKS, help="of a page (default: %(default)s)")
    options = parser.parse_args()
    pages: list[tuple[Page, str]] = []
    loops: list[asyncio.AbstractEventLoop] = []
    build = Page.build

    def remembered(page: Page, body: Callable[[Page], None]) -> None:
        pages.append((page, ui.context.client.id))
        loops.append(asyncio.get_running_loop())
        build(page, body)

    Page.build = remembered  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as name:
        clock, bound = SimulatedTime(), listen("127.0.0.1", 0)
        port = bound.getsockname()[1]
        site = made_site(Path(name), clock, port)
        server = WebServer(site.app(add_pages), bound)
        server.start()
        with PanelBrowser(f"http://127.0.0.1:{port}") as browser:
            windows = opened(browser)
            hours = BusyHours(BusyCell(site.desk, clock, options.grasp_ticks, site), pages, options.refresh_ticks)

            def play(begin: int, end: int) -> None:
                work: Future[None] = asyncio.run_coroutine_threadsafe(
                    hours.play(begin * HOUR_TICKS, end * HOUR_TICKS), loops[-1]
                )
                work.result()

            began_s = time.monotonic()
            held = []
            for hour in range(1, options.hours + 1):
                play(hour - 1, hour)
                held.append((own_bytes(), heap_bytes(browser, windows)))
                memory = f"{held[-1][0] / 1e6:.1f} MB, scripts {held[-1][1] / 1e6:.1f} MB"
                said = f"hour {hour}: {len(pages)} pages, {memory}, {elements(browser, windows)} elements"
                print(said, file=sys.stderr, flush=True)
            took_s = time.monotonic() - began_s
        server.close()
    report(options, held, took_s)


def opened(browser: PanelBrowser) -> list[str]:
    """Open the pages in windows of their own."""
    browser.log_in("Ada")
    windows = []
    for path in PATHS:
        browser.driver.switch_to.new_window("window")
        browser.open(path)
        windows.append(browser.driver.current_window_handle)
    return windows


def report(options: argparse.Namespace, held: list[tuple[int, int]], took_s: float) -> None:
    """Print both claims of what process and scripts held after each hour [B]."""
    full = min(options.hours, math.ceil(MAX_GRASPS * options.grasp_ticks / HOUR_TICKS))
    for name, values in zip(("panel memory growth", "browser heap growth"), zip(*held, strict=True), strict=True):
        first, last = values[full - 1], values[-1]
        claim(
            name,
            last / first - 1.0,
            "1",
            better="lower",
            goal=GOAL_SHARE,
            runs=1,
            note=f"{first / 1e6:.1f} MB after {full} simulated hours, {last / 1e6:.1f} MB after {options.hours:g}; "
            f"three pages, refreshed every {options.refresh_ticks} ticks, a grasp every {options.grasp_ticks}; "
            f"{took_s:.0f} s of wall time",
        )


if __name__ == "__main__":
    main()
