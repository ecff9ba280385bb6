# SPDX-License-Identifier: Apache-2.0
"""Where packages are; in a workspace that runs from source, the share folder is the package's source folder.

Packages of standard interfaces lie in `embedded_ros/interfaces`, laid out as in a share folder (msg/, srv/, action/).
"""

from __future__ import annotations

from pathlib import Path

from embedded_ros import workspace

SHIPPED_INTERFACES = Path(workspace.__file__).parent / "interfaces"


class PackageNotFoundError(KeyError):
    """There is no such package."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


def get_packages_with_prefixes() -> dict[str, str]:
    """Return all packages with the folder each lies in."""
    shipped = {folder.name: str(folder) for folder in SHIPPED_INTERFACES.iterdir() if folder.is_dir()}
    return shipped | {name: str(package.folder) for name, package in workspace.packages().items()}


def get_package_prefix(package_name: str) -> str:
    """Return the folder of a package."""
    packages = get_packages_with_prefixes()
    if package_name not in packages:
        raise PackageNotFoundError(f"package '{package_name}' not found; known are: {', '.join(sorted(packages))}")
    return packages[package_name]


def get_package_share_directory(package_name: str, print_warning: bool = True) -> str:  # noqa: ARG001
    """Return the folder that holds launch/, config/ and other data of a package."""
    return get_package_prefix(package_name)


def get_package_share_path(package_name: str, print_warning: bool = True) -> Path:  # noqa: ARG001
    """Return the share folder as a path."""
    return Path(get_package_prefix(package_name))
