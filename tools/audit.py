# SPDX-License-Identifier: Apache-2.0
"""Report known holes in what the locks name: `make audit`.

pip-audit asks the package index, in an environment of its own. Returns 0 without a finding, 1 with some, and 2 where
nothing could be asked: that is no clean bill of health.
"""

from __future__ import annotations

import json
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LOCKS = tuple(sorted(path.name for path in ROOT.glob("requirements*.lock") if "oldest" not in path.name))
ENVIRONMENT = ROOT / "out" / "audit"
FINDING, NOT_DONE = 1, 2


def main() -> int:
    """Audit every lock."""
    python = ENVIRONMENT / "bin" / "python"
    if not python.exists():
        venv.create(ENVIRONMENT, with_pip=True)
    install = [str(python), "-m", "pip", "-q", "--disable-pip-version-check", "install", "pip-audit"]
    if subprocess.run(install, check=False).returncode != 0:
        print("audit: NOT DONE: expected a package index with pip-audit, found none", file=sys.stderr)
        return NOT_DONE
    return max(audit(python, ROOT / lock) for lock in LOCKS)


def audit(python: Path, lock: Path) -> int:
    """Audit a lock; return what the script returns for it."""
    command = [str(python), "-m", "pip_audit", "--disable-pip", "--require-hashes", "-f", "json", "-r", str(lock)]
    answer = subprocess.run([*command, "--progress-spinner", "off"], capture_output=True, text=True, check=False)
    try:
        found = json.loads(answer.stdout)["dependencies"]
    except (ValueError, KeyError):
        print(f"audit: NOT DONE for {lock.name}: pip-audit says:\n{answer.stderr}", file=sys.stderr)
        return NOT_DONE
    return verdict(lock.name, found)


def verdict(name: str, found: list[dict[str, Any]]) -> int:
    """Print what pip-audit found of a lock; return what the script returns for it.

    Args:
        name: of the lock.
        found: the ``dependencies`` of pip-audit's JSON; one that it could not ask about has a ``skip_reason``.
    """
    skipped = [one["name"] for one in found if "skip_reason" in one]
    holes = [(one, hole) for one in found for hole in one.get("vulns", [])]
    for one, hole in holes:
        fixed = ", ".join(hole["fix_versions"]) or "no version"
        print(f"{name}: {one['name']} {one['version']}: {hole['id']}, closed in {fixed}")
    print(f"{name}: {len(found) - len(skipped)} of {len(found)} distributions asked about, {len(holes)} known holes")
    if skipped or not found:
        print(f"audit: NOT DONE for {name}: the index knows nothing of {', '.join(skipped[:5])} ...", file=sys.stderr)
        return NOT_DONE
    return FINDING if holes else 0


if __name__ == "__main__":
    sys.exit(main())
