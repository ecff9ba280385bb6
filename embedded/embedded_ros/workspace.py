# SPDX-License-Identifier: Apache-2.0
"""Finds the packages of the workspace in source: their folders, executables and interfaces.

Folders that hold packages come from the environment variable EMBEDDED_WORKSPACE (separated like PATH) or else from the
file that ``python -m embedded_ros.workspace FOLDER`` wrote into site-packages.
"""

from __future__ import annotations

import functools
import os
import re
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

from embedded_ros.errors import WorkspaceError

VARIABLE = "EMBEDDED_WORKSPACE"
_RECORD = "embedded_ros_workspace"
_INTERFACES = Path(__file__).parent / "interfaces"
_KINDS = ("msg", "srv", "action")


class Package(NamedTuple):
    """A package in source: name, folder with package.xml, and its console scripts (name -> module:function)."""

    name: str
    folder: Path
    scripts: tuple[tuple[str, str], ...] = ()

    @property
    def python_root(self) -> Path:
        """Folder to import its Python package from."""
        for candidate in (self.folder, self.folder / "python", self.folder / "src"):
            if (candidate / self.name / "__init__.py").is_file():
                return candidate
        return self.folder


def roots() -> list[Path]:
    """Return the folders that are searched for packages."""
    text = os.environ.get(VARIABLE)
    if text is None:
        record = Path(sysconfig.get_path("purelib")) / f"{_RECORD}.txt"
        text = record.read_text(encoding="utf-8").strip() if record.is_file() else ""
    return [Path(part) for part in text.split(os.pathsep) if part]


@functools.cache
def packages() -> dict[str, Package]:
    """Return the packages of the workspace by name."""
    found: dict[str, Package] = {}
    for folder in _package_folders():
        manifest = (folder / "package.xml").read_text(encoding="utf-8")
        match = re.search(r"<name>\s*([\w-]+)\s*</name>", manifest)
        if match is None:
            raise WorkspaceError(f"{folder / 'package.xml'}: expected <name>package</name>, found none")
        found.setdefault(match[1], Package(match[1], folder, _scripts(folder)))
    return found


def _package_folders() -> list[Path]:
    found: list[Path] = []
    for root in roots():
        if not root.is_dir():
            raise WorkspaceError(f"workspace folder {root} does not exist; correct {VARIABLE} or run make setup again")
        candidates = [root, *sorted(root.glob("*")), *sorted(root.glob("*/*"))]
        found += [folder for folder in candidates if (folder / "package.xml").is_file()]
    return found


def _scripts(folder: Path) -> tuple[tuple[str, str], ...]:
    path = folder / "setup.cfg"
    if not path.is_file():
        return ()
    import configparser  # noqa: PLC0415  only commands and launch need it, nodes start without

    parser = configparser.ConfigParser()
    try:
        parser.read(path, encoding="utf-8")
    except configparser.Error as error:
        raise WorkspaceError(f"{path}: not readable as a setup.cfg: {error}") from error
    lines = parser.get("options.entry_points", "console_scripts", fallback="").strip().splitlines()
    pairs = [line.split("=", 1) for line in lines if line.strip()]
    wrong = [pair for pair in pairs if len(pair) != 2 or ":" not in pair[1]]
    if wrong:
        raise WorkspaceError(f"{path}: expected 'name = module:function' under console_scripts, found {wrong[0]}")
    return tuple((name.strip(), target.strip()) for name, target in pairs)


def package(name: str) -> Package:
    """Return a package by name.

    Raises:
        WorkspaceError: there is none; the message lists what there is.
    """
    known = packages()
    if name not in known:
        raise WorkspaceError(f"package '{name}' not found; the workspace has: {', '.join(sorted(known)) or 'nothing'}")
    return known[name]


def executable(package_name: str, name: str) -> list[str]:
    """Return the command line that starts an executable of a package."""
    found = package(package_name)
    scripts = dict(found.scripts)
    if name not in scripts:
        raise WorkspaceError(
            f"no executable '{name}' in package '{package_name}'; it has: {', '.join(sorted(scripts)) or 'none'}"
        )
    return [sys.executable, "-m", "embedded_ros.child", name, scripts[name]]


@functools.cache
def interface_folders() -> dict[str, Path]:
    """Return the packages that define interfaces, shipped and in the workspace (which wins), with their folders."""
    found = {entry.name: entry for entry in _INTERFACES.iterdir() if entry.is_dir()}
    for folder in _package_folders():
        if any((folder / kind).is_dir() for kind in _KINDS):
            found[_name_of(folder)] = folder
    return found


def _name_of(folder: Path) -> str:
    match = re.search(r"<name>\s*([\w-]+)\s*</name>", (folder / "package.xml").read_text(encoding="utf-8"))
    return match[1] if match else folder.name


def record(folders: list[Path]) -> Path:
    """Remember workspace folders in site-packages and make their Python packages importable from source."""
    site = Path(sysconfig.get_path("purelib"))
    (site / f"{_RECORD}.txt").write_text(os.pathsep.join(map(str, folders)), encoding="utf-8")
    os.environ[VARIABLE] = os.pathsep.join(map(str, folders))
    packages.cache_clear()
    paths = [str(item.python_root) for item in packages().values() if (item.python_root / item.name).is_dir()]
    lines = [str(Path(__file__).parents[1]), *paths, "import embedded_ros.importer; embedded_ros.importer.install()"]
    pth = site / f"{_RECORD}.pth"
    pth.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return pth


def main() -> int:
    """Run ``python -m embedded_ros.workspace``."""
    import argparse  # noqa: PLC0415  only this command needs it

    parser = argparse.ArgumentParser(
        prog="python -m embedded_ros.workspace",
        description="Remember the folders whose ROS 2 packages this Python environment runs from source.",
    )
    parser.add_argument("folders", nargs="+", type=Path, help="folder that holds packages, such as ros2_ws/src")
    arguments = parser.parse_args()
    folders = [folder.resolve() for folder in arguments.folders]
    for folder in folders:
        if not folder.is_dir():
            parser.error(f"{folder} is no folder; expected one that holds ROS 2 packages")
    record(folders)
    return 0


if __name__ == "__main__":
    sys.exit(main())
