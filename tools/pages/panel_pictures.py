# SPDX-License-Identifier: Apache-2.0
"""Takes docs/images/panel_*.png: every page of the panel of an emulated cell that runs, by clicks in a real Chromium.

make cell, then: .venv/bin/python tools/pages/panel_pictures.py http://127.0.0.1:8480
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from softgrip_testing.browser import PanelBrowser

PICTURES = Path(__file__).resolve().parents[2] / "docs/images"
SIZE = (1280, 1000)
#: A tablet held upright [px].
TABLET = (820, 1180)
#: The pages are of few colours: so many keep their pictures small.
COLOURS = 64
#: So many points stand in the picture of page Friction.
PICTURED_POINT = 3


def take(browser: PanelBrowser, folder: Path, name: str) -> None:
    """Write what is seen now; a notice that lies over the page is waited for."""
    browser.wait(lambda: not browser.text(".said"), "a page without a notice")
    browser.script("window.scrollTo(0, 0)")
    picture = Image.open(io.BytesIO(browser.driver.get_screenshot_as_png())).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(folder / f"panel_{name}.png", optimize=True)


def swap(browser: PanelBrowser, folder: Path) -> None:
    """Mount the power hand; the picture is of the step that asks for serials."""
    browser.open("/swap")
    browser.press("swap-power")
    for word in ("open", "unhook", "insert", "close"):
        browser.wait(lambda word=word: word in browser.text("#instruction").lower(), f"an instruction to {word}")
        if word == "insert":
            take(browser, folder, "swap")
            browser.press("propose")
        browser.press("step-done")
    browser.wait_for_text("#instruction", "Done: ")


def work(browser: PanelBrowser, folder: Path) -> None:
    """Run a short list."""
    browser.open("/work")
    browser.find("#orders textarea").send_keys("egg 2\norange 1")
    browser.press("plan")
    browser.wait_for_text("#work-phase", "Planned")
    browser.press("work-start")
    browser.wait(lambda: browser.text("#work-phase") in {"Done", "Paused"}, "the end of the run", 180.0)
    take(browser, folder, "work")


def hold(browser: PanelBrowser, folder: Path) -> None:
    """Hold an egg."""
    browser.open("/")
    choice = "const s = document.querySelector('#acts select'); s.value = 'egg'; s.dispatchEvent(new Event('change'))"
    browser.script(choice)
    browser.press("place")
    browser.press("hold")
    browser.wait_for_text("#mode", "Holding")
    take(browser, folder, "cell")
    browser.open("/fingers")
    browser.wait(lambda: "N" in browser.text("#contacts"), "the contact tension")
    browser.wait(lambda: bool(browser.script("return document.getElementById('shape').dataset.number")), "a shape")
    take(browser, folder, "fingers")
    browser.open("/")
    browser.press("release")
    browser.wait_for_text("#mode", "Idle")


def friction(browser: PanelBrowser, folder: Path) -> None:
    """Measure: a grasp wants a young model. The picture is of a point being asked for."""
    browser.measure_friction(lambda points: points == PICTURED_POINT and take(browser, folder, "friction"))


def shown(browser: PanelBrowser, folder: Path) -> None:
    """Take the pages that need no clicks."""
    browser.open("/grasps")
    browser.press("show-1")
    browser.wait(lambda: browser.count(".pictures img") == len(("before", "at", "after")), "its pictures")
    browser.wait(lambda: browser.script("return !!document.getElementById('curve').drawn"), "its curve")
    take(browser, folder, "grasps")
    for name in ("records", "bags", "setup"):
        browser.open(f"/{name}")
        browser.wait(lambda: browser.count("body.disconnected") == 0, "live data")
        take(browser, folder, name)


def fitted(browser: PanelBrowser, folder: Path) -> None:
    """Take page Friction with the fit beside its points."""
    browser.open("/friction")
    browser.wait(lambda: browser.count("#friction-fit .fitted") > 0, "the fit")
    take(browser, folder, "friction_fit")


def tablet(browser: PanelBrowser, folder: Path) -> None:
    """Take a step of a swap as a tablet shows it; it is ended again."""
    browser.resize(*TABLET)
    browser.open("/swap")
    browser.press("swap-pinch")
    browser.wait_for_text("#instruction", "pen the palm")
    take(browser, folder, "tablet_swap")
    browser.press("swap-cancel")
    browser.wait(lambda: "hands" in browser.text("#instruction").lower(), "the hands to be asked out")
    browser.press("step-done")
    browser.wait_for_text("#mode", "Idle")
    browser.resize(*SIZE)


def main(argv: Sequence[str] | None = None) -> int:
    """Take them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="of the page, as the cell says it")
    parser.add_argument("--folder", type=Path, default=PICTURES, help="to write to")
    arguments = parser.parse_args(argv)
    with PanelBrowser(arguments.address, SIZE) as browser:
        browser.log_in("Ada")
        browser.wait(lambda: browser.text("#mode") in {"Idle", "Holding"}, "a cell that is up")
        browser.press("take")
        for part in (friction, fitted, swap, work, hold, shown, tablet):
            part(browser, arguments.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
