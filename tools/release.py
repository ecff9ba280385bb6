# SPDX-License-Identifier: Apache-2.0
"""Give every package a version: `python tools/release.py 0.3.0`, then commit and tag as it prints.

What stands under Unreleased in the changelog goes into that version's section, which is made where there is none.
Without a version it checks that all packages have the same one. `--notes v0.3.0` is for the tag's own workflow: it
prints the section of the changelog, and fails where the packages have another version than the tag.
"""

from __future__ import annotations

import argparse
import datetime as dt
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


def released(text: str, version: str, date: str) -> str:
    """Return a changelog whose Unreleased entries stand in the section of a version, newest in front."""
    head, *sections = re.split(r"^(?=## \[)", text, flags=re.MULTILINE)
    named = dict(zip(re.findall(r"^## \[([^]]+)\]", text, re.MULTILINE), sections, strict=True))
    fresh = _entries(named["Unreleased"])
    if version in named:
        title, *intro = re.split(r"^(?=### )", named[version], maxsplit=1, flags=re.MULTILINE)[0].splitlines()
        old = _entries(named[version])
    else:
        title, intro, old = f"## [{version}] - {date}", [], {}
    kinds = [*old, *(kind for kind in fresh if kind not in old)]
    parts = ["\n".join([title, *intro]).strip()]
    parts += [f"### {kind}\n\n" + "\n".join(filter(None, (fresh.get(kind), old.get(kind)))) for kind in kinds]
    made = "\n\n".join(parts) + "\n\n"
    rest = [made if name == version else section for name, section in named.items() if name != "Unreleased"]
    if version not in named:
        rest.insert(0, made)
    return (head + "## [Unreleased]\n\n" + "".join(rest)).rstrip() + "\n"


def notes(text: str, tag: str) -> str:
    """Return what a changelog says of the version of a tag, without its title.

    Raises:
        ValueError: the tag is no v and a version, or the changelog has no section of it.
    """
    version = tag.removeprefix("v")
    if tag == version or not VERSION.fullmatch(version):
        raise ValueError(f"expected a tag such as v0.3.0, found {tag!r}")
    for section in re.split(r"^(?=## \[)", text, flags=re.MULTILINE):
        title, _, body = section.partition("\n")
        if title.startswith(f"## [{version}]"):
            return body.strip() + "\n"
    raise ValueError(f"expected a section of {version} in CHANGELOG.md, found none: python tools/release.py {version}")


def _print_notes(tag: str) -> int:
    """Print the notes of a tag whose version all packages have."""
    try:
        text = notes((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), tag)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if set(versions().values()) != {tag.removeprefix("v")}:
        print(f"expected packages of {tag}, found {', '.join(sorted(set(versions().values())))}", file=sys.stderr)
        return 1
    print(text, end="")
    return 0


def _entries(section: str) -> dict[str, str]:
    """Return kind of change -> its entries."""
    kinds = re.split(r"^### (.*)$", section, flags=re.MULTILINE)[1:]
    return {kind: text.strip() for kind, text in zip(kinds[::2], kinds[1::2], strict=True)}


def main() -> int:
    """Write or check versions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("version", nargs="?", help="such as 0.2.0")
    parser.add_argument("--notes", metavar="TAG", help="print what the changelog says of a tag's version")
    options = parser.parse_args()
    if options.notes:
        return _print_notes(options.notes)
    requested: str | None = options.version
    if requested is None:
        found = sorted(set(versions().values()))
        print(f"{len(versions())} files: {', '.join(found)}")
        return 0 if len(found) == 1 else 1
    if not VERSION.fullmatch(requested):
        print(f"expected a version such as 0.2.0, found {requested!r}", file=sys.stderr)
        return 2
    changelog = ROOT / "CHANGELOG.md"
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    changelog.write_text(released(changelog.read_text(encoding="utf-8"), requested, today), encoding="utf-8")
    for path in files():
        text = path.read_text(encoding="utf-8")
        path.write_text(PLACES[path.name].sub(rf"\g<1>{requested}\g<3>", text, count=1), encoding="utf-8")
    print(f"{len(versions())} files have version {requested}; now:")
    print(f"git commit -am 'release {requested}' && git tag -a v{requested}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
