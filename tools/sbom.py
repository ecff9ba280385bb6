# SPDX-License-Identifier: Apache-2.0
"""Write what the suite is made of as a CycloneDX 1.6 document: `make sbom`.

Components are the distributions of the locks with the hashes that may be installed, the licence that each
declares where it is installed, and below it the shared libraries that its wheel carries.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LOCKS = tuple(path for path in sorted(ROOT.glob("requirements*.lock")) if "oldest" not in path.name)
_PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;\\]+)(?:\s*;\s*(?P<marker>[^\\]+))?")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
#: The hash with which auditwheel marks a library that it has put into a wheel.
_MARK = re.compile(r"(?:-[0-9a-f]{8}){1,2}(?=\.|$)|-(?=\.)")


@dataclass(frozen=True)
class Pin:
    """One distribution of a lock."""

    name: str
    version: str
    marker: str
    hashes: tuple[str, ...]

    @property
    def url(self) -> str:
        """Return the package URL (purl)."""
        return f"pkg:pypi/{re.sub(r'[-_.]+', '-', self.name).lower()}@{self.version}"


def pins(lock: Path) -> Iterator[Pin]:
    """Yield the distributions of a lock."""
    for entry in re.split(r"\n(?=[A-Za-z0-9])", lock.read_text()):
        found = _PIN.match(entry)
        if found:
            marker = (found["marker"] or "").strip()
            yield Pin(found["name"], found["version"], marker, tuple(_HASH.findall(entry)))


def installed(pin: Pin) -> importlib.metadata.Distribution | None:
    """Return the distribution where this very version is installed."""
    try:
        found = importlib.metadata.distribution(pin.name)
    except importlib.metadata.PackageNotFoundError:
        return None
    return found if found.version == pin.version else None


def declared_licence(distribution: importlib.metadata.Distribution) -> str:
    """Return the licence that a distribution's metadata names; empty where it names none."""
    metadata = distribution.metadata
    text = metadata.get("License-Expression") or ""
    if not text:
        rows = metadata.get_all("Classifier") or []
        text = ", ".join(row.rpartition("::")[2].strip() for row in rows if row.startswith("License ::"))
    return text or next(iter((metadata.get("License") or "").strip().splitlines()), "")


def bundled_libraries(distribution: importlib.metadata.Distribution) -> list[str]:
    """Return the names of the shared libraries that a wheel carries beside its own code, such as ``libavcodec``."""
    files = [file for file in distribution.files or [] if file.parts[0].endswith(".libs")]
    return sorted({_MARK.sub("", file.name).partition(".so")[0] for file in files})


def component(pin: Pin) -> dict[str, Any]:
    """Return a distribution as a component of CycloneDX."""
    made: dict[str, Any] = {
        "type": "library",
        "bom-ref": pin.url,
        "name": pin.name,
        "version": pin.version,
        "purl": pin.url,
        "hashes": [{"alg": "SHA-256", "content": value} for value in pin.hashes],
    }
    if pin.marker:
        made["properties"] = [{"name": "softgrip:marker", "value": pin.marker}]
    distribution = installed(pin)
    if distribution is not None:
        licence = declared_licence(distribution)
        if licence:
            made["licenses"] = [{"license": {"name": licence}}]
        below = [{"type": "library", "name": name} for name in bundled_libraries(distribution)]
        if below:
            made["components"] = below
    return made


def document() -> dict[str, Any]:
    """Return the whole bill of materials; it holds no time and no place, so it changes only when a lock does."""
    found = {pin.url: pin for lock in LOCKS for pin in pins(lock)}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": "softgrip", "bom-ref": "softgrip"}},
        "components": [component(found[url]) for url in sorted(found)],
        "dependencies": [{"ref": "softgrip", "dependsOn": sorted(found)}],
    }


def main() -> int:
    """Write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="JSON file to write")
    file: Path = parser.parse_args().file
    made = document()
    file.write_text(json.dumps(made, indent=1) + "\n")
    print(f"{file}: {len(made['components'])} components")
    return 0


if __name__ == "__main__":
    sys.exit(main())
