# SPDX-License-Identifier: Apache-2.0
"""Write the names that a package.xml may depend on into tests/validation/rosdistro.txt.

    git clone --depth 1 https://github.com/ros/rosdistro && python tools/rosdistro_names.py rosdistro

Sources: rosdep/base.yaml and rosdep/python.yaml there, as rosdep resolves them on Ubuntu 24.04, and
jazzy/distribution.yaml.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

OUTPUT = Path(__file__).resolve().parents[1] / "tests" / "validation" / "rosdistro.txt"
_WIDTH = 119
_SYSTEM, _RELEASE = "ubuntu", "noble"


def installer(rule: Any) -> str | None:
    """Return what a key's rule installs with on Ubuntu 24.04: apt, pip or another one; None: it has no rule there."""
    given = rule.get(_SYSTEM, rule.get("*")) if isinstance(rule, dict) else None
    while isinstance(given, dict):
        for name in ("apt", "pip", "snap", "source", "gem", "npm"):
            if name in given:
                return name
        given = given.get(_RELEASE, given.get("*"))
    return None if given is None else "apt"


def names(checkout: Path) -> dict[str, list[str]]:
    """Return what there is: keys by their installer, and the packages released for Jazzy."""
    found: dict[str, list[str]] = {"apt": [], "pip": [], "jazzy": []}
    for file in ("base", "python"):
        for key, rule in yaml.safe_load((checkout / "rosdep" / f"{file}.yaml").read_text()).items():
            kind = installer(rule)
            if kind in found:
                found[kind].append(key)
    distribution = yaml.safe_load((checkout / "jazzy" / "distribution.yaml").read_text())
    for name, repository in distribution["repositories"].items():
        if "release" in repository:
            found["jazzy"] += repository["release"].get("packages", [name])
    return {kind: sorted(set(group)) for kind, group in found.items()}


def main(args: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="of github.com/ros/rosdistro")
    options = parser.parse_args(args)
    commit = subprocess.run(
        ["git", "-C", options.checkout, "log", "-1", "--format=%H, %cs"], capture_output=True, text=True, check=True
    ).stdout.strip()
    lines = [
        f"# tools/rosdistro_names.py wrote this from github.com/ros/rosdistro, {commit}",
        "# [apt], [pip]: rosdep keys by what installs them on Ubuntu 24.04; [jazzy]: packages released for Jazzy",
    ]
    for kind, group in names(options.checkout).items():
        lines += [f"[{kind}]", *textwrap.wrap(" ".join(group), _WIDTH, break_on_hyphens=False, break_long_words=False)]
    OUTPUT.write_text("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
