# SPDX-License-Identifier: Apache-2.0
"""Give every package a version: `python tools/release.py 0.2.0`, then commit and tag as it prints.

The changelog has to have a section of that version. Without a version it checks that all packages have the same one.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: File name -> what stands before and behind the version.
PLACES = {
    "package.xml": re.compile(r"(<version>)([^<]+)(</version>)"),
    "setup.cfg": re.compile(r"^(version = )(\S+)()$", re.MULTILINE),
    "pyproject.toml": re.compile(r'^(version = ")([^"]+)(")$', re.MULTILINE),
    "CITATION.cff": re.compile(r"^(version: )(\S+)()$", re.MULTILINE),
}
VERSION = re.compile(r"\d+\.\d+\.\d+")


def files() -> list[Path]:
    """Return the files of the repository that hold the version."""
    command = ("git", "ls-files", "-z", "--", *PLACES, *(f"**/{name}" for name in PLACES))
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = (ROOT / name for name in sorted(set(names.split("\0"))) if name)
    return [path for path in paths if PLACES[path.name].search(path.read_text(encoding="utf-8"))]


def versions() -> dict[Path, str]:
    """Return file -> version."""
    found = {path: PLACES[path.name].search(path.read_text(encoding="utf-8")) for path in files()}
    return {path: match[2] for path, match in found.items() if match}


def changelog_versions() -> list[str]:
    """Return the versions that the changelog has sections of, newest first."""
    return re.findall(r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)


def main() -> int:
    """Write or check versions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("version", nargs="?", help="such as 0.2.0")
    requested: str | None = parser.parse_args().version
    if requested is None:
        found = sorted(set(versions().values()))
        print(f"{len(versions())} files: {', '.join(found)}")
        return 0 if len(found) == 1 else 1
    if not VERSION.fullmatch(requested) or requested not in changelog_versions():
        text = f"expected a version with a section in CHANGELOG.md, found {requested!r}; add '## [{requested}] - DATE'"
        print(text, file=sys.stderr)
        return 2
    for path in files():
        text = path.read_text(encoding="utf-8")
        path.write_text(PLACES[path.name].sub(rf"\g<1>{requested}\g<3>", text, count=1), encoding="utf-8")
    print(f"{len(versions())} files have version {requested}; now:")
    print(f"git commit -am 'release {requested}' && git tag -a v{requested}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
