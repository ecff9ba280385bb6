# SPDX-License-Identifier: Apache-2.0
"""Take pictures of the built site with Chromium, as wide as a desk's screen and as a phone's: `make site` first."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "index",
    "tutorials/close-a-finger",
    "cell",
    "reference/generated/parameters",
    "reference/generated/api/finger",
)
#: Name -> width and height [px].
SIZES = {"desktop": (1366, 900), "phone": (390, 844)}
REPORT_SIZE = (1100, 1500)
#: Chromium has no window as narrow as a phone: the page is shown in a frame of that width.
FRAME = '<body style="margin:0"><iframe src="{url}" width="{width}" height="{height}" style="border:0"></iframe>'


def take(browser: str, url: str, picture: Path, size: tuple[int, int]) -> None:
    """Write what a browser shows in a frame of this width and height [px]."""
    frame = picture.with_suffix(".frame.html")
    frame.write_text(FRAME.format(url=url, width=size[0], height=size[1]))
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=3000"]
    flags += ["--allow-file-access-from-files", f"--window-size={size[0]},{size[1]}", f"--screenshot={picture}"]
    try:
        subprocess.run([browser, *flags, frame.as_uri()], check=True, capture_output=True, timeout=120)
    finally:
        frame.unlink()
    # a page has few colours
    Image.open(picture).convert("RGB").crop((0, 0, *size)).quantize(128).save(picture, optimize=True)
    print(picture)


def main() -> int:
    """Write a PNG of each page in each size, or one of the demo's report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, default=ROOT / "out/site", help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "out/site-pictures", help="(default: %(default)s)")
    parser.add_argument("--report", type=Path, help="only this report of `make demo`, into docs/images/report.png")
    parser.add_argument("pages", nargs="*", default=PAGES, help="pages below docs/, without .html")
    options = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        print("expected chromium, found none: apt-get install chromium", file=sys.stderr)
        return 2
    if options.report:
        take(browser, options.report.resolve().as_uri(), ROOT / "docs/images/report.png", REPORT_SIZE)
        return 0
    options.out.mkdir(parents=True, exist_ok=True)
    for page in options.pages:
        url = (options.site.resolve() / f"docs/{page}.html").as_uri()
        for name, size in SIZES.items():
            take(browser, url, options.out / f"{page.replace('/', '-')}-{name}.png", size)
    return 0


if __name__ == "__main__":
    sys.exit(main())
