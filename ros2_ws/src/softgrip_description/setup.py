# SPDX-License-Identifier: Apache-2.0
"""Installs what setup.cfg declares, plus the files that ROS 2 looks for in share/."""

from setuptools import setup

PACKAGE = "softgrip_description"

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/rviz", ["rviz/hand.rviz"]),
        (f"share/{PACKAGE}/schema", [f"{PACKAGE}/data/{name}.schema.json" for name in ("cell", "hand")]),
        (f"share/{PACKAGE}/urdf", [f"urdf/{name}.urdf.xacro" for name in ("hand", "power", "pinch", "hook")]),
    ],
)
