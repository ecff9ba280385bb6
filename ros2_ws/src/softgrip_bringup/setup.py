# SPDX-License-Identifier: Apache-2.0
"""Installs launch files, configuration and profiles into share/."""

from pathlib import Path

from setuptools import setup

PACKAGE = "softgrip_bringup"


def files(folder: str) -> list[str]:
    """Return the YAML files of a folder, relative to this one as setuptools asks."""
    here = Path(__file__).parent
    return sorted(str(path.relative_to(here)) for path in (here / folder).glob("*.yaml"))


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", [*files("launch"), "launch/keep_running.py"]),
        (f"share/{PACKAGE}/config", files("config")),
        (f"share/{PACKAGE}/controllers", files("controllers")),
        (f"share/{PACKAGE}/profiles", files("profiles")),
        (f"share/{PACKAGE}/settings", files("settings")),
    ],
)
