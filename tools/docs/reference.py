# SPDX-License-Identifier: Apache-2.0
"""Writes docs/reference/generated from the code: interfaces, parameters, faults, commands, files, Python and C++.

The pages are not committed: what is written down twice differs one day. `make docs` and `make site` write them.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "pages"))

from generated import api, commands, cpp, faults, formats, interfaces, parameters

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs/reference/generated"


def pages() -> dict[str, str]:
    """Return name -> text of every generated page."""
    return {
        "topics.md": interfaces.topics_page(),
        "interfaces.md": interfaces.types_page(),
        "parameters.md": parameters.page(),
        "faults.md": faults.page(),
        "commands.md": commands.page(),
        "file-formats.md": formats.page(),
        **api.pages(),
        **cpp.pages(),
    }


def main() -> int:
    """Write the pages."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    made = pages()
    if FOLDER.exists():
        shutil.rmtree(FOLDER)
    for name, text in made.items():
        path = FOLDER / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    print(f"{FOLDER.relative_to(ROOT)}: {len(made)} pages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
