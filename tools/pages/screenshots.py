# SPDX-License-Identifier: Apache-2.0
"""Take pictures of the built site with Chromium, as wide as a desk's screen and as a phone's: `make site` first."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

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
#: Chromium has no window as narrow as a phone: the page is shown in a frame of that width.
FRAME = '<body style="margin:0"><iframe src="{url}" width="{width}" height="{height}" style="border:0"></iframe>'


def main() -> int:
    """Write a PNG of each page in each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, default=ROOT / "out/site", help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "out/site-pictures", help="(default: %(default)s)")
    parser.add_argument("pages", nargs="*", default=PAGES, help="pages below docs/, without .html")
    options = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        print("expected chromium, found none: apt-get install chromium", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    for page in options.pages:
        for name, (width, height) in SIZES.items():
            picture = options.out / f"{page.replace('/', '-')}-{name}.png"
            url = (options.site.resolve() / f"docs/{page}.html").as_uri()
            frame = options.out / "frame.html"
            frame.write_text(FRAME.format(url=url, width=width, height=height))
            flags = [
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                "--virtual-time-budget=3000",
            ]
            command = [browser, *flags, f"--window-size={width},{height}", f"--screenshot={picture}", frame.as_uri()]
            subprocess.run(command, check=True, capture_output=True, timeout=120)
            print(picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
